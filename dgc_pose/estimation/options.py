"""Options of the estimation, each with its default and unit."""

from dataclasses import dataclass
from typing import Literal

from dgc_pose.system.options import MAX_SEED, check_options, option

# How much work goes into the matches of a pair; `dgc_pose.pose` lists the steps.
Effort = Literal["fast", "auto", "thorough"]
Second = Literal["auto", "none"]  # whether the steps of a pair include a second matcher


@dataclass(frozen=True)
class EstimationOptions:
    """How the pose is estimated. Raises InputError, naming the field, for a value out of range.

    Attributes:
        runs: Runs have different seeds; the hypothesis with most inliers is kept.
        refine: Whether to refine the best hypothesis on its inliers; the paper does not.
        min_probability: The probability decides, and the gates of `dgc_pose.estimation.verdict`
            name the reason of a failure. With None, and for matches without a fitted probability
            such as those of an unknown dense map, the gates decide.
    """

    effort: Effort = option(
        "auto",
        "fast: ends after a coarse pass if it has an answer; auto: more steps while the pose is "
        "uncertain; thorough: all steps.",
        metavar="HOW",
    )
    second: Second = option(
        "auto",
        "auto: for a pose in doubt, also matches of aliked-lightglue, if it is installed; of a "
        "folder, for pairs without a pose that would join two groups; none: no second matcher.",
        metavar="HOW",
        section="matching",
    )
    runs: int = option(
        5, "Runs of RANSAC, the best kept.", metavar="N", min=1, max=10_000, section="estimation"
    )
    iterations: int = option(
        1000,
        "Maximum iterations of each run.",
        metavar="N",
        min=1,
        max=2**31 - 1,
        section="estimation",
    )
    threshold_px: float | None = option(
        None,
        "Largest epipolar error of an inlier, original pixels; default: 2 times what the matcher "
        "expects.",
        flag="--threshold",
        metavar="PX",
        above=0,
        max=1000,
        section="estimation",
    )
    seed: int = option(
        0,
        "Random seed.",
        metavar="N",
        min=0,
        max=MAX_SEED,
        section="estimation",
    )
    refine: bool = True
    min_probability: float | None = option(
        0.5,
        "Required probability that R and t are both within 10 degrees.",
        metavar="P",
        min=0,
        max=1,
        section="estimation",
    )

    def __post_init__(self) -> None:
        check_options(self)
