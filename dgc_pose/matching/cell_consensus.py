"""Which cells of two images may match, at native resolution: at stride 16 by consensus among
neighbouring cells, and, given a hypothesis of the pose, by the distance to epipolar lines.

The consensus is belief propagation as in `network.correlation`: matches near (s + d, t + d) of the
eight neighbours t + d support a match (s, t). All pairs of thousands of cells would be too many.
Each cell therefore has few candidates: the most similar cells, and those the dense map points to.
"""

from __future__ import annotations

import math

import numpy as np

from dgc_pose.cameras.camera import Camera, TwoViews
from dgc_pose.geometry.epipolar import homogeneous
from dgc_pose.matching.view import View
from dgc_pose.network.config import FLOOR, PASSES, REACH, WEIGHT
from dgc_pose.network.correlation import log_softmax
from dgc_pose.runtime.engine import NativeFeatures
from dgc_pose.system.parallel import in_threads, slices

_CHUNK = 128  # cells compared at a time, which stay in the processor's cache
_NEIGHBOURS = [(1, 0), (-1, 1), (0, 1), (1, 1)]  # the other four are their opposites
_NEVER = -1e3  # score of a candidate that is repeated or not allowed
_BAND = 1.0  # Sampson distance between their centres, in cells, below which two cells may match
_UNMATCHED = 1e-30  # keeps a logarithm finite for a source cell that may match no target cell


def likely_cells(
    source: NativeFeatures,
    target: NativeFeatures,
    guided: np.ndarray,
    scales: np.ndarray,
    *,
    similar: int,
    likely: int,
    allowed: np.ndarray | None = None,
) -> np.ndarray:
    """For each of the target's n cells, row by row, indices (n, likely) of likely source cells.

    guided: (n, G) further candidates, beside the `similar` most similar cells. scales: inverse
    temperatures of the cosines at stride 16 and, if there are two, stride 8. allowed: (n, m) bool,
    which of the source's m cells each target cell may match; None for all.
    """
    # Log-likelihoods: the dual softmax over cosines at stride 16, up to a constant per target cell,
    # plus the cosines at stride 8.
    coarse1, coarse2 = (
        features.coarse.reshape(-1, features.coarse.shape[2]) for features in (source, target)
    )
    children1 = source.middle_by_cell
    children2 = target.middle_by_cell
    parts = slices(len(coarse2), _CHUNK)
    similar = min(similar, len(coarse1))
    scaled = scales[0] * coarse2
    evidence = np.empty((len(coarse2), len(coarse1)), np.float32)  # overwritten by the scores

    def sums_over(rows: slice) -> np.ndarray:
        np.matmul(scaled[rows], coarse1.T, out=evidence[rows])
        values = evidence[rows] - scales[0]
        np.exp(values, out=values)
        return values.sum(0) if allowed is None else (values * allowed[rows]).sum(0)

    # Denominator of each source cell's softmax, as a logarithm; cosines <= 1, so no overflow.
    normaliser = np.log(np.sum(in_threads(sums_over, parts), 0) + _UNMATCHED)

    def compare(rows: slice) -> tuple[np.ndarray, np.ndarray]:
        scores = evidence[rows]
        scores *= 2
        scores -= normaliser
        if allowed is not None:
            scores[~allowed[rows]] = _NEVER
        candidates = np.concatenate([_largest(scores.copy(), similar), guided[rows]], 1)
        likelihood = np.take_along_axis(scores, candidates, 1)
        if len(scales) > 1:
            count = len(candidates)
            children = children1.take(candidates, 0).reshape(count, -1, children1.shape[2])
            four = (children2[rows] @ children.transpose(0, 2, 1)).reshape(count, 4, -1, 4)
            best = np.maximum(four[..., :2], four[..., 2:])  # in two steps: short axes are slow
            likelihood += 2 * scales[1] * np.maximum(best[..., 0], best[..., 1]).mean(1)
        return candidates, likelihood

    compared = in_threads(compare, parts)
    candidates, scores = (np.concatenate(values) for values in zip(*compared, strict=True))
    repeated = np.tril(candidates[:, :, None] == candidates[:, None], -1).any(2)
    scores = np.where(repeated, _NEVER, scores)
    beliefs = propagate(candidates, scores, source.coarse.shape[1], target.coarse.shape[:2])
    best = np.argsort(-beliefs, 1, kind="stable")[:, :likely]
    return np.take_along_axis(candidates, best, 1)


