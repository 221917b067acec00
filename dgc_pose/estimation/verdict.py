"""The verdict: whether what the estimator found is a pose, a rotation alone, or nothing.

An inlier count does not tell: random matches have inliers, and a pure rotation has all of them
with an arbitrary translation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgc_pose.estimation.consensus import Model
from dgc_pose.estimation.options import VerdictOptions
from dgc_pose.estimation.result import Status
from dgc_pose.geometry.epipolar import essential_from_pose, sampson_distance
from dgc_pose.geometry.rotation import fit_rotation
from dgc_pose.geometry.triangulation import triangulation_angles_deg, unit_rays

_SHUFFLES = 8  # random pairings that the chance level is measured on


@dataclass(frozen=True)
class Evidence:
    """What the verdict rests on."""

    inlier_ratio: float  # of all matches
    chance_ratio: float  # the same model's, of the same points paired at random
    cheirality_ratio: float  # inliers in front of both cameras
    rotation: np.ndarray  # (3, 3) the rotation that explains most matches alone
    rotation_share: float  # of the inliers that it explains
    parallax: float  # median motion that it leaves along epipolar lines, over the error across
    median_angle_deg: float  # triangulation angle of the inliers
    homography_ratio: float  # of the inliers that one homography explains


def gather(
    points1: np.ndarray,
    points2: np.ndarray,
    model: Model,
    threshold: float,
    homography_ratio: float,
    seed: int,
) -> Evidence:
    """Measure the evidence of a model of normalised matches (N, 2)."""
    kept = model.inliers
    first, second = points1[kept], points2[kept]
    E = essential_from_pose(model.R, model.t)
    rotation, explained = robust_rotation(first, second, 2 * threshold)
    angles = triangulation_angles_deg(first, second, model.R)
    return Evidence(
        inlier_ratio=float(kept.mean()),
        chance_ratio=_chance_ratio(points1, points2, E, threshold, seed),
        cheirality_ratio=float(model.in_front[kept].mean()) if kept.any() else 0.0,
        rotation=rotation,
        rotation_share=float(explained.mean()) if len(explained) else 0.0,
        parallax=_parallax(first, second, rotation, E),
        median_angle_deg=float(np.median(angles)) if len(angles) else 0.0,
        homography_ratio=homography_ratio,
    )


def judge(
    evidence: Evidence, num_inliers: int, options: VerdictOptions
) -> tuple[Status, str, tuple[str, ...]]:
    """The status, the reason in a sentence, and warnings."""
    ratio, chance = evidence.inlier_ratio, evidence.chance_ratio
    least = max(options.min_inlier_ratio, options.chance_factor * chance)
    if num_inliers < options.min_inliers or ratio < least:
        reason = (
            f"only {num_inliers} matches ({100 * ratio:.1f} %) agree on an essential matrix; "
            f"{100 * chance:.1f} % would by chance"
        )
        return "chance_inliers", reason, ()
    if (
        evidence.rotation_share >= options.rotation_share
        and evidence.parallax < options.min_parallax
    ):
        reason = (
            f"a rotation alone explains {100 * evidence.rotation_share:.0f} % of the inliers: "
            f"the images do not tell the translation"
        )
        return "rotation_only", reason, ()
    if evidence.cheirality_ratio < options.min_cheirality:
        reason = (
            f"only {100 * evidence.cheirality_ratio:.0f} % of the inliers lie in front of "
            f"both cameras"
        )
        return "behind_cameras", reason, ()
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
) -> tuple[np.ndarray, np.ndarray]:
    """The rotation (3, 3) that turns rays 1 into rays 2, and which matches (N,) it explains.

    Least squares (Kabsch) on all matches, then again on the half nearest to it and on all that lie
    within `threshold` (normalised), whichever are more, until they stay the same.
    """
    rays1, rays2 = unit_rays(points1), unit_rays(points2)
    kept = np.ones(len(rays1), dtype=bool)
    R = np.eye(3)
    explained = np.zeros(len(rays1), dtype=bool)
    for _ in range(rounds):
        if kept.sum() < 2:
            break
        R = fit_rotation(rays1[kept], rays2[kept])
        distance = np.linalg.norm(rays1 @ R.T - rays2, axis=1)
        explained = distance < threshold
        following = distance <= max(threshold, float(np.median(distance)))
        if np.array_equal(following, kept):
            break
        kept = following
    return R, explained


def _chance_ratio(
    points1: np.ndarray, points2: np.ndarray, E: np.ndarray, threshold: float, seed: int
) -> float:
    """The inlier ratio that the model gets of the same points, paired at random."""
    rng = np.random.default_rng(seed)
    shuffled = [rng.permutation(len(points1)) for _ in range(_SHUFFLES)]
    counts = [(sampson_distance(points1[s], points2, E) < threshold).mean() for s in shuffled]
    return float(np.mean(counts))


def _parallax(
    points1: np.ndarray, points2: np.ndarray, rotation: np.ndarray, E: np.ndarray
) -> float:
    """Median motion that a rotation leaves, over the median epipolar error of E.

    The noise of the matches moves points along their epipolar lines as much as across them, so a
    pure rotation gives about 1 to 2 and a real translation much more. Exact matches that leave
    nothing give 0.
    """
    if not len(points1):
        return 0.0
    left = np.linalg.norm(unit_rays(points1) @ rotation.T - unit_rays(points2), axis=1)
    across = np.median(sampson_distance(points1, points2, E))
    motion = np.median(left)
    if motion < 1e-9:
        return 0.0
    return float(motion / max(across, 1e-9))
