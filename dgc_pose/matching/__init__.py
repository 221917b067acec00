"""Matching: from two images to matches, by the network, SIFT, optical flow, or from files."""

from dgc_pose.matching.dense import DenseMatcher, load_dense_matcher
from dgc_pose.matching.matcher import CorrespondenceMap, Matcher, MatchResult, PairSearch
from dgc_pose.matching.selection import MatchingOptions, select_matches
from dgc_pose.network.config import DEFAULT_WEIGHTS

__all__ = [
    "DEFAULT_WEIGHTS",
    "CorrespondenceMap",
    "DenseMatcher",
    "MatchResult",
    "Matcher",
    "MatchingOptions",
    "PairSearch",
    "load_dense_matcher",
    "select_matches",
]
