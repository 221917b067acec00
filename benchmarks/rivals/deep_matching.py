"""DeepMatching (Revaud et al., IJCV 2016): quasi-dense matches without learned weights.

Section numbers and names are the paper's. The responses of 4x4 patches of one image to all places
of the other are max-pooled and averaged to those of patches of twice the side, until a patch spans
the image; from the maxima of the largest patches the matches of the atoms follow by going back
down. All arrays are indexed by row and column.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from matplotlib.tri import LinearTriInterpolator, Triangulation

from dgc_pose.geometry.neighbours import nearest_to
from dgc_pose.geometry.pixels import pixel_grid
from dgc_pose.images.image import Image, resize
from dgc_pose.matching.flow import scaled_map
from dgc_pose.matching.matcher import Matcher, MatchResult
from dgc_pose.matching.selection import MatchingOptions, select_matches

# Pixels of both images, whose shape is not kept. Time and memory grow with its fourth power: 384
# takes 40 s and 3.5 GB, and does not match VGG's graf 1-4 either.
SIDE = 256
ATOM = 4  # side of the smallest patches, pixels
_SMOOTHING = 1.0  # deviation of each of the three Gaussians of section 3.1, pixels
_SLOPE = 0.2  # of the sigmoid, per grey level
_CONSTANT = 0.3  # the ninth value of a descriptor, which makes flat places alike
_POWER = 1.4  # of the rectification (equation 6)
_QUADRANTS = tuple((y, x) for y in (-1, 1) for x in (-1, 1))


@dataclass(frozen=True)
class AtomMatches:
    """Matches of the 4x4 patches of image 2, each the best of its patch and of its place."""

    points2: np.ndarray  # (N, 2) centres of the patches, pixels x, y of image 2
    points1: np.ndarray  # (N, 2) where they lie in image 1
    scores: np.ndarray  # (N,) sums of the responses from the largest patch to the smallest


class DeepMatcher(Matcher):
    """DeepMatching between both images, brought to 256x256, and a map interpolated between the
    matches."""

    name = "deepmatching"

    def __init__(self, options: MatchingOptions | None = None) -> None:
        self.options = options or MatchingOptions()

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        """The map over the 4x4 patches of image 2, and the matches selected from it.

        Matchability is 1 where a patch has a match, and 0 where the map is interpolated: linearly
        between the matches, as the nearest of them outside of their hull.
        """
        grey1, grey2 = (
            cv2.cvtColor(resize(image.pixels, (SIDE, SIDE)), cv2.COLOR_RGB2GRAY)
            for image in (image1, image2)
        )
        matches = deep_matches(grey1, grey2)
        cells = SIDE // ATOM
        centres = ATOM * pixel_grid((cells, cells)) + (ATOM - 1) / 2
        known = np.zeros((cells, cells), bool)
        columns, rows = (matches.points2 // ATOM).astype(int).T
        known[rows, columns] = True
        shift = _interpolated(matches.points2, matches.points1 - matches.points2, centres)
        # Centres of the cells of a map of `cells` a side, in its own pixels.
        points1 = (centres + shift + 0.5) / ATOM - 0.5
        correspondence_map = scaled_map(points1, known, image1.size, image2.size)
        return MatchResult(select_matches(correspondence_map, self.options), correspondence_map)


def _interpolated(points: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values (N, 2) at points (N, 2), interpolated at (..., 2); zero without points."""
    if len(points) == 0:
        return np.zeros(at.shape)
    _, index = nearest_to(at.reshape(-1, 2), points)
    result = values[index].reshape(at.shape)
    if np.linalg.matrix_rank(points - points[0]) == 2:
        triangles = Triangulation(*points.T)
        for axis in (0, 1):
            inside = LinearTriInterpolator(triangles, values[:, axis])(at[..., 0], at[..., 1])
            result[..., axis] = inside.filled(result[..., axis])
    return result


