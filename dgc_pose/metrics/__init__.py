"""Errors and scores of poses."""

from dgc_pose.metrics.pose import folded, pose_auc, rotation_error_deg, translation_error_deg
from dgc_pose.metrics.reliability import Reliability

__all__ = [
    "Reliability",
    "folded",
    "pose_auc",
    "rotation_error_deg",
    "translation_error_deg",
]
