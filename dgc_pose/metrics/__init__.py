"""Errors and scores of poses and correspondence maps."""

from dgc_pose.metrics.maps import aepe, jaccard, pck
from dgc_pose.metrics.pose import folded, pose_auc, rotation_error_deg, translation_error_deg

__all__ = [
    "aepe",
    "folded",
    "jaccard",
    "pck",
    "pose_auc",
    "rotation_error_deg",
    "translation_error_deg",
]
