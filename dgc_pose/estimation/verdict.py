"""The verdict: whether what the estimator found is a pose, a rotation alone, or nothing.

An inlier count does not tell: random matches have inliers, and a pure rotation has all of them
with an arbitrary translation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgc_pose.estimation.chance import chance_ratio, log10_false_alarms
from dgc_pose.estimation.consensus import Model
from dgc_pose.estimation.options import VerdictOptions
from dgc_pose.estimation.result import Status
from dgc_pose.geometry.epipolar import essential_from_pose
from dgc_pose.geometry.rotation import fit_rotation
from dgc_pose.geometry.triangulation import (
    epipolar_angles,
    triangulation_angles_deg,
    unit_rays,
)

_ROTATION_LIMIT = 6.0  # angle that a rotation may leave of a match, over the epipolar threshold
_NORMAL_MEDIAN = 0.6745  # of |x|, and of |(x, y)|, of Gaussian noise with a deviation of 1
_RAYLEIGH_MEDIAN = 1.1774
_LEAST_ERROR = 0.05  # of the threshold: matches are not believed to be better than that


@dataclass(frozen=True)
class Evidence:
    """What the verdict rests on."""

    inlier_ratio: float  # of all matches
    chance_ratio: float  # the same model's, of the same points paired wrongly
    log10_false_alarms: float  # models that random matches would give so many inliers
    cheirality_ratio: float  # inliers in front of both cameras
    rotation: np.ndarray  # (3, 3) the rotation that explains most matches alone
    rotation_share: float  # matches that it explains, over the inliers
    parallax: float  # spread of the motion that it leaves, over that of the error across lines
    num_turned: int  # matches that it explains, which the parallax is measured on
    still_share: float  # of the inliers that it leaves no farther off than the threshold
    median_angle_deg: float  # triangulation angle of the inliers
    homography_ratio: float  # of the inliers that one homography explains
    on_a_line: bool  # the inliers of either image lie on one line
    # That the inliers lie in, in the image where these are fewer; None of key points.
    places: int | None
    rotation_error_90_deg: float | None = None  # to expect, nine times in ten; None: not known


def gather(
    points1: np.ndarray,
    points2: np.ndarray,
    model: Model,
    threshold: float,
    homography_ratio: float,
    seed: int,
    *,
    cells: tuple[float, float] | None,
    rotation_error_90_deg: float | None = None,
) -> Evidence:
    """Measure the evidence of a model of normalised matches (N, 2).

    cells: the side of a place in each image, in the points' unit; None where each match is
    evidence by itself.
    """
    kept = model.inliers
    first, second = points1[kept], points2[kept]
    E = essential_from_pose(model.R, model.t)
    chance = chance_ratio(points1, points2, E, threshold, seed)
    rotation = robust_rotation(first, second, 2 * threshold)
    # Of all matches and not of the inliers alone: these were chosen for a small error across.
    motion = np.linalg.norm(unit_rays(points1) @ rotation.T - unit_rays(points2), axis=1)
    turned = motion < _ROTATION_LIMIT * threshold
    across = epipolar_angles(points1[turned], points2[turned], E)
    angles = triangulation_angles_deg(first, second, model.R)
    spread = min(_spread(first), _spread(second)) if len(first) > 1 else 0.0
    return Evidence(
        inlier_ratio=float(kept.mean()),
        chance_ratio=chance,
        log10_false_alarms=log10_false_alarms(len(points1), model.count, chance),
        cheirality_ratio=float(model.in_front[kept].mean()) if kept.any() else 0.0,
        rotation=rotation,
        rotation_share=float(turned.sum() / max(kept.sum(), 1)),
        parallax=_parallax(motion[turned], across, _LEAST_ERROR * threshold),
        num_turned=int(turned.sum()),
        # A motion has the noise of both images, the epipolar error that of one: sqrt(2) apart.
        still_share=float((motion[kept] < np.sqrt(2) * threshold).sum() / max(kept.sum(), 1)),
        median_angle_deg=float(np.median(angles)) if len(angles) else 0.0,
        homography_ratio=homography_ratio,
        on_a_line=spread < 2 * threshold,
        places=None
        if cells is None
        else min(_places(first, cells[0]), _places(second, cells[1])),
        rotation_error_90_deg=rotation_error_90_deg,
    )


def judge(
    evidence: Evidence, num_inliers: int, options: VerdictOptions
) -> tuple[Status, str, tuple[str, ...]]:
    """The status, the reason in a sentence, and warnings."""
    ratio, chance = evidence.inlier_ratio, evidence.chance_ratio
    least = max(options.min_inlier_ratio, options.chance_factor * chance)
    by_chance = evidence.log10_false_alarms > options.max_log10_false_alarms
    if by_chance or num_inliers < options.min_inliers or ratio < least:
        reason = (
            f"only {num_inliers} matches ({100 * ratio:.1f} %) agree on an essential matrix; "
            f"{100 * chance:.1f} % of wrong matches would, and the best of many models finds more"
        )
        return "chance_inliers", reason, ()
    if evidence.places is not None and evidence.places < options.min_places:
        reason = (
            f"the {num_inliers} inliers lie in {evidence.places} places only: a few patches that "
            f"look alike would give as many"
        )
        return "chance_inliers", reason, ()
    if evidence.on_a_line:
        return "no_model", "the inliers lie on one line, which many poses allow", ()
    # A model fits the noise of few matches: what it leaves of them is too small by some 1 / sqrt.
    least_parallax = options.min_parallax * (1 + 4 / np.sqrt(max(evidence.num_turned, 1)))
    turns = evidence.rotation_share >= options.rotation_share
    still = evidence.still_share >= options.still_share
    if still or (turns and evidence.parallax < least_parallax):
        reason = (
            f"a rotation alone explains {evidence.num_turned} matches, as many as the essential "
            f"matrix: the images do not tell the translation"
        )
        return "rotation_only", reason, ()
    if evidence.cheirality_ratio < options.min_cheirality:
        reason = (
            f"only {100 * evidence.cheirality_ratio:.0f} % of the inliers lie in front of "
            f"both cameras"
        )
        return "behind_cameras", reason, ()
    error = evidence.rotation_error_90_deg
    if error is not None and error > options.max_rotation_error_deg:
        reason = (
            f"the {num_inliers} inliers lie so that they hardly tell the pose: its rotation may be "
            f"{error:.0f} deg off"
        )
        return "no_model", reason, ()
    warnings = []
    if evidence.median_angle_deg < options.small_angle_deg:
        warnings.append(
            f"the median triangulation angle is {evidence.median_angle_deg:.2f} deg: "
            f"the translation is uncertain"
        )
    if evidence.homography_ratio >= options.planar_share:
        warnings.append(
            f"one homography explains {100 * evidence.homography_ratio:.0f} % of the inliers: "
            f"the scene is nearly a plane, which allows a second pose"
        )
        return "planar", "a pose from a nearly planar scene", tuple(warnings)
    return "ok", "a pose", tuple(warnings)


def robust_rotation(
    points1: np.ndarray, points2: np.ndarray, threshold: float, rounds: int = 10
) -> np.ndarray:
    """The rotation (3, 3) that turns rays 1 into rays 2.

    Least squares (Kabsch) on all matches, then again on the half nearest to it and on all that lie
    within `threshold` (normalised), whichever are more, until they stay the same.
    """
    rays1, rays2 = unit_rays(points1), unit_rays(points2)
    kept = np.ones(len(rays1), dtype=bool)
    R = np.eye(3)
    for _ in range(rounds):
        if kept.sum() < 2:
            break
        R = fit_rotation(rays1[kept], rays2[kept])
        distance = np.linalg.norm(rays1 @ R.T - rays2, axis=1)
        following = distance <= max(threshold, float(np.median(distance)))
        if np.array_equal(following, kept):
            break
        kept = following
    return R


def _places(points: np.ndarray, side: float) -> int:
    """How many cells of a grid the points (N, 2) lie in."""
    return len({tuple(cell) for cell in np.floor(points / side).astype(int).tolist()})


def _parallax(motion: np.ndarray, across: np.ndarray, least: float) -> float:
    """Spread of the motion (N,) that a rotation leaves, over that of the error (N,) across lines.

    Each by its median, made a standard deviation of Gaussian noise in two dimensions and in one:
    the noise of the matches moves points along their epipolar lines as much as across them, so a
    pure rotation gives 1, or a little more where the essential matrix fits the noise of few
    matches, and a real translation gives more. The error counts as `least` at least, lest exact
    copies, which leave nothing of either, have a parallax of rounding errors.
    """
    if not len(motion):
        return 0.0
    left, error = np.median(motion) / _RAYLEIGH_MEDIAN, np.median(across) / _NORMAL_MEDIAN
    return float(left / max(error, least))


def _spread(points: np.ndarray) -> float:
    """Standard deviation of points (N, 2) across the line through them that fits best."""
    return float(np.sqrt(max(np.linalg.eigvalsh(np.cov(points.T))[0], 0.0)))
