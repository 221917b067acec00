"""Robust estimation of the relative pose, and the verdict on it."""

from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.problem import Hypothesis
from dgc_pose.estimation.relative_pose import estimate_pose, of_stated
from dgc_pose.estimation.result import RelativePose
from dgc_pose.estimation.scale import ScaleSource
from dgc_pose.estimation.status import Status

__all__ = [
    "EstimationOptions",
    "Hypothesis",
    "RelativePose",
    "ScaleSource",
    "Status",
    "estimate_pose",
    "of_stated",
]
