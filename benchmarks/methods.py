"""The matchers of a benchmark, by name."""

from __future__ import annotations

from collections.abc import Sequence

from dgc_pose.errors import InputError
from dgc_pose.matching import Matcher, MatchingOptions, load_matcher
from dgc_pose.matching.sift import SiftMatcher

SIFT = "sift"


def load_methods(
    names: Sequence[str], *, device: str, options: MatchingOptions
) -> dict[str, Matcher]:
    """Load every method named: `sift`, the name of shipped weights, or a path to weights.

    Raises InputError where there are no names or one stands twice, and WeightsError where weights
    cannot be loaded.
    """
    if not names:
        raise InputError("no methods named")
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"the method {name} is named twice")
    return {
        name: SiftMatcher() if name == SIFT else load_matcher(name, device=device, options=options)
        for name in names
    }
