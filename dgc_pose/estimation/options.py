"""Options of the estimation, each with its default and unit."""

from dataclasses import dataclass, field
from typing import Literal

from dgc_pose.system.options import MAX_SEED, check_options, option


@dataclass(frozen=True)
class VerdictOptions:
    """What is a pose, and what is none.

    Raises InputError, naming the field, for a value out of range.

    Attributes:
        min_probability: If this is None, and for key points, for which no probability is fitted,
            the gates below decide. Otherwise the probability decides, and the gates name the reason
            of a failure; only those of too few matches, false alarms, a rotation, a line and the
            cameras always hold.
        min_share: Least probability of the likeliest of several poses, if one of them is right.
            Below it, none is claimed.
        min_matches: Least number of distinct, finite matches.
        min_inliers: Least number of inliers.
        min_inlier_ratio: Least share of inliers among all matches.
        max_log10_false_alarms: Largest decimal logarithm of the expected number of models with so
            many inliers in random matches.
        chance_factor: Least inlier ratio, over that of the same model on the same points paired
            wrongly. It accounts for errors that neighbouring matches have in common, the expected
            number above does not.
        min_occupied_cells: Grid cells, 1/24 of the longer side wide, that inliers of a dense map
            must occupy: one similar patch in unrelated images gives dozens of matches. It is not
            asked of key points.
        min_cheirality: Least share of inliers in front of both cameras.
        rotation_share: "rotation_only": matches that a rotation explains, over the inliers, at
            least this, and a parallax below `min_parallax`.
        strict_rotation_share: "rotation_only" for any parallax: share of inliers that a rotation
            explains within the epipolar threshold. Smooth errors of dense matches resemble a
            translation.
        min_parallax: Motion left by a rotation, over the epipolar error, that counts as a
            translation; more for few matches.
        max_error_deg: Largest expected error of R and of t, by the jackknife, nine times in ten.
            Of normal errors with more, less than half are within 10 degrees.
        planar_share: Share of inliers that one homography explains on a plane.
        small_angle_deg: Median triangulation angle below which there is a warning.
        alternative_share: Inliers of another pose, over this one's, at which it is an alternative.
    """

    min_probability: float | None = option(
        0.5,
        "Least probability of a success: that R and t are both within 10 degrees.",
        metavar="P",
        min=0,
        max=1,
        section="estimation",
    )
    min_share: float = option(0.8, min=0, max=1)
    min_matches: int = 20
    min_inliers: int = 15
    min_inlier_ratio: float = 0.15
    max_log10_false_alarms: float = -2.0
    chance_factor: float = 3.0
    min_occupied_cells: int = 20
    min_cheirality: float = 0.6
    rotation_share: float = 0.8
    strict_rotation_share: float = 0.9
    min_parallax: float = 1.5
    max_error_deg: float = 24.0
    planar_share: float = 0.85
    small_angle_deg: float = 1.0
    alternative_share: float = option(0.75, above=0)

    def __post_init__(self) -> None:
        check_options(self)


# How much of the matching a pose gets; `dgc_pose.pose.pose_of_pair` has the steps.
Effort = Literal["fast", "auto", "thorough"]


@dataclass(frozen=True)
class EstimationOptions:
    """How the pose is estimated. Raises InputError, naming the field, for a value out of range.

    Attributes:
        runs: Runs have different seeds; the model with most inliers is kept.
        max_sampled: Matches that a run draws its samples from, chosen at random for each run. The
            time of RANSAC grows with the matches that it scores. The models are compared and
            refined on all matches.
        threshold_factor: The threshold over the matches' `error_px`, without `threshold_px`.
        refine: Whether the best model is refined on its inliers.
        verdict: What is a pose, and what is none.
    """

    effort: Effort = option(
        "auto",
        "fast: a quick pass over small images; auto: and more while the pose is uncertain; "
        "thorough: all that may help.",
        metavar="HOW",
    )
    runs: int = option(
        5, "Runs of RANSAC, the best kept.", metavar="N", min=1, max=10_000, section="estimation"
    )
    iterations: int = option(
        1000,
        "Most iterations of each run.",
        metavar="N",
        min=1,
        max=2**31 - 1,
        section="estimation",
    )
    max_sampled: int = option(3000, min=100)
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
    threshold_factor: float = option(2.0, above=0)
    seed: int = option(
        0, "The same seed, the same pose.", metavar="N", min=0, max=MAX_SEED, section="estimation"
    )
    refine: bool = True
    verdict: VerdictOptions = field(default_factory=VerdictOptions)

    def __post_init__(self) -> None:
        check_options(self)
