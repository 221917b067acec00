"""Matches of the frozen encoder's features at native resolution, guided by the dense map.

The encoder is fully convolutional, so the image keeps its shape and most of its resolution. At
stride 16 each cell of image 2 gets a few candidate cells of image 1: the likeliest by consensus
among neighbouring cells, and those that the map points to. At stride 8 their children are compared,
and mutual nearest neighbours remain. At stride 4 the point is located to a fraction of a cell.
Only the comparison at stride 16 is quadratic in the number of pixels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np

from dgc_pose.cameras.camera import TwoViews
from dgc_pose.geometry.pixels import Size, cell_centres, rescale, window_offsets, within
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.cache import ImageCache
from dgc_pose.matching.cell_consensus import likely_cells
from dgc_pose.matching.correspondence_map import WEAK, CorrespondenceMap
from dgc_pose.matching.epipolar_band import EpipolarBand
from dgc_pose.matching.map_geometry import (
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

LONG_SIDE = 800  # most pixels of the images that features are computed on
SIMILAR_CELLS = 12  # most similar cells of stride 16, for the consensus
LIKELY_CELLS = 4  # of them and of the map's, that are searched besides the map's
MOST_HYPOTHESES = 2  # near whose epipolar lines matches are searched
_SQUEEZE = 0.6  # of the width or the height of one image; see docs/experiments.md
ERROR_CELLS = 0.25  # of a match along one axis, in cells of stride 4
_WIDER = 1.6  # ratio of the fields of view, along a side
_ANGLE_STEP = 30.0  # degrees that image 2 is rotated by a multiple of
_UPRIGHT = 35.0  # degrees up to which it is not: resampling costs the features more
_SMALL = 480  # pixels of the longer side, below which both images are enlarged
_SHARPNESS = 20.0  # inverse temperature of the soft-argmax over cosines
_RADIUS = 3  # cells of stride 4 searched around a match of stride 8
_WINDOW = window_offsets(_RADIUS)
_NEAR = np.abs(_WINDOW[:, None] - _WINDOW).max(-1) <= 1  # which of its cells are within one of each
_WINDOWS = 128  # compared at a time, which stays in the processor's cache
_CHUNK = 128  # coarse cells compared at a time, likewise


def feature_matches(
    engine: Engine,
    image1: Image,
    image2: Image,
    dense: CorrespondenceMap,
    cache: ImageCache,
    long_side: int = LONG_SIDE,
) -> Matches:
    """Mutual nearest neighbours of the features, guided by the map; the confidence is their cosine,
    at least 0.

    Features are invariant neither to scale nor to rotation: the images, or the parts that the map
    shows to match, are resized to one scale, with long sides of about `long_side` pixels, and image
    2 is rotated as the map shows. cache: of the features, by image, view, and columns and rows of
    stride 16.
    """
    first, second = _views(image1, image2, dense, long_side)
    return _compared(engine, dense, cache, [(first, second, None)])[0]


def encoded_views(
    engine: Engine,
    image1: Image,
    image2: Image,
    dense: CorrespondenceMap,
    cache: ImageCache,
    long_side: int = LONG_SIDE,
) -> tuple[list[tuple[View, NativeFeatures]], float]:
    """The views that `feature_matches` compares, with their features; and their sides over those at
    full resolution."""
    keys = _views(image1, image2, dense, long_side)
    full = _views(image1, image2, dense, LONG_SIDE)
    views = [(key.view, key.cached(engine, cache)) for key in keys]
    return views, max(keys[0].cells) / max(full[0].cells)


def guided_matches(
    engine: Engine,
    image1: Image,
    image2: Image,
    dense: CorrespondenceMap,
    cache: ImageCache,
    hypotheses: Sequence[TwoViews],
) -> list[Matches]:
    """As `feature_matches`, further matches by each of several comparisons:

    - with one image narrower or lower than it is: a surface that one camera sees from the side and
      the other from the front becomes alike;
    - for each of the first hypotheses of the pose, those near its epipolar lines.
    """
    first, second = _views(image1, image2, dense, LONG_SIDE)
    comparisons: list[_Comparison] = []
    for axis in (0, 1):
        comparisons.append((first.squeezed(axis), second, None))
        comparisons.append((first, second.squeezed(axis), None))
    comparisons += [(first, second, views) for views in hypotheses[:MOST_HYPOTHESES]]
    return _compared(engine, dense, cache, comparisons)


def _compared(
    engine: Engine, dense: CorrespondenceMap, cache: ImageCache, comparisons: Sequence[_Comparison]
) -> list[Matches]:
    """The matches of each comparison, in pixels of the images."""
    views = dict.fromkeys(chain(*((first, second) for first, second, _ in comparisons)))
    # In turn: one image occupies all processors, and memory for one is enough.
    features = {view: view.cached(engine, cache) for view in views}

    def compare(comparison: _Comparison) -> Matches:
        first, second, hypothesis = comparison
        seen = (first, features[first]), (second, features[second])
        return _neighbours(engine, dense, *seen, hypothesis)

    return in_threads(compare, comparisons)


def _neighbours(
    engine: Engine,
    dense: CorrespondenceMap,
    first: tuple[_Encoded, NativeFeatures],
    second: tuple[_Encoded, NativeFeatures],
    hypothesis: TwoViews | None,
) -> Matches:
    """Mutual nearest neighbours of two views, with a hypothesis those near its epipolar lines."""
    (image1, view1, _), source = first
    (image2, view2, _), target = second
    guided = _guided_cells(dense, source, target, view1, view2)
    coarse, middle = None, None
    if hypothesis is not None:
        seen = (source, view1), (target, view2)
        coarse = EpipolarBand(hypothesis, *seen, children=False).all()
        middle = EpipolarBand(hypothesis, *seen, children=True)
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
    points1 = view1.to_image(rescale(fine1, source.fine.shape[1::-1], source.size))
    points2 = view2.to_image(rescale(fine2, target.fine.shape[1::-1], target.size))
    inside = within(points1, image1.size) & within(points2, image2.size)
    inside &= ~(image1.is_masked(points1) | image2.is_masked(points2))
    area1, area2 = (  # of a cell of stride 4, pixels of the original
        math.prod(features.size) / math.prod(features.fine.shape[:2]) / view.scale**2
        for features, view in ((source, view1), (target, view2))
    )
    return Matches(
        points1[inside],
        points2[inside],
        cosine[inside].clip(0, 1),
        error_px=ERROR_CELLS * math.sqrt(math.sqrt(area1 * area2)),
        weights=engine.fingerprint,
    )


class _Encoded(NamedTuple):
    """What is encoded of an image: the key of its features."""

    image: Image
    view: View
    cells: Size  # columns and rows of stride 16 that the view is resized to

    def encoded(self, engine: Engine) -> NativeFeatures:
        return engine.native(self.view.cut(self.image.pixels), self.cells)

    def cached(self, engine: Engine, cache: ImageCache) -> NativeFeatures:
        features: NativeFeatures = cache.get(self, partial(self.encoded, engine))
        return features

    def squeezed(self, axis: int) -> _Encoded:
        """The view made narrower (axis 0) or lower (1)."""
        sides = [round(_SQUEEZE * n) if k == axis else n for k, n in enumerate(self.cells)]
        return self._replace(cells=(max(1, sides[0]), max(1, sides[1])))


# Two views, and the hypothesis near whose epipolar lines they match, if there is one.
_Comparison = tuple[_Encoded, _Encoded, TwoViews | None]


def _views(
    image1: Image, image2: Image, correspondence_map: CorrespondenceMap, long_side: int
) -> tuple[_Encoded, _Encoded]:
    """Views of the parts of both images that the map shows to match, at one orientation; and the
    columns and rows of stride 16 at one scale: that of the map, to the octave, as features tolerate
    half of one."""
    scale = 2.0 ** round(math.log2(scale_between(correspondence_map)))
    points1, points2 = matchable_points(correspondence_map)
    angle = rotation_between(points1, points2)
    size1, size2 = correspondence_map.size1, correspondence_map.size2
    # What a weak map shows is too little to crop by, unless the fields of view differ.
    wider = scale * math.sqrt(math.prod(size2) / math.prod(size1))
    if correspondence_map.mean_matchability < WEAK and 1 / _WIDER < wider < _WIDER:
        points1, points2 = points1[:0], points2[:0]
    window1 = window_shown(points1[within(points1, size1)], size1)
    window2 = window_shown(points2, size2)
    angle = 0.0 if abs(angle) <= _UPRIGHT else _ANGLE_STEP * round(angle / _ANGLE_STEP) % 360
    factors = equal_scales(window1[0], View.window(*window2, angle, 1.0).size, scale, long_side)
    turned = (image1, window1, 0.0, factors[0]), (image2, window2, angle, factors[1])
    views = []
    for image, window, turn, factor in turned:
        # Before a rotation by other than quarter turns the image is resized: mostly it is shrunk.
        view = View.window(*window, turn, 1.0 if turn % 90 == 0 else factor)
        # Sides become the nearest multiples of 16, so the actual scale differs a little.
        columns, rows = (max(1, round(side * (factor / view.scale) / STRIDE)) for side in view.size)
        views.append(_Encoded(image, view, (columns, rows)))
    return views[0], views[1]


def equal_scales(size1: Size, size2: Size, scale: float, long_side: int) -> tuple[float, float]:
    """Factors that bring both images to one scale; sizes (width, height).

    scale: pixels of image 1 per pixel of image 2. At scale 1 no side is longer than `long_side`
    afterwards; otherwise the image of the larger scale becomes smaller than that. Small images are
    enlarged, at most twice: else the cells of stride 4 would be too few and too large.
    """
    factor1, factor2 = (min(1.0, long_side / max(size)) for size in (size1, size2))
    ratio = scale * factor1 / factor2
    factor1, factor2 = factor1 / max(ratio, 1.0), factor2 * min(ratio, 1.0)
    side = max(factor1 * max(size1), factor2 * max(size2))
    larger = min(2.0, long_side / side) if side < _SMALL else 1.0
    return larger * factor1, larger * factor2


def mutual_neighbours(
    source: NativeFeatures,
    target: NativeFeatures,
    candidates: np.ndarray,
    band: EpipolarBand | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mutual nearest neighbours at stride 8 among the children of candidate cells.

    candidates: (n, K) indices, row by row, of stride-16 cells of the source for each of the
    target's n. band: which cells of stride 8 may match. Returns cells (M, 2) int of stride 8, x and
    y, in source and target, and their cosine.
    """
    middle1, middle2 = (np.concatenate(features.middle) for features in (source, target))
    children1, children2 = _children(source.coarse), _children(target.coarse)

    def compare(rows: slice) -> tuple[np.ndarray, np.ndarray]:
        """The children (m, 4 K) of each cell's candidates, and their cosines (m, 4, 4 K)."""
        index = children1[candidates[rows]].reshape(-1, 4 * candidates.shape[1])
        scores = middle2.take(children2[rows], 0) @ middle1.take(index, 0).transpose(0, 2, 1)
        if band is not None:
            scores[~band.among(children2[rows], index)] = -np.inf
        return index, scores

    limit = np.full(len(middle1), -np.inf, np.float32)  # best cosine of each source cell
    cosines, cells = [], []
    for index, scores in in_threads(compare, slices(len(candidates), _CHUNK)):
        np.maximum.at(limit, index.ravel(), scores.max(1).ravel())
        best = scores.argmax(2)
        cosines.append(np.take_along_axis(scores, best[..., None], 2).ravel())
        cells.append(np.take_along_axis(index, best, 1).ravel())
    cosine, cell1, cell2 = np.concatenate(cosines), np.concatenate(cells), children2.ravel()
    mutual = (cosine >= limit[cell1]) & np.isfinite(cosine)
    points1, points2 = (
        np.stack(np.divmod(cell[mutual], features.middle.shape[1])[::-1], -1)
        for cell, features in ((cell1, source), (cell2, target))
    )
    return points1, points2, cosine[mutual]