def deep_matches(grey1: np.ndarray, grey2: np.ndarray) -> AtomMatches:
    """Match the 4x4 patches of image 2 to image 1.

    grey1, grey2: (H, W) uint8 or float, grey levels of 0 to 255, of one shape whose sides are
    multiples of 4. Memory is about H^2 W^2 / 8 bytes.
    """
    descriptors1, patches2 = _patch_descriptors(grey1), _patch_descriptors(grey2)[::ATOM, ::ATOM]
    pooled = np.stack([_pooled(row) for row in _atom_responses(patches2, descriptors1)])
    levels: list[np.ndarray] = []
    while min(grey2.shape) >= ATOM * 2 ** (len(levels) + 1) and min(pooled.shape[2:]) >= 2:
        levels.append(_aggregated(pooled, step=_child_step(len(levels) + 1)))
        pooled = np.stack([_pooled(row) for row in levels[-1]])
    paths = _followed_down(levels, patches2, descriptors1)
    rows, columns, ys, xs = paths.at.T
    best = _reciprocal(
        rows * patches2.shape[1] + columns, ys // ATOM * grey1.shape[1] + xs // ATOM, paths.scores
    )
    centre = (ATOM - 1) / 2
    return AtomMatches(
        points2=np.column_stack([columns, rows])[best] * float(ATOM) + centre,
        points1=np.column_stack([xs, ys])[best] + centre,
        scores=paths.scores[best],
    )


def _patch_descriptors(grey: np.ndarray) -> np.ndarray:
    """The descriptor of the 4x4 patch right of and below each pixel: (H, W, 144), of length 1.

    That of a pixel (section 3.1) has eight directions of the gradient, smoothed and squashed, and a
    constant. Beyond the border the image is mirrored.
    """
    image = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _SMOOTHING)
    dx = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=1) / 2
    dy = cv2.Sobel(image, cv2.CV_32F, 0, 1, ksize=1) / 2
    values = []
    for angle in np.arange(8) * np.pi / 4:
        along = np.maximum(np.cos(angle) * dx + np.sin(angle) * dy, 0).astype(np.float32)
        squashed = 2 / (1 + np.exp(-_SLOPE * cv2.GaussianBlur(along, (0, 0), _SMOOTHING))) - 1
        values.append(cv2.GaussianBlur(squashed, (0, 0), _SMOOTHING))
    pixels = np.stack([*values, np.full_like(image, _CONSTANT)], axis=-1)
    pixels /= np.linalg.norm(pixels, axis=-1, keepdims=True)
    height, width = grey.shape
    padded = np.pad(pixels, ((0, ATOM - 1), (0, ATOM - 1), (0, 0)), mode="symmetric")
    parts = [padded[y : y + height, x : x + width] for y in range(ATOM) for x in range(ATOM)]
    return np.concatenate(parts, axis=-1) / ATOM


def _atom_responses(patches: np.ndarray, descriptors: np.ndarray) -> Iterator[np.ndarray]:
    """Of each row of patches (h, w, 144): their responses (w, H, W) to (H, W, 144), 0 to 1."""
    places = descriptors.reshape(-1, descriptors.shape[-1]).T
    for row in patches:
        yield (row @ places).reshape(len(row), *descriptors.shape[:2])


def _pooled(maps: np.ndarray) -> np.ndarray:
    """The maximum of 3x3 around every second place of each map: (n, H, W) to (n, H / 2, W / 2)."""
    for axis in (1, 2):
        maps = np.swapaxes(maps, 0, axis)
        even, odd = maps[::2], maps[1::2]
        pooled = np.maximum(even, odd)
        pooled[1:] = np.maximum(pooled[1:], odd[:-1])
        maps = np.swapaxes(pooled, 0, axis)
    return maps


def _aggregated(pooled: np.ndarray, step: int) -> np.ndarray:
    """The responses of patches of twice the side (section 3.2): (h, w, H, W), rectified.

    pooled: (h', w', H, W) of their quadrants. step: see `_child_step`. The quadrants lie one place
    away in each direction; those outside of the grid of patches or of the image respond with 0,
    and a patch counts those of its quadrants that the grid has.
    """
    height, width = pooled.shape[:2]
    shape = (height - 1, width - 1) if step == 0 else (height, width)
    total = np.zeros((*shape, *pooled.shape[2:]), np.float32)
    count = np.zeros((*shape, 1, 1), np.float32)
    for y, x in _QUADRANTS:
        to_rows, from_rows = _overlap(shape[0], height, _child(0, y, step))
        to_columns, from_columns = _overlap(shape[1], width, _child(0, x, step))
        to_ys, from_ys = _overlap(pooled.shape[2], pooled.shape[2], y)
        to_xs, from_xs = _overlap(pooled.shape[3], pooled.shape[3], x)
        total[to_rows, to_columns, to_ys, to_xs] += pooled[
            from_rows, from_columns, from_ys, from_xs
        ]
        count[to_rows, to_columns] += 1
    total /= count
    return np.power(total, _POWER, out=total)


