"""The verdict: whether a model is a pose, a rotation alone, or nothing.

The number of inliers does not decide it: random matches have inliers, and after a pure rotation
all matches are inliers of an arbitrary translation.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dgc_pose.estimation.evidence import Evidence
from dgc_pose.estimation.options import VerdictOptions
from dgc_pose.estimation.result import percent_text
from dgc_pose.estimation.status import STATUSES, Status


class Verdict(NamedTuple):
    """What a model is taken for."""

    status: Status
    reason: str  # one sentence for people
    warnings: tuple[str, ...] = ()


def judge(
    evidence: Evidence,
    options: VerdictOptions,
    probability: float | None = None,
    against: Sequence[str] = (),
    shares: Sequence[float] = (),
) -> Verdict:
    """The verdict on a model.

    Without a probability, or without `options.min_probability`, the first gate that the evidence
    fails decides. Otherwise the probability does, unless random matches have as many inliers, the
    translation is not determined at all, or most inliers lie behind a camera: the data that it is
    fitted on do not show these.
    probability: that a right pose is among those that explain the matches. against: what speaks
    against it, in words. shares: the probabilities of these poses if one is right, the likeliest
    first; () for a single one.
    """
    untold = _translation_untold(evidence, options)
    if probability is None or options.min_probability is None:
        # Chance before all: few inliers say nothing about a rotation either.
        failed = by_chance(evidence, options) or untold or _implausible(evidence, options)
        return failed or _moved_plane(evidence) or _pose(evidence, options)
    impossible = _random(evidence, options) or untold or _behind(evidence, options)
    if impossible is not None:
        return by_chance(evidence, options) or impossible
    if probability >= options.min_probability and (moved := _moved_plane(evidence)):
        return moved
    share = shares[0] if shares else 1.0
    if share * probability >= options.min_probability and share >= options.min_share:
        return _pose(evidence, options)
    if share < options.min_share and probability >= options.min_probability:
        return _ambiguous(probability, shares)
    probability *= share
    failed = by_chance(evidence, options) or _implausible(evidence, options)
    reason = f"the pose is right with a probability of {percent_text(probability)}"
    reason = ": ".join([reason, ", ".join(against)] if against else [reason])
    return Verdict("improbable" if failed is None else failed.status, reason)


def _ambiguous(probability: float, shares: Sequence[float]) -> Verdict:
    chances = [f"{100 * probability * share:.0f} %" for share in shares]
    listed = " and ".join([", ".join(chances[:-1]), chances[-1]])
    count = "two" if len(shares) == 2 else str(len(shares))
    reason = f"{count} poses explain the matches, with probabilities of {listed}"
    return Verdict("ambiguous", reason)


def by_chance(evidence: Evidence, options: VerdictOptions) -> Verdict | None:
    """Whether unrelated images could have such inliers."""
    least = max(options.min_inlier_ratio, options.chance_factor * evidence.chance_ratio)
    few = evidence.num_inliers < options.min_inliers or evidence.inlier_ratio < least
    if verdict := _random(evidence, options, few):
        return verdict
    if evidence.key_points or evidence.occupied_cells >= options.min_occupied_cells:
        return None
    reason = (
        f"the {evidence.num_inliers} inliers lie in only {evidence.occupied_cells} grid cells; "
        "unrelated images with a few similar patches have as many"
    )
    return Verdict("chance_inliers", reason)


def _random(evidence: Evidence, options: VerdictOptions, few: bool = False) -> Verdict | None:
    """Whether random matches would have as many inliers of some model. few: so they would."""
    if not few and evidence.log10_false_alarms <= options.max_log10_false_alarms:
        return None
    reason = (
        f"only {evidence.num_inliers} matches ({100 * evidence.inlier_ratio:.1f} %) agree on an "
        "essential matrix, which could be chance: so do "
        f"{100 * evidence.chance_ratio:.1f} % of wrong matches with the same model"
    )
    return Verdict("chance_inliers", reason)


def _translation_untold(evidence: Evidence, options: VerdictOptions) -> Verdict | None:
    """Whether many poses explain the matches, because the translation does not show."""
    if evidence.collinear:
        return Verdict("collinear", STATUSES["collinear"].meaning)
    # The model fits the noise of few matches: their errors come out too small by some 1 / sqrt.
    min_parallax = options.min_parallax * (1 + 4 / np.sqrt(max(evidence.num_rotation_inliers, 1)))
    rotates = evidence.rotation_share >= options.rotation_share
    strictly = evidence.strict_rotation_share >= options.strict_rotation_share
    if strictly or (rotates and evidence.parallax < min_parallax):
        reason = (
            f"a rotation alone explains {evidence.num_rotation_inliers} matches, as many as the "
            f"essential matrix does: the images do not determine the translation"
        )
        return Verdict("rotation_only", reason)
    if evidence.still_ratio >= options.strict_rotation_share:
        reason = (
            f"a camera that only turned, zoomed or cropped explains "
            f"{100 * evidence.still_ratio:.0f} % of the inliers: the images do not determine the "
            "translation"
        )
        return Verdict("rotation_only", reason)
    return None


def _behind(evidence: Evidence, options: VerdictOptions) -> Verdict | None:
    if evidence.cheirality_ratio >= options.min_cheirality:
        return None
    share = 100 * evidence.cheirality_ratio
    reason = f"only {share:.0f} % of the inliers lie in front of both cameras"
    return Verdict("behind_cameras", reason)


def _implausible(evidence: Evidence, options: VerdictOptions) -> Verdict | None:
    if behind := _behind(evidence, options):
        return behind
    for part in ("rotation", "translation"):
        error: float | None = getattr(evidence, f"jackknife_{part}_90_deg")
        if error is not None and error > options.max_error_deg:
            reason = (
                f"the {evidence.num_inliers} inliers do not determine the pose: its {part} may be "
                f"wrong by {error:.0f} deg"
            )
            return Verdict("undetermined", reason)
    return None


def _moved_plane(evidence: Evidence) -> Verdict | None:
    """Whether the plane that the matches lie on may have moved, and not the camera."""
    if not evidence.num_second_inliers:
        return None
    reason = (
        f"the {evidence.num_inliers} inliers lie on a plane, and {evidence.num_second_inliers} of "
        "the other matches agree on another motion: which of both is the camera's does not show"
    )
    return Verdict("ambiguous", reason)


def _pose(evidence: Evidence, options: VerdictOptions) -> Verdict:
    warnings: tuple[str, ...] = ()
    angle = evidence.median_triangulation_angle_deg
    if angle < options.small_angle_deg:
        warnings += (
            f"the median triangulation angle is {angle:.2f} deg: the translation is uncertain",
        )
    if evidence.homography_ratio < options.planar_share:
        return Verdict("ok", STATUSES["ok"].meaning, warnings)
    warnings += (
        f"one homography explains {100 * evidence.homography_ratio:.0f} % of the inliers: "
        "the scene is nearly a plane",
    )
    return Verdict("planar", STATUSES["planar"].meaning, warnings)
