"""Matching: from two images to matches, by the network, SIFT, optical flow, or from files."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from dgc_pose.matching.matcher import CorrespondenceMap, Matcher, MatchResult
from dgc_pose.matching.selection import MatchingOptions, select_matches
from dgc_pose.network.config import DEFAULT_WEIGHTS

if TYPE_CHECKING:
    from dgc_pose.matching.dense import DenseMatcher, load_dense_matcher

__all__ = [
    "DEFAULT_WEIGHTS",
    "CorrespondenceMap",
    "DenseMatcher",
    "MatchResult",
    "Matcher",
    "MatchingOptions",
    "load_dense_matcher",
    "select_matches",
]


def __getattr__(name: str) -> Any:
    # On first use, because torch takes seconds to import.
    if name in ("DenseMatcher", "load_dense_matcher"):
        return getattr(importlib.import_module("dgc_pose.matching.dense"), name)
    raise AttributeError(f"module 'dgc_pose.matching' has no attribute '{name}'")