def subcell_points(
    fine1: np.ndarray, fine2: np.ndarray, cells1: np.ndarray, cells2: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Points (M, 2) float64 in cells of stride 4 of matched cells (M, 2) of stride 8.

    The target's point is the cell's centre; the source's is the mean of the cells within one of the
    most similar in a window, weighted by the softmax of their cosines.
    """
    rows, columns, channels = fine1.shape
    # Points between the cells, where four of them meet: their cosines are the mean of the four's.
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


def _guided_cells(
    correspondence_map: CorrespondenceMap,
    source: NativeFeatures,
    target: NativeFeatures,
    view1: View,
    view2: View,
) -> np.ndarray:
    """The 2x2 cells of stride 16 around the map's point for each cell of the target: (n, 4)."""
    rows, columns = source.coarse.shape[:2]
    centres = cell_centres(target.coarse.shape[1::-1], target.size).reshape(-1, 2)
    points2 = view2.to_image(centres)
    points1 = view1.to_view(points_in_image1(correspondence_map, points2))
    cells = rescale(points1, source.size, (columns, rows))
    corner = np.floor(cells).astype(np.int64)[:, None] + ((0, 0), (1, 0), (0, 1), (1, 1))
    corner = corner.clip(0, (columns - 1, rows - 1))
    return corner[..., 1] * columns + corner[..., 0]


def _children(coarse: np.ndarray) -> np.ndarray:
    """Indices (n, 4), row by row, of the cells of twice the resolution in each cell of a level."""
    height, width = coarse.shape[:2]
    finer = np.arange(4 * height * width).reshape(height, 2, width, 2)
    return finer.transpose(0, 2, 1, 3).reshape(-1, 4)
