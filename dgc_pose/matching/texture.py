"""Where an image has structure, which matches need, and how alike two images are around matches.

Two blank patches, or two patches of noise, agree with each other wherever they lie. A point can be
located if the image changes around it in every direction: both eigenvalues of the structure tensor
(Förstner and Gülch 1987) exceed those of the image's noise. Along an edge or a stripe the smaller
eigenvalue does not (the aperture problem). Uniform bars at the border are not part of the scene.

If two images show one place, the matches extend to an occlusion, to the border of an image, or to a
surface without texture. If they show two places with a similar object, wall or window, the matches
end at its outline, amid texture. Cells near the matches are therefore compared with the place in
the other image that the affinity of their nearest match predicts. Likeness is the cosine of the
frozen features there, minus its mean at random places.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from dgc_pose.geometry.pixels import pixel_grid, rescale, window_offsets, within
from dgc_pose.geometry.sampling import nearest_to
from dgc_pose.images.image import Image, resize_by
from dgc_pose.matches import Matches
from dgc_pose.matching.patches import consistent
from dgc_pose.matching.view import View
from dgc_pose.runtime.engine import NativeFeatures
from dgc_pose.system.parallel import in_threads

LONG_SIDE = 800  # pixels; larger images are shrunk to it, as they are for the features
_GRADIENT = 1.5  # standard deviation of the Gaussian before the derivative, pixels
_WINDOW = 4.0  # standard deviation of the Gaussian that averages the gradients, pixels
_EDGE = 5  # pixels at the image's border that the first Gaussian and the derivative reach
_TIMES_NOISE = 3.0  # least ratio of both eigenvalues to the noise's eigenvalue
_LEAST_NOISE = 2.0  # grey levels, for rounding, dithering and the blocks of JPEG
# Least ratio of the smaller eigenvalue to the larger; the jagged edges of a stripe have less.
_LEAST_RATIO = 0.003
_BAR_RANGE = 12.0  # largest range of the grey levels of a row or column in a bar
_BAR_SHARE = 0.02  # share of its pixels that may lie outside this range at each end
_BAR_EDGE = 8  # pixels beside a bar that its edge, smeared by compression, may reach
# Variance of the derivative of white noise of variance 1 after the Gaussian: 1 / (8 pi s^4).
_NOISE_GRADIENT = 1 / (8 * np.pi * _GRADIENT**4)
_NEIGHBOURS = 8  # matches whose affinity predicts where a cell lies
# Distance from a cell to the nearest match, in cells of stride 8 at full resolution: below the
# first, the cell is at a match; between the other two, it is around the matches.
_AT_MATCHES = 1.5
_RIM = (3.0, 8.0)
_MOST = 250  # most cells of each kind, drawn at random
_REACH = 2  # cells along each axis around a place that are searched
_PLACES = 4  # random places that a cell is compared with
_LEAST = 8  # least cells of each kind for an image to count
_LEAST_LIKENESS = 0.01  # lower bound of the likeness at matches, the divisor
_SEED = 0
_AROUND = window_offsets(_REACH).astype(np.int64)


@dataclass(frozen=True, eq=False)
class Texture:
    """The pixels of an image, or of a shrunk copy of it, that have structure."""

    mask: np.ndarray  # (h, w) bool
    size: tuple[int, int]  # (width, height) of the image

    @property
    def nbytes(self) -> int:
        return self.mask.nbytes

    def at(self, points: np.ndarray) -> np.ndarray:
        """Whether the image has structure at points (N, 2) in its pixels: (N,) bool; False outside
        the image and for points that are not finite."""
        height, width = self.mask.shape
        finite = np.isfinite(points).all(1)
        cells = rescale(np.where(finite[:, None], points, -1.0), self.size, (width, height))
        column, row = np.rint(cells.clip(-2, LONG_SIDE + 1)).astype(np.int64).T
        inside = finite & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        return inside & self.mask[row.clip(0, height - 1), column.clip(0, width - 1)]


def textured(matches: Matches, first: Texture, second: Texture) -> Matches:
    """The matches whose points have structure around them in both images."""
    kept = first.at(matches.points1) & second.at(matches.points2)
    return matches if kept.all() else matches.subset(kept)


def texture(image: Image) -> Texture:
    grey = cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY)
    shrunk = resize_by(grey, min(1.0, LONG_SIDE / max(image.size)))
    return Texture(structured(shrunk.astype(np.float32)), image.size)


def structured(grey: np.ndarray) -> np.ndarray:
    """Where a grey image (H, W) float32 of whole grey levels has structure in every direction:
    (H, W) bool."""
    mask = np.zeros(grey.shape, dtype=bool)
    rows = _content(grey)
    columns = _content(grey[rows].T)
    content = grey[rows, columns]
    if min(content.shape) <= 2 * _EDGE:
        return mask
    least = _TIMES_NOISE * _NOISE_GRADIENT * max(noise_level(content), _LEAST_NOISE) ** 2
    small, large = _eigenvalues(content)
    mask[rows, columns] = np.pad((small > least) & (small > _LEAST_RATIO * large), _EDGE)
    return mask


def noise_level(grey: np.ndarray) -> float:
    """Standard deviation of the noise of an image (H, W) float32 of whole grey levels, H, W >= 3.
    The difference of two Laplacians cancels planes and straight edges (Immerkær 1996); the estimate
    is from the upper quartile of its response, as clipping near black biases the median."""
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    response = np.abs(cv2.filter2D(grey, cv2.CV_32F, kernel)[1:-1, 1:-1])
    largest = 8 * 255  # all responses are whole numbers, so a histogram gives their quartile
    counts = cv2.calcHist([response], [0], None, [largest + 1], [0, largest + 1]).ravel()
    return float(np.searchsorted(counts.cumsum(), 0.75 * response.size)) / (1.1503 * 6)


def _eigenvalues(grey: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The smaller and the larger eigenvalue of the structure tensor at each pixel, except `_EDGE`
    pixels at the border: there the filters mirror the image, which gives a stripe a corner."""
    smooth = cv2.GaussianBlur(grey, (0, 0), _GRADIENT)
    smooth = smooth[_EDGE - 1 : 1 - _EDGE, _EDGE - 1 : 1 - _EDGE]
    x = (smooth[1:-1, 2:] - smooth[1:-1, :-2]) / 2
    y = (smooth[2:, 1:-1] - smooth[:-2, 1:-1]) / 2
    # Half the resolution loses nothing that the wide Gaussian keeps.
    height, width = x.shape
    halved = max(1, width // 2), max(1, height // 2)
    xx, yy, xy = (
        cv2.GaussianBlur(
            cv2.resize(product, halved, interpolation=cv2.INTER_AREA),
            (0, 0),
            _WINDOW / 2,
            borderType=cv2.BORDER_REPLICATE,
        )
        for product in (x * x, y * y, x * y)
    )
    mean = (xx + yy) / 2
    difference = (xx - yy) / 2
    half = np.sqrt(difference * difference + xy * xy)
    small, large = (cv2.resize(value, (width, height)) for value in (mean - half, mean + half))
    return small, large


def _content(grey: np.ndarray) -> slice:
    """The rows between uniform bars at the border, without the edges of the bars."""
    count = len(grey)
    before = next((k for k, row in enumerate(grey) if _varied(row)), count)
    after = next((k for k, row in enumerate(grey[::-1]) if _varied(row)), count)
    first, last = (k + _BAR_EDGE if k else 0 for k in (before, after))
    return slice(min(first, count), max(count - last, first, 0))


def _varied(row: np.ndarray) -> bool:
    if len(row) == 0:
        return False
    low, high = np.quantile(row.astype(float), (_BAR_SHARE, 1 - _BAR_SHARE))
    return bool(high - low > _BAR_RANGE)


def context_ratio(
    views: Sequence[tuple[View, NativeFeatures]],
    textures: Sequence[Texture],
    matches: Matches,
    scale: float = 1.0,
) -> float | None:
    """Ratio of the mean likeness around the matches to the mean likeness at them, over cells with
    structure and no mask; the smaller ratio of the two images. None if both images have too few
    such cells. scale: ratio of the views' sides to the sides at full resolution."""
    first, second = views
    both = (first, second, textures[1], matches), (second, first, textures[0], matches.swapped())
    shares = []
    for at_matches, around in in_threads(lambda one: _likeness(*one, scale), both):
        if min(len(at_matches), len(around)) >= _LEAST:
            shares.append(float(around.mean()) / max(float(at_matches.mean()), _LEAST_LIKENESS))
    return min(shares, default=None)


def _likeness(
    source: tuple[View, NativeFeatures],
    target: tuple[View, NativeFeatures],
    texture: Texture,
    every: Matches,
    scale: float,
) -> list[np.ndarray]:
    """The likeness of cells of the target (image 2 of `every`): at the matches, and around them."""
    matches = consistent(every, _NEIGHBOURS)
    rng = np.random.default_rng(_SEED)
    view1, features1 = source
    view2, features2 = target
    sides1, sides2 = (features.middle.shape[1::-1] for features in (features1, features2))
    centres1, centres = (
        view.centres(sides).reshape(-1, 2) for view, sides in ((view1, sides1), (view2, sides2))
    )

    random = pixel_grid(sides1).reshape(-1, 2)[within(centres1, view1.image.size)]
    at = view2.to_view(matches.points2, sides2)
    distance, nearest = nearest_to(pixel_grid(sides2).reshape(-1, 2), at)
    distance = distance / scale
    usable = texture.at(centres) & ~view2.image.is_masked(centres)

    result = []
    for kind in (distance < _AT_MATCHES, (distance >= _RIM[0]) & (distance < _RIM[1])):
        chosen = rng.permutation(np.flatnonzero(kind & usable))[:_MOST]
        near = matches.subset(nearest[chosen])
        offsets = centres[chosen] - near.points2
        points = near.points1 + np.einsum("nij,nj->ni", near.affinity, offsets)
        place = view1.to_view(points, sides1)
        shown = within(place, sides1) & view1.shows(points)
        wanted = features2.middle.reshape(len(centres), -1)[chosen[shown]]
        places = random[rng.integers(len(random), size=(_PLACES, len(wanted)))]
        elsewhere = [_best(features1.middle, wanted, other) for other in places]
        result.append(_best(features1.middle, wanted, place[shown]) - np.mean(elsewhere, 0))
    return result


def _best(middle: np.ndarray, wanted: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The largest cosine (N,) of features (N, C) in a window around places (N, 2) of a level."""
    cells = np.rint(places).astype(np.int64)[:, None] + _AROUND
    x, y = cells.clip(0, np.subtract(middle.shape[1::-1], 1)).transpose(2, 0, 1)
    return (middle[y, x] @ wanted[:, :, None])[..., 0].max(1)