def _child_step(level: int) -> int:
    """How far the quadrants of a patch of a level lie from it in the grid of patches.

    The grid has a patch every 4 pixels. A patch of level 1 lies between four atoms, which 0 stands
    for: its quadrants are the atoms of the same and of the next row and column.
    """
    return 2 ** (level - 2) if level > 1 else 0


def _child(index: Any, side: int, step: int) -> Any:
    """The row or column of a quadrant; side: -1 or 1."""
    return index + (side * step if step else (side + 1) // 2)


def _overlap(size: int, other: int, shift: int) -> tuple[slice, slice]:
    """Of two axes, the places i of the first and i + shift of the second that both have."""
    start, stop = max(0, -shift), min(size, other - shift)
    return slice(start, max(start, stop)), slice(start + shift, max(start, stop) + shift)


@dataclass(frozen=True)
class _Paths:
    """Ways down from large patches: where each has arrived, and the sum of its responses."""

    at: np.ndarray  # (M, 4): row and column of the patch, row and column of its place
    scores: np.ndarray  # (M,) float32

    def best(self, shape: tuple[int, ...]) -> "_Paths":
        """Of those at one patch and place, that of the largest sum."""
        places = np.ravel_multi_index(tuple(self.at.T), shape)
        order = np.lexsort((-self.scores, places))
        first = np.diff(places[order], prepend=-1) > 0
        return _Paths(self.at[order[first]], self.scores[order[first]])

    def to_quadrants(self, level: int, shape: tuple[int, ...]) -> "_Paths":
        """Each path to the quadrants of its patch, as far as `shape` (h, w, H, W) has them."""
        step = _child_step(level)
        at = np.concatenate(
            [
                np.column_stack(
                    [
                        _child(self.at[:, 0], y, step),
                        _child(self.at[:, 1], x, step),
                        2 * (self.at[:, 2:] + (y, x)),
                    ]
                )
                for y, x in _QUADRANTS
            ]
        )
        inside = ((at >= 0) & (at < shape)).all(1)
        return _Paths(at[inside], np.tile(self.scores, len(_QUADRANTS))[inside]).best(shape)

    def climbed(self, responses: np.ndarray) -> "_Paths":
        """Each path to the largest response within one place, which is added to its score."""
        height, width = responses.shape[2:]
        values, places = [], []
        for y in (-1, 0, 1):
            for x in (-1, 0, 1):
                ys = np.clip(self.at[:, 2] + y, 0, height - 1)
                xs = np.clip(self.at[:, 3] + x, 0, width - 1)
                values.append(responses[self.at[:, 0], self.at[:, 1], ys, xs])
                places.append(np.column_stack([ys, xs]))
        largest = np.argmax(values, axis=0)
        each = np.arange(len(largest))
        at = np.column_stack([self.at[:, :2], np.stack(places)[largest, each]])
        return _Paths(at, self.scores + np.stack(values)[largest, each])


def _maxima(responses: np.ndarray) -> _Paths:
    """The places of each map (h, w, H, W) that no neighbour exceeds."""
    high = responses > 0
    for axis in (2, 3):
        values, result = np.swapaxes(responses, 0, axis), np.swapaxes(high, 0, axis)
        result[1:] &= values[1:] >= values[:-1]
        result[:-1] &= values[:-1] >= values[1:]
    at = np.argwhere(high)
    return _Paths(at, responses[tuple(at.T)])


def _followed_down(
    levels: list[np.ndarray], patches: np.ndarray, descriptors: np.ndarray
) -> _Paths:
    """The paths from the maxima of the largest patches to the atoms (section 3.3)."""
    paths = _maxima(levels[-1])
    for level in range(len(levels) - 1, 0, -1):
        paths = paths.to_quadrants(level + 1, levels[level - 1].shape).climbed(levels[level - 1])
    paths = paths.to_quadrants(1, (*patches.shape[:2], *descriptors.shape[:2]))
    ends = []
    for row, responses in enumerate(_atom_responses(patches, descriptors)):
        here = paths.at[:, 0] == row
        at = paths.at[here] * (0, 1, 1, 1)
        end = _Paths(at, paths.scores[here]).climbed(responses[None])
        ends.append(_Paths(end.at + (row, 0, 0, 0), end.scores))
    return _Paths(
        np.concatenate([end.at for end in ends]), np.concatenate([end.scores for end in ends])
    )


def _reciprocal(first: np.ndarray, second: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Which of the pairs (first[i], second[i]) are the best of both: (N,) indices."""
    order = np.argsort(-scores, kind="stable")
    best1, best2 = (
        order[np.unique(names[order], return_index=True)[1]] for names in (first, second)
    )
    return np.intersect1d(best1, best2)
