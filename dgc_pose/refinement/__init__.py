"""Refinement: matches at the accuracy of the original photographs, whatever the matcher."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from dgc_pose.refinement.options import (
    AlignmentOptions,
    FeatureOptions,
    RefinementOptions,
    SourceName,
)

if TYPE_CHECKING:
    from dgc_pose.refinement.refiner import Refiner

__all__ = [
    "AlignmentOptions",
    "FeatureOptions",
    "RefinementOptions",
    "Refiner",
    "SourceName",
]


def __getattr__(name: str) -> Any:
    if name == "Refiner":  # on first use, because SciPy takes its time to import
        return importlib.import_module("dgc_pose.refinement.refiner").Refiner
    raise AttributeError(f"module 'dgc_pose.refinement' has no attribute '{name}'")
