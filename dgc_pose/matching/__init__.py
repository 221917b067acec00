"""Matching: from two images to matches, by the frozen network or by SIFT."""

from dgc_pose.matching.dense import DenseMatcher, load_matcher
from dgc_pose.matching.matcher import CorrespondenceMap, Matcher
from dgc_pose.matching.selection import MatchingOptions
from dgc_pose.network.weights import DEFAULT as DEFAULT_WEIGHTS

__all__ = [
    "DEFAULT_WEIGHTS",
    "CorrespondenceMap",
    "DenseMatcher",
    "Matcher",
    "MatchingOptions",
    "load_matcher",
]