def propagate(
    candidates: np.ndarray, scores: np.ndarray, columns: int, grid: tuple[int, int]
) -> np.ndarray:
    """Log-probabilities (n, K) of each target cell's candidates after belief propagation.
    candidates: indices (n, K) of source cells; scores: their log-likelihoods; columns: of the
    source; grid: (rows, columns) of the target, n cells in all."""
    y, x = (axis.astype(np.float32) for axis in np.divmod(candidates, columns))
    index = np.arange(len(candidates)).reshape(grid)

    def support(offset: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cells (m,) that have a neighbour at the offset, these neighbours (m,), and the agreement
        (m, K, K) of each candidate of the cell with each candidate of the neighbour."""
        dx, dy = offset
        rows = slice(max(0, -dy), len(index) - max(0, dy))
        cells = index[rows, max(0, -dx) : grid[1] - max(0, dx)].ravel()
        neighbours = cells + dy * grid[1] + dx
        agreement = (x[cells] + np.float32(dx))[:, :, None] - x[neighbours][:, None]
        agreement *= agreement
        apart = (y[cells] + np.float32(dy))[:, :, None] - y[neighbours][:, None]
        apart *= apart
        agreement += apart
        agreement *= np.float32(-1 / (2 * REACH**2))
        np.exp(agreement, out=agreement)
        agreement *= np.float32(1 / (2 * math.pi * REACH**2))
        return cells, neighbours, agreement

    supports = in_threads(support, _NEIGHBOURS)
    beliefs = log_softmax(scores, 1)
    for _ in range(PASSES):
        probability = np.exp(beliefs)
        total = scores.copy()
        for cells, neighbours, agreement in supports:
            # Two neighbours support each other by the same agreement.
            for receivers, senders, agreed in (
                (cells, neighbours, agreement),
                (neighbours, cells, agreement.transpose(0, 2, 1)),
            ):
                messages = (agreed @ probability[senders][:, :, None])[..., 0]
                total[receivers] += WEIGHT * np.log(FLOOR + messages)
        beliefs = log_softmax(total, 1)
    return beliefs


def _largest(values: np.ndarray, count: int) -> np.ndarray:
    """Columns (n, count) of the largest values of each row. Overwrites these values."""
    largest = np.empty((len(values), count), np.int64)
    for column in largest.T:  # faster than a partition for so few
        column[:] = values.argmax(1)
        np.put_along_axis(values, column[:, None], -np.inf, 1)
    return largest


class EpipolarBand:
    """Which cells of a source and a target lie near each other's epipolar lines. Cells are counted
    row by row, at stride 16 or, with `children`, at stride 8."""

    def __init__(
        self,
        views: TwoViews,
        source: tuple[View, NativeFeatures],
        target: tuple[View, NativeFeatures],
        *,
        children: bool,
    ) -> None:
        finer = 2 if children else 1
        self.points1, side1 = _normalised(*source, views.camera1, finer)
        self.points2, side2 = _normalised(*target, views.camera2, finer)
        self.E = views.E.astype(np.float32)
        self.limit = _BAND * (side1 + side2) / 2  # Sampson distance, in the points' unit

    def all(self) -> np.ndarray:
        """Which source cells each target cell may match: (n, m) bool."""
        every1, every2 = (np.arange(len(points))[None] for points in (self.points1, self.points2))
        parts = slices(every2.size, _CHUNK)
        return np.concatenate([self.among(every2[:, part], every1)[0] for part in parts])

    def among(self, cells2: np.ndarray, cells1: np.ndarray) -> np.ndarray:
        """Which source cells (n, m) each target cell (n, q) may match: (n, q, m) bool."""
        lines1 = self.points2[cells2] @ self.E
        lines2 = self.points1 @ self.E.T
        distance = np.abs(lines1 @ self.points1[cells1].transpose(0, 2, 1))
        norms2 = (lines2[:, :2] ** 2).sum(1)[cells1]
        norms = (lines1[..., :2] ** 2).sum(2)[:, :, None] + norms2[:, None]
        return distance < self.limit * np.sqrt(norms)


def _normalised(
    view: View, features: NativeFeatures, camera: Camera, finer: int
) -> tuple[np.ndarray, float]:
    """Homogeneous centres (n, 3) float32 of the cells, normalised by the camera of the whole image;
    and the side of a cell in the same unit."""
    rows, columns = (finer * side for side in features.coarse.shape[:2])
    points = homogeneous(camera.normalise(view.centres((columns, rows)).reshape(-1, 2)))
    area = math.prod(view.size) / (rows * columns) / view.scale**2
    return points.astype(np.float32), math.sqrt(area) / camera.focal
