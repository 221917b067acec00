"""The measurements behind the verdict."""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from dgc_pose.estimation.camera_model import ModelName
from dgc_pose.estimation.problem import Hypothesis, TwoViewProblem
from dgc_pose.estimation.robust_fit import MINIMAL, TRANSFER_LIMIT
from dgc_pose.geometry.epipolar import (
    epipolar_angles,
    sampson_distance,
    triangulation_angles_deg,
    unit_rays,
)
from dgc_pose.geometry.homography import transfer_error
from dgc_pose.geometry.rotation import aligning_rotation, rotation_angle_deg
from dgc_pose.system.parallel import slices

_ROTATION_LIMIT = 6.0  # residual angle of a match under a rotation, over the epipolar threshold
_ROTATION_ROUNDS = 10
_NORMAL_MEDIAN = 0.6745  # of |x|, for Gaussian noise with a deviation of 1
_RAYLEIGH_MEDIAN = 1.1774  # of |(x, y)|, for the same noise
_MIN_ERROR = 0.05  # of the threshold: matches count as no more accurate than this
_PAIRS = 20_000  # wrong pairs that measure the chance level, if there are enough
_AT_A_TIME = 4000  # wrong pairs
_MIN_ROUNDS = 8  # in each, a point has another wrong partner
# `Matches.context_ratio` of right pairs falls with the logarithm of the rotation: method.md
_LESS_ALIKE = 0.14
_LESS_ALIKE_DEG = 3.0


@dataclass(frozen=True, eq=False)
class Evidence:
    """The measurements of the likeliest hypothesis.

    Attributes:
        num_inliers: Number of matches that the hypothesis explains.
        inlier_ratio: Inliers as a share of all matches.
        chance_ratio: The inlier ratio of the same pose if the points are paired wrongly.
        log10_false_alarms: Decimal logarithm of the expected number of poses with as many inliers
            in random matches.
        cheirality_ratio: Share of inliers in front of both cameras.
        rotation: The rotation (3, 3) that explains most matches without a translation.
        num_rotation_inliers: Matches that `rotation` explains, on which the parallax is measured.
        rotation_share: `num_rotation_inliers` over the inliers.
        strict_rotation_share: Share of inliers that `rotation` explains within the threshold.
        parallax: Motion left by `rotation` over the epipolar error, both as standard deviations.
        median_triangulation_angle_deg: Median angle between the two rays of an inlier, degrees.
        collinear: Whether the inliers of either image lie on one line.
        occupied_cells: Grid cells with inliers, in the image with fewer of them.
        key_points: Whether the matches are independent detections.
        residual: Median epipolar error of the inliers, over the threshold.
        threshold_cells: The threshold over the side of a grid cell, mean of both images.
        confidence: Median confidence of the inliers.
        homography_ratio: Share of inliers that one homography explains.
        raw_rotation_90_deg: Bound of the error of R in nine cases of ten, by its covariance, not
            calibrated; None if unknown.
        raw_translation_90_deg: The same for the direction of t.
        raw_focal_90_percent: The same for ln f, per cent; None if K is exact.
        other_ratio: Most inliers in front of both cameras in another hypothesis, over this one's.
        map_matchability: Mean matchability of the dense map; None without one.
        map_agreement: Share of the map's cells, weighted by squared matchability, that agree with
            the pose; None without a map.
        map_chance: The same share if the cells are paired wrongly; None without a map.
        context_ratio: Similarity of the images around the matches over that at them, see
            `rotation_corrected`; None if unknown.
        still_ratio: Matches that a camera without a translation explains (`still_camera`), over the
            inliers; at most 1.
        num_second_inliers: Inliers of another motion among the outliers, more than chance explains;
            0 without one.
        second_rotation_deg: Angle between the rotation of this motion and `rotation`.
        around_plane: How much the matches around the plane of the inliers contradict the pose, as
            a share of its grid cells; 0 without a plane.
        camera_model: The camera that the matches agree with, see `camera_model`.
        camera_agreement: Probability that the pose is within 10 degrees of the right camera's pose,
            if each camera has a right pose.
        camera_doubt: Log-odds of the likeliest other camera, from the matches only.
    """

    num_inliers: int
    inlier_ratio: float
    chance_ratio: float
    log10_false_alarms: float
    cheirality_ratio: float
    rotation: np.ndarray
    num_rotation_inliers: int
    rotation_share: float
    strict_rotation_share: float
    parallax: float
    median_triangulation_angle_deg: float
    collinear: bool
    occupied_cells: int
    key_points: bool
    residual: float
    threshold_cells: float
    confidence: float
    homography_ratio: float = 0.0
    raw_rotation_90_deg: float | None = None
    raw_translation_90_deg: float | None = None
    raw_focal_90_percent: float | None = None
    other_ratio: float = 0.0
    map_matchability: float | None = None
    map_agreement: float | None = None
    map_chance: float | None = None
    context_ratio: float | None = None
    still_ratio: float = 0.0
    num_second_inliers: int = 0
    second_rotation_deg: float = 0.0
    around_plane: float = 0.0
    camera_model: ModelName = "assumed"
    camera_agreement: float = 1.0
    camera_doubt: float = -math.inf

    @property
    def over_chance(self) -> float:
        """The inlier ratio over that of wrong matches."""
        return self.inlier_ratio / max(self.chance_ratio, 1e-6)

    @property
    def map_over_chance(self) -> float:
        """Share of the dense map that agrees with the pose, less the share by chance."""
        return (self.map_agreement or 0.0) - (self.map_chance or 0.0)


