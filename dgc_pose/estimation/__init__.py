"""Robust estimation of the relative pose, and the verdict on it."""

from dgc_pose.estimation.options import EstimationOptions, VerdictOptions
from dgc_pose.estimation.relative_pose import estimate_pose
from dgc_pose.estimation.result import Alternative, RelativePose
from dgc_pose.estimation.status import Status

__all__ = [
    "Alternative",
    "EstimationOptions",
    "RelativePose",
    "Status",
    "VerdictOptions",
    "estimate_pose",
]
