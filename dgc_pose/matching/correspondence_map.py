"""The dense map of two images, the matches selected from it, and the rotation, scale and matching
parts of the images that it determines."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from dgc_pose.geometry.pixels import Size, rescale
from dgc_pose.geometry.sampling import bilinear, spread
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.system.options import check_options, option

# Error of a good match of a map along one axis, in cells of its grid; see docs/experiments.md.
ERROR_CELLS = 0.5
# Mean matchability below which the images may be rotated or of different scales
WEAK = 0.25
MATCHABILITY = 0.7  # least matchability of a match
MIN_SHARE = 0.01  # share of all cells that must pass; a smaller patch may match by chance
_SAMPLE = 40  # most cells along the longer side of a map's sample
_MATCHABLE = 0.5  # least matchability of the cells that determine rotation, scale and window
_LEAST_SHARE = 0.01  # share of the cells that must be matchable to determine rotation and scale
_OUTER = 1.0  # percent of the points, on each side, that may lie outside a window
_WINDOW_MARGIN = 0.25  # margin on each side of a window, as a share of its extent
_MOST_SHARE = 0.4  # share of an image's area; a larger window is not worth cutting out


@dataclass(frozen=True, eq=False)
class CorrespondenceMap:
    """A dense map over image 2's grid. All points are in pixels of the original images.

    Attributes:
        map: For each cell of image 2 its x and y in image 1, (H, W, 2) float32; no NaN.
        grid: The cells' x and y in image 2, (H, W, 2) float32.
        matchability: Probability that a cell's match can be used, (H, W) float32; 1 everywhere for
            a net without a mask.
        size1: Size (width, height) of image 1, pixels.
        size2: Size (width, height) of image 2, pixels.
        used: (H, W) bool, False where either point lies on a masked pixel (the matchability is 0
            there); None if neither image has a mask.
    """

    map: np.ndarray
    grid: np.ndarray
    matchability: np.ndarray
    size1: tuple[int, int]
    size2: tuple[int, int]
    used: np.ndarray | None = None

    def __repr__(self) -> str:
        rows, columns = self.matchability.shape
        sizes = " to ".join(f"{width} x {height}" for width, height in (self.size2, self.size1))
        mean = self.mean_matchability
        return f"CorrespondenceMap({columns} x {rows} cells, {sizes}, matchability={mean:.2f})"

    @property
    def mean_matchability(self) -> float:
        """Mean matchability of the cells that are used."""
        count = self.matchability.size if self.used is None else max(self.used.sum(), 1)
        return float(self.matchability.sum() / count)

    @property
    def error_px(self) -> float:
        """Expected error of a good match of the map, pixels of the original images."""
        cells = self.matchability.size
        sides = [math.sqrt(w * h / cells) for w, h in (self.size1, self.size2)]
        return ERROR_CELLS * sum(sides) / 2

    @property
    def sample(self) -> Matches:
        """An even sample of the used cells of any matchability, which is their confidence. It
        serves as evidence for or against a pose, not to estimate one."""
        sample = self.thinned(max(1, -(-max(self.matchability.shape) // _SAMPLE)))
        used = np.ones(sample.matchability.shape, bool) if sample.used is None else sample.used
        return Matches(
            sample.map[used], sample.grid[used], sample.matchability[used], error_px=self.error_px
        )

    def thinned(self, step: int) -> CorrespondenceMap:
        """Every `step`-th cell of every `step`-th row."""
        cells = (slice(step // 2, None, step), slice(step // 2, None, step))
        return replace(
            self,
            map=self.map[cells],
            grid=self.grid[cells],
            matchability=self.matchability[cells],
            used=None if self.used is None else self.used[cells],
        )

    def masked(self, image1: Image, image2: Image) -> CorrespondenceMap:
        """The map with the images' masks applied."""
        if image1.mask is None and image2.mask is None:
            return self
        used = ~(image1.is_masked(self.map) | image2.is_masked(self.grid))
        return replace(self, matchability=self.matchability * used, used=used)


@dataclass(frozen=True)
class MatchingOptions:
    """Options for selecting and refining matches. Raises InputError, naming the field, for a value
    out of range.

    Attributes:
        aligned: Whether a network's matches are refined on the originals: those of its features,
            or, if too few remain, those selected from its map. Other matchers refine nothing.
    """

    max_matches: int = option(
        2000, "Most matches, evenly spread.", metavar="N", min=1, max=2**31, section="matching"
    )
    aligned: Literal["none", "auto"] = option(
        "auto",
        "Refinement on the original images. auto: of the matches of the encoder's features, or of "
        "the map's matches if too few remain; none: off.",
        metavar="SOURCE",
        flag="--refine",
        section="matching",
    )

    def __post_init__(self) -> None:
        check_options(self)