def measured(
    problem: TwoViewProblem, pose: Hypothesis, map_problem: TwoViewProblem | None = None
) -> Evidence:
    """The evidence for and against a hypothesis, except the part that depends on other hypotheses
    or cameras. map_problem: an even sample of the dense map."""
    threshold = problem.threshold
    is_inlier = pose.inliers
    around = problem.matches.context_ratio
    inliers = problem.subset(is_inlier)
    count = max(len(inliers), 1)
    chance = chance_ratio(problem, pose.E)
    rotation = robust_rotation(inliers)
    # Over all matches: the inliers were chosen for a small error across the epipolar lines.
    rays1 = unit_rays(problem.points1)
    rays2 = unit_rays(problem.points2)
    motion = np.linalg.norm(rays1 @ rotation.T - rays2, axis=1)
    explained = motion < _ROTATION_LIMIT * threshold
    rotated = problem.subset(explained)
    across = epipolar_angles(rotated.points1, rotated.points2, pose.E)
    angles = triangulation_angles_deg(inliers.points1, inliers.points2, pose.R)
    in_cells = inliers.points1 / problem.cells[0], inliers.points2 / problem.cells[1]
    evidence = Evidence(
        num_inliers=pose.num_inliers,
        inlier_ratio=float(is_inlier.mean()),
        chance_ratio=chance,
        log10_false_alarms=log10_false_alarms(len(problem), pose.num_inliers, chance),
        cheirality_ratio=float(np.mean(pose.in_front[is_inlier])) if len(inliers) else 0.0,
        rotation=rotation,
        num_rotation_inliers=len(rotated),
        rotation_share=len(rotated) / count,
        # The motion has the noise of both images, the epipolar error that of one: sqrt(2) apart.
        strict_rotation_share=float((motion[is_inlier] < np.sqrt(2) * threshold).sum() / count),
        parallax=_parallax(motion[explained], across, _MIN_ERROR * threshold),
        median_triangulation_angle_deg=_median(angles),
        collinear=min(_width(inliers.points1), _width(inliers.points2)) < 2 * threshold,
        occupied_cells=min(map(_occupied, in_cells)),
        key_points=problem.matches.key_points,
        residual=_median(sampson_distance(inliers.points1, inliers.points2, pose.E)) / threshold,
        threshold_cells=threshold * float(np.mean(1 / np.array(problem.cells))),
        confidence=_median(inliers.confidence),
        context_ratio=None if around is None else rotation_corrected(around, pose.R),
    )
    if not map_problem:
        return evidence
    order = np.random.default_rng(map_problem.options.seed).permutation(len(map_problem))
    wrong = replace(map_problem, points1=map_problem.points1[order])
    return replace(
        evidence,
        map_matchability=float(map_problem.confidence.mean()),
        map_agreement=pose.agreement(map_problem),
        map_chance=pose.agreement(wrong),
    )


def around_plane(problem: TwoViewProblem, pose: Hypothesis, H: np.ndarray) -> float:
    """How much around a plane contradicts its pose: the grid cells of image 1 with matches outside
    of the plane's region in both images and without an inlier, less those with an inlier, over the
    cells of the plane. H: homography (3, 3) of the plane."""
    limit = TRANSFER_LIMIT * problem.threshold
    on_plane = pose.inliers & (transfer_error(problem.points1, problem.points2, H) < limit)
    if not on_plane.any():
        return 0.0
    outside = np.ones(len(problem), bool)
    for points, cell in zip((problem.points1, problem.points2), problem.cells, strict=True):
        in_cells = (points / cell).astype(np.float32)
        region = cv2.convexHull(in_cells[on_plane])
        inwards = [cv2.pointPolygonTest(region, point, True) for point in in_cells.tolist()]
        outside &= np.array(inwards) < -1.0  # cells
    in_cells1 = problem.points1 / problem.cells[0]
    around = _occupied(in_cells1[outside])
    agreeing = _occupied(in_cells1[outside & pose.inliers])
    return max(around - 2 * agreeing, 0) / _occupied(in_cells1[on_plane])


