"""Which pairs of a folder show one place, and which show two places that look alike.

On its own, a pair of look-alike places has as good a pose as any. The folder exposes it: the three
poses among three images agree if all are right or if two are wrong in the same way, but not if only
one is wrong. And two images of one place share more than the parts that many images show.

Triples of pairs exchange messages: loopy belief propagation (Pearl 1988). Most folders contain no
look-alikes, called repeats. So each folder is solved twice. Without repeats, pairs start from their
own probabilities. With repeats, they start also from the context of their matches and from the
matched parts that other pairs lack, compared with the folder's other pairs. The second solution is
used if it explains the pairs clearly better.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice

import numpy as np

from dgc_pose.batch.pairs import MIN_FOLDER_PROBABILITY, MatchedPair, PairRow
from dgc_pose.batch.store import Plan
from dgc_pose.cameras.camera import Camera, image_size
from dgc_pose.estimation.evidence import log_rotation, rotation_corrected
from dgc_pose.estimation.status import CONFIGURATIONS
from dgc_pose.geometry.epipolar import depths

MOST_PAIRS = 2000  # pairs with a pose in a folder; with more, the check is skipped
CELLS = 80  # along the longer side of an image
_LEAST_SHARED = 8  # cells with depths of both pairs, to measure the scale between two pairs
# Limits for three poses to agree: the error of the rotations around the loop, degrees; the gap that
# the translations leave, over the longest. Or, if larger, this multiple of expected errors.
_ROTATION_DEG = 4.0
_GAP = 0.2
_ERRORS = 2.0
_CLEAR = 2.5  # times these limits: beyond, three poses disagree; in between, it is unclear
_FEW = 2  # pairs of an image with inliers in a cell, up to which the cell counts as unshared
# In folders of up to 9 photographs, `log_unshared_cells` of right pairs falls by this much per unit
# of `log_rotation` (ten posed scenes). The weights below are of larger folders, without this.
_SMALL_FOLDER = 9
_FEWER_UNSHARED = 1.17
# Bounds of the probability of a pair; two triples do not outweigh the upper bound
_LEAST = 0.007
_MOST = 0.9999
_UNKNOWN = 0.9  # probability of a pose if its own is not known
_MOST_LOG_ODDS = 5.0  # in a folder with repeats
# Log-odds per unit of each value of `evidence_of_pairs`, in a folder with repeats
_WEIGHTS = np.array([0.228, 5.227, 0.689])
_INTERCEPT = 0.391
_QUANTILE = 0.75  # of the folder's pairs, with which each pair is compared
# Prior log-odds for a folder without repeats: at least, and per pair, as pairs are not independent.
# None of 300 folders of 4 to 9 photographs of 16 posed scenes is then taken for one with repeats
_NO_REPEATS = 7.0
_NO_REPEATS_PER_PAIR = 0.3
# Likelihoods that three poses agree, and that they disagree, if 0 to 3 of them are right, each up
# to a factor
_AGREE, _DISAGREE = np.array([[0.8, 1.0, 0.02, 1.0], [0.8, 1.0, 1.0, 0.02]])
_FULL_TRIPLES = 4  # of a pair; with more, each counts less, as they are not independent
_ROUNDS = 60
_DAMPING = 0.5
_MAX_MESSAGE_LOG_ODDS = 8.0  # log-odds


@dataclass(frozen=True, eq=False)
class PlacedPair:
    """The pose of a pair, and the cells of its inliers.

    Attributes:
        images: Indices of both images, the lower first.
        R: Rotation (3, 3) from the first camera to the second.
        t: Direction (3,) of the translation; NaN for a pure rotation.
        error_deg: Expected errors of R and t, degrees: 90 % of errors are smaller; 0 if unknown.
        cells: For each image, its cells (n,) int with inliers, sorted.
        log_depths: For each image, ln of the depths (n,) there, in units of |t|; NaN if unknown.
    """

    images: tuple[int, int]
    R: np.ndarray
    t: np.ndarray
    error_deg: tuple[float, float]
    cells: tuple[np.ndarray, np.ndarray]
    log_depths: tuple[np.ndarray, np.ndarray]

    @classmethod
    def of(
        cls, pair: MatchedPair, images: tuple[int, int], cameras: Sequence[Camera]
    ) -> PlacedPair:
        """Place a pair of these images that has a pose or rotation, by the cameras of its pose."""
        pose = pair.row.pose
        assert pose is not None and pose.R is not None
        matches = pair.matches.subset(pose.inliers)
        points = (matches.points1, matches.points2)
        cells = []
        log_depths = []
        along = [np.full(len(matches), np.nan)] * 2
        t = np.full(3, np.nan)
        if pose.t is not None:
            rays1, rays2 = (c.normalise(p) for c, p in zip(cameras, points, strict=True))
            t = pose.t
            along = list(depths(rays1, rays2, pose.R, pose.t))
            front = (along[0] > 0) & (along[1] > 0)
            with np.errstate(divide="ignore", invalid="ignore"):
                along = [np.where(front & np.isfinite(z), np.log(z), np.nan) for z in along]
        for camera, seen, values in zip(cameras, points, along, strict=True):
            unique, first = np.unique(_cells(seen, image_size(camera)), return_index=True)
            cells.append(unique)
            log_depths.append(values[first].astype(np.float32))
        errors = pose.rotation_error_90_deg or 0.0, pose.translation_error_90_deg or 0.0
        order = (0, 1)
        R = pose.R
        if images[0] > images[1]:
            order = (1, 0)
            t = -R.T @ t
            R = R.T
        a, b = order
        sides = (cells[a], cells[b]), (log_depths[a], log_depths[b])
        return cls((images[a], images[b]), R, t, errors, *sides)


def folder_probabilities(pairs: Iterable[MatchedPair], plan: Plan) -> list[PairRow]:
    """The rows of the pairs with a pose or rotation, with the probability that it is right given
    the whole folder. Empty if there are more than `MOST_PAIRS` such pairs."""
    rows, placed, values = evidence_of_pairs(pairs, plan, MOST_PAIRS + 1)
    if not 0 < len(rows) <= MOST_PAIRS:
        return []
    found, agree = triples(placed)
    solved = solutions(values[:, 0], own_log_odds(values), found, agree)
    log_odds = solved[has_repeats(solved, values)]
    if log_odds is solved[0]:  # a pair in no triple keeps its own probability
        without_triples = ~np.isin(np.arange(len(rows)), found)
        own = [_UNKNOWN if r.probability is None else r.probability for r in rows]
        own_odds = _log_odds(np.clip(own, MIN_FOLDER_PROBABILITY, _MOST))
        log_odds = np.where(without_triples, own_odds, log_odds)
    probability = np.round(1 / (1 + np.exp(-log_odds)), 4)
    counts = np.zeros((len(rows), 2), np.int64)  # triples that agree, and that disagree
    for k in range(3):
        pair, *others = np.roll(found, k, axis=1).T
        holds = (probability[others] >= MIN_FOLDER_PROBABILITY).all(0)
        np.add.at(counts, (pair[holds], 1 - agree[holds].astype(np.int64)), 1)
    return [
        replace(row, folder_probability=value, folder_triples=(agreeing, differing))
        for row, value, (agreeing, differing) in zip(
            rows, probability.tolist(), counts.tolist(), strict=True
        )
    ]


def evidence_of_pairs(
    pairs: Iterable[MatchedPair], plan: Plan, most: int | None = None
) -> tuple[list[PairRow], list[PlacedPair], np.ndarray]:
    """The first `most` pairs with a pose or rotation: rows, placed pairs, and the evidence for each
    pair (n, 3). Its columns are the log-odds of the pair's own probability, the context of the
    matches and `log_unshared_cells`, the last two without the effect of the rotation and minus the
    folder's quantile; NaN if unknown."""
    number = {name: k for k, name in enumerate(plan.names)}
    cameras = plan.final_cameras
    rows = list[PairRow]()
    placed = list[PlacedPair]()
    values = list[tuple[float, float]]()
    key_points = list[bool]()
    posed = (p for p in pairs if p.row.pose is not None and p.row.pose.status in CONFIGURATIONS)
    for pair in islice(posed, most):
        row = pair.row
        pose = pair.row.pose
        assert pose is not None and pose.R is not None  # by its status
        name1, name2 = row.names
        both = row.fitted_cameras or (cameras[name1], cameras[name2])
        placed.append(PlacedPair.of(pair, (number[name1], number[name2]), both))
        # A success starts as accepted, and only other pairs can reject it. Most rotations without a
        # likely pose are wrong.
        known = pose.one_place_probability if pose.success else pose.any_probability
        least = MIN_FOLDER_PROBABILITY if pose.success else _LEAST
        known = _UNKNOWN if known is None else min(max(known, least), _MOST)
        # The check for repeats is fitted on poses that have a probability.
        around = None if pose.any_probability is None else pair.matches.context_ratio
        key_points.append(pair.matches.key_points)
        values.append((known, math.nan if around is None else rotation_corrected(around, pose.R)))
        rows.append(row)
    unshared = log_unshared_cells(placed)
    # A map gives every pair about as many matches, spread over the images; a detector does not.
    sizes = [np.mean([np.log1p(len(cells)) for cells in pair.cells]) for pair in placed]
    unshared -= np.where(key_points, sizes, 0.0)
    if len({name for row in rows for name in row.names}) <= _SMALL_FOLDER:
        unshared += _FEWER_UNSHARED * np.array([log_rotation(pair.R) for pair in placed])
    found = np.column_stack([np.array(values).reshape(-1, 2), unshared])
    found[:, 0] = _log_odds(found[:, 0])
    for column in found.T[1:]:
        known_ones = column[np.isfinite(column)]
        column -= np.quantile(known_ones, _QUANTILE) if len(known_ones) else 0.0
    return rows, placed, found


