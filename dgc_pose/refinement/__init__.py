"""Refinement: from the dense map to matches as exact as the original photographs allow."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from dgc_pose.refinement.options import MatchSource, RefinementOptions

if TYPE_CHECKING:
    from dgc_pose.refinement.refine import Refiner

__all__ = ["MatchSource", "RefinementOptions", "Refiner"]


def __getattr__(name: str) -> Any:
    if name == "Refiner":  # on first use, as torch takes seconds
        return importlib.import_module("dgc_pose.refinement.refine").Refiner
    raise AttributeError(f"module 'dgc_pose.refinement' has no attribute '{name}'")
