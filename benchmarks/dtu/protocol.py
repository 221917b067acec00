"""The protocol of the paper's experiment (Melekhov et al., section 4.4)."""

from dataclasses import replace

from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions

PAPER_SIZE = (256, 256)  # width and height to which all images are squared
_EVERY_MATCH = 2**31  # more than any map has cells


def paper_options(
    matcher: MatcherOptions, estimation: EstimationOptions
) -> tuple[MatcherOptions, EstimationOptions]:
    """The same options, but every match of a pair is taken, as the map has it, and the pose is the
    best of the RANSAC runs, not refined.

    The paper's number of runs, 5 of 1000 iterations, is the default of `EstimationOptions`.
    """
    matching = replace(matcher.matching, max_matches=_EVERY_MATCH, aligned="none")
    return replace(matcher, matching=matching), replace(estimation, refine=False)
