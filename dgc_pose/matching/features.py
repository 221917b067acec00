"""Matches of the frozen encoder's features at native resolution, guided by the dense map.

The encoder is fully convolutional, so the image keeps its shape and most of its resolution. At
stride 16 each cell of image 2 gets a few candidate cells of image 1: the likeliest by consensus
among neighbouring cells, and those that the map points to. At stride 8 their children (four
cells each) are compared, and mutual nearest neighbours remain. At stride 4 points are located to a
fraction of a cell. Only the comparison at stride 16 is quadratic in the number of pixels.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain

import numpy as np

from dgc_pose.cameras.camera import TwoViews
from dgc_pose.geometry.pixels import Size, window_offsets, within
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.cell_consensus import EpipolarBand, likely_cells
from dgc_pose.matching.correspondence_map import (
    WEAK,
    CorrespondenceMap,
    matchable_points,
    points_in_image1,
    rotation_between,
    scale_between,
    window_shown,
)
from dgc_pose.matching.view import View
from dgc_pose.network.config import STRIDE
from dgc_pose.runtime.engine import Engine, NativeFeatures
from dgc_pose.system.parallel import in_threads, slices

LONG_SIDE = 800  # longest side of the images that features are computed on, pixels
SIMILAR_CELLS = 12  # most similar cells of stride 16 that enter the consensus
LIKELY_CELLS = 4  # likeliest cells by consensus, compared besides those the map points to
MOST_HYPOTHESES = 2  # hypotheses of the pose near whose epipolar lines matches are searched
_SQUEEZE = 0.6  # factor on the width or the height of one image; see docs/experiments.md
ERROR_CELLS = 0.25  # error of a match along one axis, in cells of stride 4
_WIDER = 1.6  # ratio of the fields of view, along a side, from which even a weak map crops
_ANGLE_STEP = 30.0  # degrees: image 2 is rotated by a multiple of it
_UPRIGHT = 35.0  # degrees up to which it is not rotated: resampling would harm the features more
_SMALL = 480  # pixels of the longer side, below which both images are enlarged
_SHARPNESS = 20.0  # inverse temperature of the soft-argmax over cosines
_RADIUS = 3  # cells of stride 4 searched around a match of stride 8
_WINDOW = window_offsets(_RADIUS)
_NEAR = np.abs(_WINDOW[:, None] - _WINDOW).max(-1) <= 1  # for each of its cells, those within one
_WINDOWS = 128  # windows compared at a time, so that they stay in the processor's cache
_CHUNK = 128  # coarse cells compared at a time, for the same reason

Shown = tuple[View, Size]  # a view, and the columns and rows of stride 16 that it is resized to
Encoded = tuple[View, NativeFeatures]


@dataclass(frozen=True, eq=False)
class CommonViews:
    """Views of the matching parts of both images, at a common orientation and, to the octave, one
    scale."""

    first: Shown
    second: Shown
    scale: float  # of their sides, over the sides at full resolution
    encoded: Mapping[Shown, Encoded]


def feature_matches(
    engine: Engine,
    cache: ImageCache,
    dense: CorrespondenceMap,
    views: CommonViews,
    hypotheses: Sequence[TwoViews] | None = None,
) -> list[Matches]:
    """Mutual nearest neighbours of the features, guided by the map, from each of several
    comparisons; the confidence is their cosine.

    hypotheses: of the pose. None for one comparison of both views; otherwise other comparisons:

    - with one view squeezed in width or height: a surface that one camera sees from the side and
      the other from the front then looks alike;
    - for each of the first hypotheses, of cells near its epipolar lines.
    """
    first = views.first
    second = views.second
    comparisons: list[tuple[Shown, Shown, TwoViews | None]] = [(first, second, None)]
    if hypotheses is not None:
        comparisons = []
        for axis in (0, 1):
            comparisons.append((_squeezed(first, axis), second, None))
            comparisons.append((first, _squeezed(second, axis), None))
        comparisons += [(first, second, pose) for pose in hypotheses[:MOST_HYPOTHESES]]
    shown = chain(*(comparison[:2] for comparison in comparisons))
    others = encode_each(engine, cache, [one for one in shown if one not in views.encoded])
    encoded = {**views.encoded, **others}

    def compare(comparison: tuple[Shown, Shown, TwoViews | None]) -> Matches:
        source, target, hypothesis = comparison
        return _neighbours(engine, dense, encoded[source], encoded[target], hypothesis)

    return in_threads(compare, comparisons)


def encode_each(engine: Engine, cache: ImageCache, shown: Iterable[Shown]) -> dict[Shown, Encoded]:
    """The views, encoded one by one: an image occupies all processors, and only one needs
    memory."""
    encoded: dict[Shown, Encoded] = {}
    for view, cells in dict.fromkeys(shown):
        make = partial(_encode, engine, view, cells)
        encoded[view, cells] = view, cache.get(view.image, (view, cells), make)
    return encoded


def common_views(
    engine: Engine,
    cache: ImageCache,
    image1: Image,
    image2: Image,
    dense: CorrespondenceMap,
    long_side: int = LONG_SIDE,
) -> CommonViews:
    """The views to compare, by the map, with a longest side of about `long_side` pixels."""
    scale = 2.0 ** round(math.log2(scale_between(dense)))
    points1, points2 = matchable_points(dense)
    angle = rotation_between(points1, points2)
    # A weak map is too little evidence for cropping, unless the fields of view differ.
    wider = scale * math.sqrt(math.prod(dense.size2) / math.prod(dense.size1))
    if dense.mean_matchability < WEAK and 1 / _WIDER < wider < _WIDER:
        points1 = points1[:0]
        points2 = points2[:0]
    window1 = window_shown(points1[within(points1, dense.size1)], dense.size1)
    window2 = window_shown(points2, dense.size2)
    angle = 0.0 if abs(angle) <= _UPRIGHT else _ANGLE_STEP * round(angle / _ANGLE_STEP) % 360
    view1 = View.window(image1, *window1, 0.0, 1.0)
    view2 = View.window(image2, *window2, angle, 1.0)
    factor1, factor2 = equal_scales(view1.size, view2.size, scale, long_side)
    full1, _ = equal_scales(view1.size, view2.size, scale, LONG_SIDE)
    if angle % 90:  # resize the image before it is rotated: mostly it is shrunk
        view2 = View.window(image2, *window2, angle, factor2)
    first = shown_at(view1, factor1)
    second = shown_at(view2, factor2)
    full = shown_at(view1, full1)
    encoded = encode_each(engine, cache, (first, second))
    return CommonViews(first, second, max(first[1]) / max(full[1]), encoded)


def shown_at(view: View, factor: float) -> Shown:
    """A view at a scale of about `factor`: its sides become the nearest multiples of 16."""
    columns, rows = (max(1, round(side * (factor / view.scale) / STRIDE)) for side in view.size)
    return view, (columns, rows)


def _squeezed(shown: Shown, axis: int) -> Shown:
    """A view made narrower (axis 0) or lower (1)."""
    sides = [round(_SQUEEZE * n) if k == axis else n for k, n in enumerate(shown[1])]
    return shown[0], (max(1, sides[0]), max(1, sides[1]))


def _encode(engine: Engine, view: View, cells: Size) -> NativeFeatures:
    return engine.native(view.pixels(), cells)


def _neighbours(
    engine: Engine,
    dense: CorrespondenceMap,
    first: Encoded,
    second: Encoded,
    hypothesis: TwoViews | None,
) -> Matches:
    """Mutual nearest neighbours of two views; with a hypothesis, only near its epipolar lines."""
    view1, source = first
    view2, target = second
    guided = _guided_cells(dense, first, second)

    coarse = None
    middle = None
    if hypothesis is not None:
        coarse = EpipolarBand(hypothesis, first, second, children=False).all()
        middle = EpipolarBand(hypothesis, first, second, children=True)

    candidates = likely_cells(
        source,
        target,
        guided,
        engine.correlation_scales,
        similar=SIMILAR_CELLS,
        likely=LIKELY_CELLS,
        allowed=coarse,
    )
    candidates = np.concatenate([candidates, guided], 1)
    cells1, cells2, cosine = mutual_neighbours(source, target, candidates, middle)

    fine1, fine2 = subcell_points(source.fine, target.fine, cells1, cells2)
    points1 = view1.to_image(fine1, source.fine.shape[1::-1])
    points2 = view2.to_image(fine2, target.fine.shape[1::-1])
    inside = view1.shows(points1) & view2.shows(points2)

    area1, area2 = (  # area of a cell of stride 4, pixels of the original
        math.prod(view.size) / math.prod(features.fine.shape[:2]) / view.scale**2
        for view, features in (first, second)
    )
    return Matches(
        points1[inside],
        points2[inside],
        cosine[inside].clip(0, 1),
        error_px=ERROR_CELLS * math.sqrt(math.sqrt(area1 * area2)),
        weights=engine.fingerprint,
    )


def equal_scales(size1: Size, size2: Size, scale: float, long_side: int) -> tuple[float, float]:
    """Factors that bring both images to one scale, with no side longer than `long_side`. scale:
    pixels of image 1 per pixel of image 2. Small images are enlarged, at most twice: else the cells
    of stride 4 would be too few and too large."""
    factor1, factor2 = (min(1.0, long_side / max(size)) for size in (size1, size2))
    ratio = scale * factor1 / factor2
    factor1 = factor1 / max(ratio, 1.0)
    factor2 = factor2 * min(ratio, 1.0)
    side = max(factor1 * max(size1), factor2 * max(size2))
    larger = min(2.0, long_side / side) if side < _SMALL else 1.0
    return larger * factor1, larger * factor2


def mutual_neighbours(
    source: NativeFeatures,
    target: NativeFeatures,
    candidates: np.ndarray,
    band: EpipolarBand | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mutual nearest neighbours at stride 8 among the children of the candidates: source and target
    cells (M, 2) int, x and y, and cosines (M,). candidates: for each of the target's n cells of
    stride 16, indices (n, K) of the source's. band: which cells of stride 8 may match."""
    middle1, middle2 = (np.concatenate(features.middle) for features in (source, target))
    children1 = _children(source.coarse)
    children2 = _children(target.coarse)

    def compare(rows: slice) -> tuple[np.ndarray, np.ndarray]:
        """The children (m, 4 K) of each cell's candidates, and their cosines (m, 4, 4 K)."""
        index = children1[candidates[rows]].reshape(-1, 4 * candidates.shape[1])
        scores = middle2.take(children2[rows], 0) @ middle1.take(index, 0).transpose(0, 2, 1)
        if band is not None:
            scores[~band.among(children2[rows], index)] = -np.inf
        return index, scores

    limit = np.full(len(middle1), -np.inf, np.float32)  # best cosine of each source cell
    cosines = []
    cells = []
    for index, scores in in_threads(compare, slices(len(candidates), _CHUNK)):
        np.maximum.at(limit, index.ravel(), scores.max(1).ravel())
        best = scores.argmax(2)
        cosines.append(np.take_along_axis(scores, best[..., None], 2).ravel())
        cells.append(np.take_along_axis(index, best, 1).ravel())
    cosine = np.concatenate(cosines)
    cell1 = np.concatenate(cells)
    cell2 = children2.ravel()
    mutual = (cosine >= limit[cell1]) & np.isfinite(cosine)
    points1, points2 = (
        np.stack(np.divmod(cell[mutual], features.middle.shape[1])[::-1], -1)
        for cell, features in ((cell1, source), (cell2, target))
    )
    return points1, points2, cosine[mutual]


