"""The rivals by their names, beside the matchers that `dgc_pose.matchers.KINDS` has."""

from dgc_pose.benchmarks.rivals.deep_matching import DeepMatcher
from dgc_pose.matchers import MatcherCaches, MatcherKind, MatcherOptions
from dgc_pose.matching import Matcher
from dgc_pose.runtime.engine import Engine


def _rocco(options: MatcherOptions, _: MatcherCaches | None, engine: Engine | None) -> Matcher:
    from dgc_pose.benchmarks.rivals.rocco import RoccoMatcher  # needs torch

    return RoccoMatcher(options.matching, options.device)


RIVALS = {
    "rocco": MatcherKind("rocco", _rocco, dense_map=True),
    "deepmatching": MatcherKind(
        "deepmatching", lambda options, *_: DeepMatcher(options.matching), dense_map=True
    ),
}


def kind_of(options: MatcherOptions) -> MatcherKind:
    """The kind of a matcher, that of a rival too."""
    return RIVALS.get(options.weights) or options.kind
