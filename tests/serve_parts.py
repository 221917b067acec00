"""A server's estimator without a network, for tests."""

import dense_scene

from dgc_pose.matching import Matcher
from dgc_pose.serve.estimator import Estimator


def map_matcher() -> Matcher:
    """Gives the true map of the dense scene."""
    return dense_scene.MapMatcher(dense_scene.true_map(error_px=0.2))


def estimator() -> Estimator:
    return Estimator(map_matcher(), None)
