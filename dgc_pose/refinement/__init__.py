"""Refinement: matches at the accuracy of the original photographs, whatever the matcher."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from dgc_pose.refinement.options import (
    AlignmentOptions,
    FeatureOptions,
    FlowOptions,
    RefinementOptions,
    SourceName,
)

if TYPE_CHECKING:
    from dgc_pose.refinement.features import FeatureMatches
    from dgc_pose.refinement.flow import FlowMatches
    from dgc_pose.refinement.refiner import Refiner
    from dgc_pose.refinement.source import MapMatches, MatchSource

# Imported on first use, because torch takes seconds to import.
_HOMES = {
    "FeatureMatches": "features",
    "FlowMatches": "flow",
    "MapMatches": "source",
    "MatchSource": "source",
    "Refiner": "refiner",
}

__all__ = [
    "AlignmentOptions",
    "FeatureMatches",
    "FeatureOptions",
    "FlowMatches",
    "FlowOptions",
    "MapMatches",
    "MatchSource",
    "RefinementOptions",
    "Refiner",
    "SourceName",
]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(f"dgc_pose.refinement.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'dgc_pose.refinement' has no attribute '{name}'")