def _occupied(in_cells: np.ndarray) -> int:
    """The number of grid cells with points (N, 2), in units of a cell."""
    return len(np.unique(np.floor(in_cells).astype(int), axis=0))


def rotation_corrected(context_ratio: float, R: np.ndarray) -> float:
    """`Matches.context_ratio`, plus the amount by which the rotation R (3, 3) lowers it between
    images of one place."""
    return context_ratio + _LESS_ALIKE * log_rotation(R)


def log_rotation(R: np.ndarray) -> float:
    """ln(1 + angle / 3 degrees) of a rotation (3, 3), a measure of how far apart two views are."""
    return math.log1p(rotation_angle_deg(R) / _LESS_ALIKE_DEG)


def chance_ratio(problem: TwoViewProblem, E: np.ndarray) -> float:
    """The inlier ratio of an essential matrix if the points are paired wrongly.

    The points keep their places, so the ratio includes the width of the band around the epipolar
    lines, the size of the images, and clusters of matches.
    """
    count = len(problem)
    if count < 2:
        return 1.0
    order = np.random.default_rng(problem.options.seed).permutation(count)[: _PAIRS // _MIN_ROUNDS]
    count = len(order)
    rounds = min(count - 1, max(_MIN_ROUNDS, math.ceil(_PAIRS / count)))
    ours = problem.points1[order]
    theirs = problem.points2[order]
    hits = 0
    for part in slices(rounds, max(1, _AT_A_TIME // count)):
        shifts = np.arange(1, rounds + 1)[part, None]  # never a point with its match
        wrong = theirs[((np.arange(count) - shifts) % count).ravel()]
        distance = sampson_distance(np.tile(ours, (len(shifts), 1)), wrong, E)
        hits += int((distance < problem.threshold).sum())
    return (hits + 1) / (rounds * count + 1)


def log10_false_alarms(count: int, inliers: int, chance: float) -> float:
    """Decimal logarithm of the expected number of poses with as many inliers in random matches.

    (n - 5) C(n, k) C(k, 5) p^(k - 5): all samples that RANSAC could have drawn, times the
    probability that k - 5 of the other matches agree by chance (Moisan and Stival, 2004).
    """
    if inliers <= MINIMAL or inliers > count:
        return math.inf
    tests = math.log(max(count - MINIMAL, 1)) + _log_choose(count, inliers)
    alarms = tests + _log_choose(inliers, MINIMAL) + (inliers - MINIMAL) * math.log(chance)
    return alarms / math.log(10)


def _log_choose(count: int, chosen: int) -> float:
    return math.lgamma(count + 1) - math.lgamma(chosen + 1) - math.lgamma(count - chosen + 1)


def robust_rotation(problem: TwoViewProblem) -> np.ndarray:
    """The rotation (3, 3) that takes rays 1 to rays 2.

    Least squares on all matches, then on the matches within twice the threshold or on the better
    half, whichever are more, until they stay the same. The identity for fewer than two matches.
    """
    rays1 = unit_rays(problem.points1)
    rays2 = unit_rays(problem.points2)
    near = np.ones(len(rays1), dtype=bool)
    R = np.eye(3)
    for _ in range(_ROTATION_ROUNDS):
        if near.sum() < 2:
            break
        R = aligning_rotation(rays1[near], rays2[near])
        distance = np.linalg.norm(rays1 @ R.T - rays2, axis=1)
        before = near
        near = distance <= max(2 * problem.threshold, float(np.median(distance)))
        if np.array_equal(near, before):
            break
    return R


def _median(values: np.ndarray) -> float:
    return float(np.median(values)) if len(values) else 0.0


def _parallax(motion: np.ndarray, across: np.ndarray, least: float) -> float:
    """Spread of the motion (N,) left by a rotation, over that of the epipolar error (N,).

    Each is a median scaled to a standard deviation of Gaussian noise, in two dimensions and in one.
    Noise moves points along their epipolar lines as much as across them, so a pure rotation gives
    1, or a little more if the essential matrix fits the noise of few matches. A real translation
    gives more. `least` bounds the error from below: exact copies have only rounding errors.
    """
    if not len(motion):
        return 0.0
    left = np.median(motion) / _RAYLEIGH_MEDIAN
    error = np.median(across) / _NORMAL_MEDIAN
    return float(left / max(error, least))


def _width(points: np.ndarray) -> float:
    """Standard deviation of points (N, 2) across the line that fits them best."""
    if len(points) < 2:
        return 0.0
    return float(np.sqrt(max(np.linalg.eigvalsh(np.cov(points.T))[0], 0.0)))
