"""DeepMatching (Revaud et al., IJCV 2016): quasi-dense matches without learned weights.

Section numbers and names are the paper's. The responses of 4x4 patches of one image to all places
of the other are max-pooled and averaged to those of patches of twice the side, until a patch spans
the image; from the maxima of the largest patches the matches of the atoms follow by going back
down. All arrays are indexed by row and column.
"""

from collections.abc import Iterator

import cv2
import numpy as np

from dgc_pose.geometry.neighbours import nearest_to
from dgc_pose.geometry.pixels import pixel_grid
from dgc_pose.images.image import Image, resize
from dgc_pose.matches import Matches
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
_SIDES = tuple(np.ndindex(2, 2))  # of the quadrants: 0 above or left, 1 below or right
# Ways down from large patches. at (M, 4): row and column of the patch where each has arrived, row
# and column of its place; scores (M,) float32: the sum of its responses.
Paths = tuple[np.ndarray, np.ndarray]


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
    from matplotlib.tri import LinearTriInterpolator, Triangulation  # slow to import

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


def deep_matches(grey1: np.ndarray, grey2: np.ndarray) -> Matches:
    """Match the 4x4 patches of image 2 to image 1, centre to centre: each match is the best of its
    patch and of its place.

    grey1, grey2: (H, W) uint8 or float, grey levels of 0 to 255, of one shape whose sides are
    multiples of 4. Memory is about H^2 W^2 / 8 bytes.
    """
    descriptors1, patches2 = _patch_descriptors(grey1), _patch_descriptors(grey2)[::ATOM, ::ATOM]
    pooled = np.stack([_pooled(row) for row in _atom_responses(patches2, descriptors1)])
    levels: list[np.ndarray] = []
    while min(grey2.shape) >= ATOM * 2 ** (len(levels) + 1) and min(pooled.shape[2:]) >= 2:
        levels.append(_aggregated(pooled, len(levels) + 1))
        pooled = np.stack([_pooled(row) for row in levels[-1]])
    at, scores = _followed_down(levels, patches2, descriptors1)
    rows, columns, ys, xs = at.T
    best = _reciprocal(
        rows * patches2.shape[1] + columns, ys // ATOM * grey1.shape[1] + xs // ATOM, scores
    )
    centre = (ATOM - 1) / 2
    points2 = np.column_stack([columns, rows])[best] * ATOM + centre
    points1 = np.column_stack([xs, ys])[best] + centre
    return Matches(points1, points2, np.ones(len(best)), float(ATOM))


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


def _aggregated(pooled: np.ndarray, level: int) -> np.ndarray:
    """The responses of the patches of a level (section 3.2): (h, w, H, W), rectified.

    pooled: (h', w', H, W) of their quadrants, which lie one place away in each direction; those
    outside of the grid of patches or of the image respond with 0, and a patch counts those of its
    quadrants that the grid has.
    """
    step, apart = _quadrants(level)
    (rows, columns), (ys, xs) = pooled.shape[:2], pooled.shape[2:]
    height, width = rows + 2 * step - apart, columns + 2 * step - apart
    padded = np.pad(pooled, [(step, step)] * 2 + [(1, 1)] * 2)
    known = np.pad(np.ones((rows, columns, 1, 1), np.float32), [(step, step)] * 2 + [(0, 0)] * 2)
    total = np.zeros((height, width, ys, xs), np.float32)
    count = np.zeros((height, width, 1, 1), np.float32)
    for y, x in _SIDES:
        window = slice(y * apart, y * apart + height), slice(x * apart, x * apart + width)
        total += padded[(*window, slice(2 * y, 2 * y + ys), slice(2 * x, 2 * x + xs))]
        count += known[window]
    total /= count
    return np.power(total, _POWER, out=total)


def _quadrants(level: int) -> tuple[int, int]:
    """How far before a patch of a level its first quadrant lies in the grid of patches, and how far
    apart its quadrants lie.

    The grid has a patch every 4 pixels. A patch of level 1 lies between four atoms, its quadrants.
    """
    step = 2 ** (level - 2) if level > 1 else 0
    return step, max(2 * step, 1)


def _best(at: np.ndarray, scores: np.ndarray, shape: tuple[int, ...]) -> Paths:
    """Of the paths at one patch and place, that of the largest sum."""
    places = np.ravel_multi_index(tuple(at.T), shape)
    order = np.lexsort((-scores, places))
    first = np.diff(places[order], prepend=-1) > 0
    return at[order[first]], scores[order[first]]


def _to_quadrants(at: np.ndarray, scores: np.ndarray, level: int, shape: tuple[int, ...]) -> Paths:
    """Each path to the quadrants of its patch, as far as `shape` (h, w, H, W) has them."""
    step, apart = _quadrants(level)
    sides: np.ndarray = np.array(_SIDES)[:, None]
    rows_columns = at[:, :2] - step + apart * sides
    ends = np.concatenate([rows_columns, 2 * (at[:, 2:] - 1 + 2 * sides)], -1).reshape(-1, 4)
    inside = ((ends >= 0) & (ends < shape)).all(1)
    return _best(ends[inside], np.tile(scores, len(_SIDES))[inside], shape)


def _climbed(at: np.ndarray, scores: np.ndarray, responses: np.ndarray) -> Paths:
    """Each path to the largest response within one place, which is added to its score."""
    most = np.array(responses.shape[2:]) - 1
    near = np.array([*np.ndindex(3, 3)]) - 1
    places = np.clip(at[:, 2:] + near[:, None], 0, most)
    values = responses[at[:, 0], at[:, 1], places[..., 0], places[..., 1]]
    each = np.arange(len(at))
    largest = np.argmax(values, axis=0)
    return np.column_stack([at[:, :2], places[largest, each]]), scores + values[largest, each]


def _maxima(responses: np.ndarray) -> Paths:
    """The places of each map (h, w, H, W) that no neighbour exceeds."""
    high = responses > 0
    for axis in (2, 3):
        values, result = np.swapaxes(responses, 0, axis), np.swapaxes(high, 0, axis)
        result[1:] &= values[1:] >= values[:-1]
        result[:-1] &= values[:-1] >= values[1:]
    at = np.argwhere(high)
    return at, responses[tuple(at.T)]


def _followed_down(levels: list[np.ndarray], patches: np.ndarray, descriptors: np.ndarray) -> Paths:
    """The paths from the maxima of the largest patches to the atoms (section 3.3)."""
    paths = _maxima(levels[-1])
    for level in range(len(levels) - 1, 0, -1):
        paths = _to_quadrants(*paths, level + 1, levels[level - 1].shape)
        paths = _climbed(*paths, levels[level - 1])
    at, scores = _to_quadrants(*paths, 1, (*patches.shape[:2], *descriptors.shape[:2]))
    ends = []
    for row, responses in enumerate(_atom_responses(patches, descriptors)):
        here = at[:, 0] == row
        end, total = _climbed(at[here] * (0, 1, 1, 1), scores[here], responses[None])
        ends.append((end + (row, 0, 0, 0), total))
    return np.concatenate([end for end, _ in ends]), np.concatenate([total for _, total in ends])


def _reciprocal(first: np.ndarray, second: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Which of the pairs (first[i], second[i]) are the best of both: (N,) indices."""
    order = np.argsort(-scores, kind="stable")
    best1, best2 = (
        order[np.unique(names[order], return_index=True)[1]] for names in (first, second)
    )
    return np.intersect1d(best1, best2)