def subcell_points(
    fine1: np.ndarray, fine2: np.ndarray, cells1: np.ndarray, cells2: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Points (M, 2) float64, in cells of stride 4, of matched source and target cells (M, 2) of
    stride 8. The target's point is the centre of its cell. The source's is a mean over the most
    similar point of a window and its neighbours, weighted by the softmax of the cosines."""
    rows, columns, channels = fine1.shape
    # The window's points lie where four cells meet; a point's cosine is the mean of the four.
    x1, y1 = (2 * cells1[:, axis, None] + np.arange(-_RADIUS, _RADIUS + 2) for axis in (0, 1))
    inside_y, inside_x = (
        (cells[:, :-1] >= 0) & (cells[:, 1:] < side) for cells, side in ((y1, rows), (x1, columns))
    )
    inside = inside_y[:, :, None] & inside_x[:, None]
    cells = (columns * y1.clip(0, rows - 1))[:, :, None] + x1.clip(0, columns - 1)[:, None]
    cells = cells.reshape(len(cells), (2 * _RADIUS + 2) ** 2)
    rows1 = fine1.reshape(-1, channels)
    x2, y2 = 2 * cells2.T
    pairs = fine2[y2, x2] + fine2[y2, x2 + 1], fine2[y2 + 1, x2] + fine2[y2 + 1, x2 + 1]
    wanted = (pairs[0] + pairs[1]) * np.float32(0.25)

    def compare(part: slice) -> np.ndarray:
        """Cosines (m, cells) of each match's window."""
        return (rows1.take(cells[part], 0) @ wanted[part, :, None])[..., 0]

    single = np.concatenate(in_threads(compare, slices(len(cells), _WINDOWS)))
    single = single.reshape(-1, 2 * _RADIUS + 2, 2 * _RADIUS + 2)
    pairs = single[:, :, 1:] + single[:, :, :-1]
    cosines = np.where(inside, (pairs[:, 1:] + pairs[:, :-1]) * np.float32(0.25), -np.inf)
    cosines = cosines.reshape(-1, len(_WINDOW))
    sharp = _SHARPNESS * (cosines - cosines.max(1, keepdims=True)).astype(np.float64)
    weights = np.where(_NEAR[cosines.argmax(1)], np.exp(sharp), 0.0)
    weights /= weights.sum(1, keepdims=True)
    return 2 * cells1 + 0.5 + weights @ _WINDOW, 2 * cells2 + 0.5


def _guided_cells(dense: CorrespondenceMap, first: Encoded, second: Encoded) -> np.ndarray:
    """For each target cell, the indices (n, 4) of the 2x2 source cells around the map's point."""
    view1, source = first
    view2, target = second
    rows, columns = source.coarse.shape[:2]
    points2 = view2.centres(target.coarse.shape[1::-1]).reshape(-1, 2)
    cells = view1.to_view(points_in_image1(dense, points2), (columns, rows))
    corner = np.floor(cells).astype(np.int64)[:, None] + ((0, 0), (1, 0), (0, 1), (1, 1))
    corner = corner.clip(0, (columns - 1, rows - 1))
    return corner[..., 1] * columns + corner[..., 0]


def _children(coarse: np.ndarray) -> np.ndarray:
    """For each cell of a level, row by row, indices (n, 4) of its cells at twice the resolution."""
    height, width = coarse.shape[:2]
    finer = np.arange(4 * height * width).reshape(height, 2, width, 2)
    return finer.transpose(0, 2, 1, 3).reshape(-1, 4)
