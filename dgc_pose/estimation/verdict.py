"""The verdict: whether a hypothesis is a pose, a pure rotation, or nothing.

The number of inliers does not decide: random matches have inliers, and after a pure rotation all
matches are inliers of an arbitrary translation.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dgc_pose.estimation.evidence import Evidence
from dgc_pose.estimation.robust_fit import PLANAR_SHARE
from dgc_pose.estimation.status import STATUSES, Status, percent_text

MIN_SHARE = 0.8  # of the probability, that the likeliest of several poses needs for a claim
_MIN_INLIERS = 15
_MIN_INLIER_RATIO = 0.15  # among all matches
# Decimal logarithm of the expected number of poses with as many inliers in random matches.
_MAX_LOG10_FALSE_ALARMS = -2.0
# Inlier ratio over that of the same pose if the points are paired wrongly. Unlike the expected
# number above, it accounts for correlated errors of neighbouring matches.
_MIN_OVER_CHANCE = 3.0
# Grid cells, 1/24 of the longer side wide, that inliers of a dense map must occupy: one similar
# patch in unrelated images gives dozens of matches. Not required of key points.
_MIN_OCCUPIED_CELLS = 20
_MIN_CHEIRALITY = 0.6  # share of inliers in front of both cameras
# "rotation_only" with little parallax: matches that a rotation explains, over the inliers.
_ROTATION_SHARE = 0.8
# "rotation_only" with any parallax: share of inliers that a rotation explains within the epipolar
# threshold. Smooth errors of dense matches resemble a translation.
_STRICT_ROTATION_SHARE = 0.9
_MIN_PARALLAX = 1.5  # motion left by a rotation over the epipolar error; more for few matches
# Raw error of R or t in nine cases of ten, with which half of normal errors are within 10 degrees.
_MAX_ERROR_DEG = 24.0
# Largest error of a fitted focal length, in nine cases of ten, for a pose from a plane: on a plane
# only the prior determines the focal length, even if the matches seem to.
_MAX_FOCAL_PERCENT = 4.0
_NOTHING_BUT_PLANE = 0.95  # homography ratio above which the data of the fit have no right pose
# Cells around a plane that contradict its pose, over those of the plane, above which it may have
# moved: 0.17 to 0.46 if it had, 0.03 on a plane that had not (docs/experiments.md).
_MAX_AROUND_PLANE = 0.1
_SAME_ROTATION_DEG = 3.0  # up to this angle, the rotations of two motions do not contradict
_SMALL_ANGLE_DEG = 1.0  # median triangulation angle below which there is a warning


class Verdict(NamedTuple):
    """The status of a hypothesis, and why."""

    status: Status
    reason: str  # one sentence for people
    warnings: tuple[str, ...] = ()


def judge(
    evidence: Evidence,
    min_probability: float | None,
    probability: float | None = None,
    against: Sequence[str] = (),
    shares: Sequence[float] = (),
    same_place: float = 1.0,
) -> Verdict:
    """The verdict on the likeliest hypothesis.

    Without a probability, or without `min_probability`, the first gate that the evidence fails
    decides. Otherwise the probability decides, except in cases that the data of its fit do not
    show: random matches have as many inliers, an image is a panorama, the inliers do not determine
    the translation at all, or many of them lie behind a camera.
    probability: that a right pose is among those that explain the matches. against: reasons against
    it, in words. shares: the probabilities of these poses if one is right, the likeliest first; ()
    for a single one. same_place: the probability that both images show one place; the other
    probabilities assume this.
    """
    undetermined = _undetermined_translation(evidence)
    if probability is None or min_probability is None:
        # Chance comes first: few inliers are no evidence of a rotation either.
        failed = by_chance(evidence) or _panorama(evidence) or undetermined
        return failed or _implausible(evidence) or _moved_plane(evidence) or _pose(evidence)
    impossible = _random(evidence) or _panorama(evidence) or undetermined or _behind(evidence)
    if impossible is not None:
        return by_chance(evidence) or impossible
    share = shares[0] if shares else 1.0
    whole = same_place * share * probability
    if probability >= min_probability:
        if moved := _moved_plane(evidence):
            return moved
        if share < MIN_SHARE:
            chances = [f"{100 * same_place * probability * each:.0f} %" for each in shares]
            count = "two" if len(shares) == 2 else str(len(shares))
            listed = " and ".join([", ".join(chances[:-1]), chances[-1]])
            reason = f"{count} poses explain the matches: probabilities {listed}"
            return Verdict("ambiguous", reason)
        if whole >= min_probability:
            return _pose(evidence)
    failed = None
    if share * probability < min_probability:  # else only `same_place` makes it improbable
        failed = by_chance(evidence) or _implausible(evidence)
    reason = f"probability {percent_text(whole)}, below the required {100 * min_probability:g} %"
    reason = ": ".join([reason, ", ".join(against)] if against else [reason])
    return Verdict("improbable" if failed is None else failed.status, reason)


def by_chance(evidence: Evidence) -> Verdict | None:
    """The verdict that unrelated images could have such inliers, if so."""
    least = max(_MIN_INLIER_RATIO, _MIN_OVER_CHANCE * evidence.chance_ratio)
    few = evidence.num_inliers < _MIN_INLIERS or evidence.inlier_ratio < least
    if verdict := _random(evidence, few):
        return verdict
    if evidence.key_points or evidence.occupied_cells >= _MIN_OCCUPIED_CELLS:
        return None
    reason = (
        f"the {evidence.num_inliers} inliers lie in only {evidence.occupied_cells} grid cells, as "
        "in unrelated images with a few similar patches"
    )
    return Verdict("chance_inliers", reason)


def _random(evidence: Evidence, few: bool = False) -> Verdict | None:
    """The verdict that random matches would have as many inliers, if so. few: known to be so."""
    if not few and evidence.log10_false_alarms <= _MAX_LOG10_FALSE_ALARMS:
        return None
    reason = (
        f"{evidence.num_inliers} matches ({100 * evidence.inlier_ratio:.1f} %) fit an essential "
        f"matrix, and {100 * evidence.chance_ratio:.1f} % of wrong matches do by chance"
    )
    return Verdict("chance_inliers", reason)


def _undetermined_translation(evidence: Evidence) -> Verdict | None:
    """The verdict that the matches do not determine the translation, if so."""
    if evidence.collinear:
        return Verdict("collinear", STATUSES["collinear"].meaning)
    # The pose fits the noise of few matches: their errors are too small, by some 1 / sqrt(number).
    min_parallax = _MIN_PARALLAX * (1 + 4 / np.sqrt(max(evidence.num_rotation_inliers, 1)))
    rotates = evidence.rotation_share >= _ROTATION_SHARE
    strictly = evidence.strict_rotation_share >= _STRICT_ROTATION_SHARE
    if strictly or (rotates and evidence.parallax < min_parallax):
        why = (
            f"a rotation explains {evidence.num_rotation_inliers} matches, as many as the "
            "essential matrix"
        )
    elif evidence.still_ratio >= _STRICT_ROTATION_SHARE:
        share = f"{100 * evidence.still_ratio:.0f} %"
        why = f"a turn, zoom or crop explains as many matches as {share} of the inliers"
    else:
        return None
    if evidence.num_second_inliers and evidence.second_rotation_deg >= _SAME_ROTATION_DEG:
        reason = (
            f"{why}; {evidence.num_second_inliers} other matches fit a motion with a rotation "
            f"{evidence.second_rotation_deg:.1f} deg away: either may be the camera's"
        )
        return Verdict("ambiguous", reason)
    return Verdict("rotation_only", f"{why}: the images do not determine t")


def _panorama(evidence: Evidence) -> Verdict | None:
    """The verdict that the images are on a cylinder, which has no pose, if so."""
    if evidence.camera_model != "cylinder":
        return None
    reason = (
        f"{evidence.num_inliers} matches fit a cylindrical panorama, not a photograph "
        "through a lens"
    )
    return Verdict("panorama", reason)


def _behind(evidence: Evidence) -> Verdict | None:
    if evidence.cheirality_ratio >= _MIN_CHEIRALITY:
        return None
    share = 100 * evidence.cheirality_ratio
    reason = f"only {share:.0f} % of the inliers lie in front of both cameras"
    return Verdict("behind_cameras", reason)


def _implausible(evidence: Evidence) -> Verdict | None:
    """The verdict that inliers lie behind a camera or do not determine the pose, if so."""
    if behind := _behind(evidence):
        return behind
    errors = evidence.raw_rotation_90_deg, evidence.raw_translation_90_deg
    for part, error in zip(("rotation", "translation"), errors, strict=True):
        if error is not None and error > _MAX_ERROR_DEG:
            reason = (
                f"the {evidence.num_inliers} inliers do not determine the pose: the error of its "
                f"{part} may be {error:.0f} deg"
            )
            return Verdict("undetermined", reason)
    return None


def is_amid_others(evidence: Evidence) -> bool:
    """Whether the inliers lie on a plane, and the matches around it fit no motion, not its either.
    Wrong key points lie anywhere."""
    on_plane = evidence.homography_ratio >= PLANAR_SHARE and not evidence.key_points
    is_contradicted = evidence.around_plane >= _MAX_AROUND_PLANE
    return on_plane and is_contradicted and not evidence.num_second_inliers


def _moved_plane(evidence: Evidence) -> Verdict | None:
    """The verdict that either of two motions may be the camera's, if so: the plane that the matches
    lie on may have moved, or a part of the scene."""
    if is_amid_others(evidence):
        reason = (
            f"the {evidence.num_inliers} inliers lie on a plane, and the matches around it do not "
            "fit its motion: the plane may have moved"
        )
        return Verdict("ambiguous", reason)
    if not evidence.num_second_inliers:
        return None
    plane = evidence.homography_ratio >= PLANAR_SHARE
    lie = "lie on a plane" if plane else "fit a motion"
    reason = (
        f"the {evidence.num_inliers} inliers {lie}, and {evidence.num_second_inliers} of "
        "the other matches fit another motion: either may be the camera's"
    )
    return Verdict("ambiguous", reason)


def _pose(evidence: Evidence) -> Verdict:
    warnings: tuple[str, ...] = ()
    angle = evidence.median_triangulation_angle_deg
    if angle < _SMALL_ANGLE_DEG:
        warnings += (
            f"the median triangulation angle is {angle:.2f} deg: the translation is uncertain",
        )
    if evidence.homography_ratio < PLANAR_SHARE:
        return Verdict("ok", STATUSES["ok"].meaning, warnings)
    share = f"one homography explains {100 * evidence.homography_ratio:.0f} % of the inliers"
    focal = evidence.raw_focal_90_percent or 0.0
    if focal > _MAX_FOCAL_PERCENT and evidence.homography_ratio >= _NOTHING_BUT_PLANE:
        reason = f"{share}: a plane does not determine the focal length"
        return Verdict("undetermined", reason)
    warnings += (f"{share}: the scene is nearly a plane",)
    return Verdict("planar", STATUSES["planar"].meaning, warnings)