def select_matches(
    dense: CorrespondenceMap,
    options: MatchingOptions,
    min_share: float = MIN_SHARE,
    min_matchability: float = MATCHABILITY,
) -> Matches:
    """At most `max_matches` matches, evenly spread over the cells that have `min_matchability` and
    map into image 1; none if these cells are less than `min_share` of all."""
    width, height = dense.size1
    keep = dense.matchability >= min_matchability
    keep &= (dense.map >= -0.5).all(-1) & (dense.map <= (width - 0.5, height - 0.5)).all(-1)
    if keep.mean() < min_share:
        keep = np.zeros_like(keep)
    # Evenly spread matches condition the essential matrix well, even if the confident cells
    # concentrate on one object.
    cells = np.argwhere(keep)[:, ::-1]
    confidence = dense.matchability[keep]
    side = max(1.0, math.sqrt(len(cells) / options.max_matches))
    rows = spread(cells, confidence, keep.shape[::-1], options.max_matches, side, 1.05)
    points1 = dense.map[keep][rows]
    points2 = dense.grid[keep][rows]
    return Matches(points1, points2, confidence[rows], error_px=dense.error_px)


def points_in_image1(dense: CorrespondenceMap, points2: np.ndarray) -> np.ndarray:
    """The map at points (N, 2) of image 2: (N, 2) float64, pixels of image 1, bilinear between its
    cells and constant beyond the outer ones."""
    height, width = dense.matchability.shape
    cells = rescale(points2, dense.size2, (width, height))
    planes = np.moveaxis(dense.map, -1, 0)
    return np.concatenate(
        [bilinear(np.ascontiguousarray(plane), cells[:, None]) for plane in planes], -1
    ).astype(np.float64)


def rotation_between(points1: np.ndarray, points2: np.ndarray) -> float:
    """The counter-clockwise rotation (as by `numpy.rot90`), -180 to 180 degrees, that turns image 2
    to the orientation of image 1, from the similarity that best fits points (N, 2) of both images;
    0 without points."""
    if len(points1) == 0:
        return 0.0
    points1 = points1 - np.median(points1, 0)
    points2 = points2 - np.median(points2, 0)
    # As complex numbers, points1 = a points2: |a| is the scale, its argument the angle from 2 to 1.
    a = (points1 @ (1, 1j) * (points2 @ (1, -1j))).sum()
    # y points down, so a counter-clockwise rotation is by a negative angle.
    return float(-np.angle(a, deg=True))


def matchable_points(dense: CorrespondenceMap) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 2) float64 of the matchable cells in image 1 and in image 2; empty if few."""
    matchable = dense.matchability >= _MATCHABLE
    if matchable.mean() < _LEAST_SHARE:
        matchable = np.zeros_like(matchable)
    points1 = dense.map[matchable]
    points2 = dense.grid[matchable]
    return points1.astype(np.float64), points2.astype(np.float64)


def window_shown(points: np.ndarray, size: Size) -> tuple[Size, tuple[float, float]]:
    """The window of an image of `size` (width, height) that contains nearly all points (N, 2) and a
    margin: its (width, height), and the pixel at its centre. The whole image if the window is
    nearly as large, or without points."""
    whole = size, ((size[0] - 1) / 2, (size[1] - 1) / 2)
    if len(points) == 0:
        return whole
    low, high = np.percentile(points, (_OUTER, 100 - _OUTER), axis=0)
    margin = _WINDOW_MARGIN * (high - low)
    # Whole pixels, so that a window is cut without resampling.
    first = np.floor(np.maximum(low - margin, 0)).astype(int)
    last = np.ceil(np.minimum(high + margin, np.subtract(size, 1))).astype(int)
    width, height = (int(side) for side in last - first + 1)
    if width * height > _MOST_SHARE * math.prod(size):
        return whole
    x, y = (float(middle) for middle in (first + last) / 2)
    return (width, height), (x, y)


def scale_between(dense: CorrespondenceMap) -> float:
    """Pixels of image 1 per pixel of image 2, 1/10 to 10: the median over areas that
    matchable cells span, a thirtieth of the image wide, so that errors of the map hardly matter. If
    few cells are matchable, the scale assumes equal fields of view."""
    matchable = dense.matchability >= _MATCHABLE
    step = max(1, len(matchable) // 30)
    corners = matchable[:-step, :-step] & matchable[step:, :-step] & matchable[:-step, step:]
    if corners.mean() < _LEAST_SHARE:
        areas = [math.prod(size) for size in (dense.size1, dense.size2)]
        return math.sqrt(areas[0] / areas[1])
    measured = []
    for points in (dense.map.astype(np.float64), dense.grid.astype(np.float64)):
        across = (points[:-step, step:] - points[:-step, :-step])[corners]
        down = (points[step:, :-step] - points[:-step, :-step])[corners]
        measured.append(np.abs(across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]))
    return float(np.sqrt(np.median(measured[0] / measured[1])).clip(0.1, 10.0))
