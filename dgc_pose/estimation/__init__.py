"""Robust estimation of the relative pose, and the verdict on it.

Modules in the order of the estimation: `problem` (normalised matches), `robust_fit` (RANSAC and
least squares), `camera_fit` and `camera_model` (cameras that are not exact), `candidates` (the
poses that explain the matches), `covariance`, `evidence`, `probability`, `verdict`, `result`.
`relative_pose` runs them all.
"""

from dgc_pose.estimation.options import EstimationOptions
from dgc_pose.estimation.problem import Hypothesis
from dgc_pose.estimation.relative_pose import estimate_pose, reject_contradicted_K
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
    "reject_contradicted_K",
]
