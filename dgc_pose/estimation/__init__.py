"""Robust estimation of the relative pose, and the verdict on it."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from dgc_pose.estimation.options import EstimationOptions, EstimatorName, VerdictOptions
from dgc_pose.estimation.result import RelativePose, Status

if TYPE_CHECKING:
    from dgc_pose.estimation.relative_pose import estimate_pose

__all__ = [
    "EstimationOptions",
    "EstimatorName",
    "RelativePose",
    "Status",
    "VerdictOptions",
    "estimate_pose",
]


def __getattr__(name: str) -> Any:
    # On first use: a command that refuses its arguments needs no solvers.
    if name == "estimate_pose":
        return importlib.import_module("dgc_pose.estimation.relative_pose").estimate_pose
    raise AttributeError(f"module 'dgc_pose.estimation' has no attribute '{name}'")
