"""Matching: from two images to matches, by the frozen network or by SIFT."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from dgc_pose.matching.matcher import CorrespondenceMap, Matcher
from dgc_pose.matching.selection import MatchingOptions
from dgc_pose.network.config import DEFAULT_WEIGHTS

if TYPE_CHECKING:
    from dgc_pose.matching.dense import DenseMatcher, load_matcher

__all__ = [
    "DEFAULT_WEIGHTS",
    "CorrespondenceMap",
    "DenseMatcher",
    "Matcher",
    "MatchingOptions",
    "load_matcher",
]


def __getattr__(name: str) -> Any:
    # On first use, as torch takes seconds: a command that refuses its arguments needs none of it.
    if name in ("DenseMatcher", "load_matcher"):
        return getattr(importlib.import_module("dgc_pose.matching.dense"), name)
    raise AttributeError(f"module 'dgc_pose.matching' has no attribute '{name}'")