def own_log_odds(
    values: np.ndarray, weights: np.ndarray = _WEIGHTS, intercept: float = _INTERCEPT
) -> np.ndarray:
    """Log-odds (n,) of pairs in a folder with repeats, by `evidence_of_pairs` (n, 3)."""
    return (intercept + np.nan_to_num(values) @ weights).clip(-_MOST_LOG_ODDS, _MOST_LOG_ODDS)


def _log_odds(probability: np.ndarray) -> np.ndarray:
    return np.log(probability / (1 - probability))


def has_repeats(solved: tuple[np.ndarray, np.ndarray, float], values: np.ndarray) -> bool:
    """Whether a folder has repeats, by its `solutions` and values (n, 3) of `evidence_of_pairs`.
    False unless the context of the matches is known for more than half of the pairs."""
    known = np.isfinite(values[:, 1]).sum() > 0.5 * len(values)
    return bool(known and solved[2] > max(_NO_REPEATS, _NO_REPEATS_PER_PAIR * len(values)))


def solutions(
    probable: np.ndarray, with_repeats: np.ndarray, found: np.ndarray, agree: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Log-odds (n,) of pairs in a folder without repeats, and in a folder with repeats; and the
    log-odds of the second explanation over the first.

    probable: log-odds of the pairs' own probabilities (n,); with_repeats: `own_log_odds` (n,);
    found: triples (M, 3); agree: whether the poses of each triple agree (M,).
    """
    count = np.bincount(found.ravel(), minlength=len(probable))
    weight = np.minimum(1, _FULL_TRIPLES / np.maximum(count, 1))
    likely = np.where(agree[:, None], _AGREE, _DISAGREE)
    solved = []
    for before in (probable, with_repeats):
        after = _propagate(before, found, likely, weight)
        right = after > 0
        triple_evidence = np.log(likely[np.arange(len(found)), right[found].sum(1)])
        solved.append((after, weight[found].mean(1) @ triple_evidence - before[~right].sum()))
    (ordinary, explained), (repeating, with_them) = solved
    return ordinary, repeating, float(with_them - explained)


def _propagate(
    before: np.ndarray, found: np.ndarray, likely: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """The log-odds `before` (n,) updated by the messages of triples. likely: (M, 4), likelihoods of
    0 to 3 right poses in each triple; weight: (n,), of the messages to each pair."""

    def total(messages: np.ndarray) -> np.ndarray:
        sums = np.bincount(found.ravel(), messages.ravel(), minlength=len(before))
        return before + weight * sums

    messages = np.zeros(found.shape)
    for _ in range(_ROUNDS):
        sent = total(messages)[found] - weight[found] * messages
        right = 1 / (1 + np.exp(-sent.clip(-_MAX_MESSAGE_LOG_ODDS, _MAX_MESSAGE_LOG_ODDS)))
        new = np.empty_like(messages)
        for k in range(3):
            a = right[:, k - 1]
            b = right[:, k - 2]
            others = np.stack([(1 - a) * (1 - b), a + b - 2 * a * b, a * b], 1)  # 0 to 2 are right
            new[:, k] = np.log((likely[:, 1:] * others).sum(1) / (likely[:, :3] * others).sum(1))
        messages = _DAMPING * messages + (1 - _DAMPING) * new
    return total(messages)


def _cells(points: np.ndarray, size: tuple[float, float]) -> np.ndarray:
    """Cell indices (N,) of points (N, 2), row by row, in the image's grid padded by one cell."""
    x, y = np.floor((points + 0.5) * (CELLS / max(size))).astype(np.int64).T.clip(0, CELLS - 1)
    return (y + 1) * (CELLS + 2) + x + 1


def _pairs_by_image(pairs: Sequence[PlacedPair]) -> dict[int, list[tuple[int, int]]]:
    """By image, its pairs: the index of each pair, and which of its two images this is, 0 or 1."""
    found: dict[int, list[tuple[int, int]]] = defaultdict(list)
    for number, pair in enumerate(pairs):
        for side, image in enumerate(pair.images):
            found[image].append((number, side))
    return found


def triples(pairs: Sequence[PlacedPair]) -> tuple[np.ndarray, np.ndarray]:
    """Triples (M, 3) int of pairs among three images, and whether their poses agree, (M,) bool.
    Unclear triples are dropped."""
    number = {pair.images: k for k, pair in enumerate(pairs)}
    near: dict[int, set[int]] = defaultdict(set)
    for first, second in number:
        near[first].add(second)
    those = [
        ((a, b, c), (number[a, b], number[b, c], number[a, c]))
        for a in sorted(near)
        for b, c in combinations(sorted(near[a]), 2)
        if c in near[b]
    ]
    images, found = np.array(those, dtype=np.int64).reshape(-1, 2, 3).swapaxes(0, 1)
    R = np.array([p.R for p in pairs]).reshape(-1, 3, 3)
    t = np.array([p.t for p in pairs])
    errors = np.array([p.error_deg for p in pairs]).reshape(-1, 2)
    t = t.reshape(-1, 3)
    e12, e23, e13 = found.T
    turned = R[e23] @ R[e12] @ R[e13].transpose(0, 2, 1)
    cosine = (np.trace(turned, axis1=1, axis2=2) - 1) / 2
    angle = np.degrees(np.arccos(cosine.clip(-1, 1)))
    limit = np.maximum(_ROTATION_DEG, _ERRORS * np.linalg.norm(errors[found, 0], axis=1))
    lengths = _lengths(found, images, _log_ratios(pairs))
    gap = _gaps(np.einsum("nij,nj->ni", R[e23], t[e12]), t[e23], t[e13], *lengths)
    gap_limit = np.radians(np.linalg.norm(errors[found, 1], axis=1))
    gap_limit = np.maximum(_GAP, _ERRORS * gap_limit)
    apart = np.fmax(angle / limit, gap / gap_limit)
    clear = (np.isfinite(gap) & (apart < 1)) | (apart > _CLEAR)
    return found[clear], apart[clear] < 1


def _log_ratios(pairs: Sequence[PlacedPair]) -> dict[tuple[int, int, int], float]:
    """By an image and two of its pairs, ln(second baseline / first baseline), from the depths in
    the cells that both pairs have."""
    ratios = {}
    for image, those in _pairs_by_image(pairs).items():
        for (first, side1), (second, side2) in combinations(those, 2):
            a = pairs[first]
            b = pairs[second]
            _, in_a, in_b = np.intersect1d(
                a.cells[side1], b.cells[side2], assume_unique=True, return_indices=True
            )
            difference = a.log_depths[side1][in_a] - b.log_depths[side2][in_b]
            difference = difference[np.isfinite(difference)]
            if len(difference) >= _LEAST_SHARED:
                ratio = float(np.median(difference))
                ratios[image, first, second] = ratio
                ratios[image, second, first] = -ratio
    return ratios


def _lengths(
    found: np.ndarray, images: np.ndarray, ratios: dict[tuple[int, int, int], float]
) -> tuple[np.ndarray, np.ndarray]:
    """Baselines 23 and 13 of triples over baseline 12, (M,) each; NaN if the images do not
    determine one."""
    keys = (
        ((i1, e12, e13), (i2, e12, e23), (i3, e23, e13))
        for (e12, e23, e13), (i1, i2, i3) in zip(found.tolist(), images.tolist(), strict=True)
    )
    logs = [[ratios.get(key, np.nan) for key in three] for three in keys]
    by1, by2, by3 = np.array(logs).reshape(-1, 3).T
    log23 = np.where(np.isnan(by2), by1 - by3, by2)
    log13 = np.where(np.isnan(by1), by2 + by3, by1)
    return np.exp(log23), np.exp(log13)


def _gaps(
    leg12: np.ndarray, leg23: np.ndarray, leg13: np.ndarray, long23: np.ndarray, long13: np.ndarray
) -> np.ndarray:
    """The gap (M,) that three baselines of directions (M, 3) leave, over the longest. long23,
    long13: lengths (M,) over baseline 12. If one is unknown, it minimises the gap; if both, NaN."""
    along23 = np.einsum("ni,ni->n", leg13 * long13[:, None] - leg12, leg23)
    long23 = np.where(np.isnan(long23), along23.clip(0), long23)
    along13 = np.einsum("ni,ni->n", leg12 + leg23 * long23[:, None], leg13)
    long13 = np.where(np.isnan(long13), along13.clip(0), long13)
    left = leg12 + leg23 * long23[:, None] - leg13 * long13[:, None]
    return np.linalg.norm(left, axis=1) / np.maximum(np.maximum(long23, long13), 1.0)


def log_unshared_cells(pairs: Sequence[PlacedPair]) -> np.ndarray:
    """ln(1 + number) (n,) of each pair's cells near which at most `_FEW` pairs of the image have
    inliers, in the cell or beside it; mean of both images."""
    few = np.zeros((len(pairs), 2))
    for those in _pairs_by_image(pairs).values():
        has = np.zeros((len(those), CELLS + 2, CELLS + 2), bool)
        for grid, (number, side) in zip(has, those, strict=True):
            grid.reshape(-1)[pairs[number].cells[side]] = True
        for axis in (1, 2):
            has = has | np.roll(has, 1, axis) | np.roll(has, -1, axis)
        by_few = has.sum(0) <= _FEW
        for grid, (number, side) in zip(has, those, strict=True):
            few[number, side] = np.log1p((grid & by_few).sum())
    return few.mean(1)
