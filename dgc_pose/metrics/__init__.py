"""Errors and scores of poses and correspondence maps."""

from dgc_pose.metrics.maps import count_within, endpoint_errors, jaccard
from dgc_pose.metrics.pose import folded, pose_auc, rotation_error_deg, translation_error_deg
from dgc_pose.metrics.reliability import Reliability

__all__ = [
    "Reliability",
    "count_within",
    "endpoint_errors",
    "folded",
    "jaccard",
    "pose_auc",
    "rotation_error_deg",
    "translation_error_deg",
]
