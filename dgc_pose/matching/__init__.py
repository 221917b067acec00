"""Matching: from two images to matches, by the network, SIFT, a detector, or vismatch."""

from dgc_pose.matching.correspondence_map import CorrespondenceMap, MatchingOptions, select_matches
from dgc_pose.matching.matcher import Matcher, MatchResult
from dgc_pose.matching.network_matcher import NetworkMatcher
from dgc_pose.network.config import DEFAULT_WEIGHTS

__all__ = [
    "DEFAULT_WEIGHTS",
    "CorrespondenceMap",
    "MatchResult",
    "Matcher",
    "MatchingOptions",
    "NetworkMatcher",
    "select_matches",
]
