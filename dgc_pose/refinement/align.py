"""Alignment of patches of the original images: matches to a fraction of a pixel.

Each match moves to the strongest corner near it in image 2. The patch around it, and the one that
the local affinity cuts from image 1, differ by a small shift, a gain and an offset. The inverse
compositional Lucas-Kanade iteration (Baker & Matthews, IJCV 2004) finds the shift, for all patches
at once. Patches that stay dissimilar are dropped. If the scales of the images differ much, the
larger one is shrunk first: neighbouring samples of its patches would be many pixels apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from dgc_pose.image import resize_by
from dgc_pose.pixels import rescale
from dgc_pose.refinement.consistency import LocalMatches
from dgc_pose.sampling import bilinear_at
from dgc_pose.threads import in_threads

_CORNER_RADIUS = 4  # pixels along each axis; largest move of a match to a corner
_CORNER_BLOCK = 7  # pixels a side that a corner's strength is measured over
_CORNER_MARGIN = _CORNER_BLOCK // 2 + 1  # pixels beyond, which the block and its gradients reach
_STRIP = 256  # rows measured at a time: of a large image all take hundreds of MiB
_ITERATIONS = 8
_STEP = 1.5  # pixels at most of one iteration
_CHUNK = 256  # patches at a time, which stay in the processor's cache
_STILL = 0.02  # pixels of a step after which a patch is not moved again
_SETTLED = 0.1  # pixels: the last step of an alignment that has converged
_NOISE = 1.0  # grey levels, added to the contrast of a patch
_FLAT = np.sqrt(2) * _NOISE  # contrast, with that, of a patch that has none of its own
_SIMILAR = 1.5  # scale between the images up to which neither is shrunk


@dataclass(frozen=True)
class Aligned:
    """The result of alignment, in the order of the matches chosen."""

    points1: np.ndarray  # (N, 2) float64, pixels of image 1
    points2: np.ndarray  # (N, 2) float64, corners of image 2
    # (N,) float64, correlation of the aligned patches, -1 to 1; NaN, as it is undefined, if one of
    # them has no more contrast than noise
    zncc: np.ndarray
    converged: np.ndarray  # (N,) bool: settled, within the tolerance of where it began
    index: np.ndarray  # (N,) int, of the matches that they come from
    pixel: float = 1.0  # of the images aligned, in pixels of the originals: mean over both


def align(
    pixels1: np.ndarray,
    pixels2: np.ndarray,
    matches: LocalMatches,
    *,
    radius: int,
    max_shift: float,
    max_matches: int,
) -> Aligned:
    """Aligns at most `max_matches` matches, evenly spread over image 2, the strongest corners.

    pixels: (H, W, 3) uint8. radius: of a patch, pixels of image 2. max_shift: pixels of image 1
    that a match may move by.
    """
    areas = np.linalg.det(matches.affinity) if len(matches.index) else np.ones(1)
    scale = float(np.median(np.sqrt(areas)))
    shrink1, shrink2 = min(1.0, 1 / scale), min(1.0, scale)
    if min(shrink1, shrink2) > 1 / _SIMILAR:
        return _align(pixels1, pixels2, matches, radius, np.full(2, max_shift), max_matches)
    small1, small2 = resize_by(pixels1, shrink1), resize_by(pixels2, shrink2)
    size1, size2, small_size1, small_size2 = (
        pixels.shape[1::-1] for pixels in (pixels1, pixels2, small1, small2)
    )
    scale1, scale2 = np.divide(small_size1, size1), np.divide(small_size2, size2)
    found = _align(
        small1,
        small2,
        LocalMatches(
            rescale(matches.points1, size1, small_size1),
            rescale(matches.points2, size2, small_size2),
            scale1[:, None] * matches.affinity / scale2,
            matches.index,
        ),
        radius,
        max_shift * scale1,
        max_matches,
    )
    return replace(
        found,
        points1=(found.points1 + 0.5) / scale1 - 0.5,  # the inverse of `rescale` above, to the bit
        points2=(found.points2 + 0.5) / scale2 - 0.5,
        pixel=float((1 / scale1 + 1 / scale2).mean()) / 2,
    )


def _align(
    pixels1: np.ndarray,
    pixels2: np.ndarray,
    matches: LocalMatches,
    radius: int,
    max_shift: np.ndarray,
    max_matches: int,
) -> Aligned:
    """As `align`, of images of similar scale; max_shift along each axis."""
    grey1, grey2 = (cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY) for pixels in (pixels1, pixels2))
    corners, strength = nearby_corners(grey2, matches.points2)
    chosen = spread(corners, strength, (pixels2.shape[1], pixels2.shape[0]), max_matches)
    corners, affinity = corners[chosen], matches.affinity[chosen]
    moved = corners - matches.points2[chosen]
    start = matches.points1[chosen] + np.einsum("nij,nj->ni", affinity, moved)
    return _aligned(
        grey1.astype(np.float32),
        grey2.astype(np.float32),
        LocalMatches(start, corners, affinity, matches.index[chosen]),
        radius,
        max_shift,
    )


def locate(
    grey1: np.ndarray, grey2: np.ndarray, matches: LocalMatches, *, radius: int, max_shift: float
) -> Aligned:
    """As `align`, of the points of image 2 as they are, all of them.

    grey: (H, W) float32. matches: points1 are where the search begins. radius: of a patch, pixels
    of image 2. max_shift: pixels of image 1.
    """
    return _aligned(grey1, grey2, matches, radius, np.full(2, max_shift))


def _aligned(
    grey1: np.ndarray,
    grey2: np.ndarray,
    matches: LocalMatches,
    radius: int,
    max_shift: np.ndarray,
) -> Aligned:
    """The points of image 1 moved so that their patches agree with those of image 2."""
    start, corners, affinity = matches.points1, matches.points2, matches.affinity
    found = in_threads(
        lambda part: _shift(grey1, grey2, start[part], corners[part], affinity[part], radius),
        [slice(i, i + _CHUNK) for i in range(0, max(1, len(start)), _CHUNK)],
    )
    points1, zncc, step = (np.concatenate(values) for values in zip(*found, strict=True))
    settled = (points1 >= 0).all(1) & (points1 <= (grey1.shape[1] - 1, grey1.shape[0] - 1)).all(1)
    settled &= np.linalg.norm((points1 - start) / max_shift, axis=1) <= 1
    settled &= step < _SETTLED
    return Aligned(points1, corners, zncc, settled, matches.index)


def nearby_corners(grey: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The strongest corner (N, 2) within a few pixels of each point, and its strength (N,).

    grey: (H, W) uint8 or float32. points: (N, 2), pixels.
    """
    height, width = grey.shape
    near = np.arange(-_CORNER_RADIUS, _CORNER_RADIUS + 1)
    x, y = np.rint(points).astype(np.int64).T[:, :, None] + near
    x, y = x.clip(0, width - 1), y.clip(0, height - 1)
    corners, strength = np.empty((len(points), 2)), np.empty(len(points), np.float32)
    strip = y[:, _CORNER_RADIUS] // _STRIP
    for number in np.unique(strip):
        own = np.flatnonzero(strip == number)
        columns, rows = x[own], y[own]
        left, top = (max(0, int(axis.min()) - _CORNER_MARGIN) for axis in (columns, rows))
        part = grey[
            top : rows.max() + _CORNER_MARGIN + 1, left : columns.max() + _CORNER_MARGIN + 1
        ]
        measured = cv2.cornerMinEigenVal(part, _CORNER_BLOCK)
        values = measured[(rows - top)[:, :, None], (columns - left)[:, None]].reshape(len(own), -1)
        each, best = np.arange(len(own)), values.argmax(1)
        row, column = np.divmod(best, len(near))
        corners[own] = np.stack([columns[each, column], rows[each, row]], -1)
        strength[own] = values[each, best]
    return corners, strength


def spread(
    points: np.ndarray, strength: np.ndarray, size: tuple[int, int], most: int
) -> np.ndarray:
    """Indices of at most `most` of the points (N, 2): the strongest of each square block.

    strength: (N,). size: (width, height) of the image of the points.
    """
    order = np.argsort(-strength, kind="stable")
    x, y = points[order].T
    side = 1.0
    while True:
        blocks = np.floor(x / side) + np.floor(y / side) * (size[0] // side + 1)
        if np.count_nonzero(np.diff(np.sort(blocks))) < most:
            _, first = np.unique(blocks, return_index=True)
            return np.sort(order[first])
        side *= 1.1


def _shift(
    grey1: np.ndarray,
    grey2: np.ndarray,
    points1: np.ndarray,
    points2: np.ndarray,
    affinity: np.ndarray,
    radius: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (N, 2) in image 1 after alignment, their correlation, and the last step in pixels.

    grey: (H, W) float32. affinity: (N, 2, 2), of offsets in image 2 to offsets in image 1.
    """
    axis, halves = np.arange(-radius, radius + 1.0), np.arange(-radius - 0.5, radius + 1.0)
    offsets = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)  # (P, 2)
    weights = np.exp(-(offsets**2).sum(1) / (2 * (0.6 * radius) ** 2)).astype(np.float32)
    weights /= weights.sum()
    template, contrast = _standardised(_window(grey2, points2, axis, axis), weights)
    across, down = _window(grey2, points2, halves, axis), _window(grey2, points2, axis, halves)
    slopes = (
        np.diff(across.reshape(-1, len(axis), len(halves)), axis=2),
        np.diff(down.reshape(-1, len(halves), len(axis)), axis=1),
    )
    jacobian = np.stack(slopes, 1).reshape(-1, 2, len(offsets)) / contrast[..., None]
    weighted = jacobian * weights
    hessian = weighted @ jacobian.transpose(0, 2, 1) + 1e-6 * np.eye(2)
    gain = np.linalg.inv(hessian).astype(np.float32) @ weighted  # (N, 2, P)
    # The coordinates apart: NumPy is slow along an axis of two.
    around_x, around_y = (affinity.transpose(1, 0, 2) @ offsets.T).astype(np.float32)
    points1 = points1.copy()
    zncc, length = np.zeros(len(points1)), np.full(len(points1), np.inf)
    for _ in range(_ITERATIONS):
        moving = np.flatnonzero(length >= _STILL)
        if len(moving) == 0:
            break
        centres = points1[moving].astype(np.float32)
        x, y = around_x[moving] + centres[:, :1], around_y[moving] + centres[:, 1:]
        patch, own = _standardised(bilinear_at(grey1, x, y), weights)
        expected = template[moving]
        flat = np.minimum(own, contrast[moving])[:, 0] < _FLAT
        zncc[moving] = np.where(flat, np.nan, (patch * expected) @ weights)
        step = (gain[moving] @ (patch - expected)[..., None])[..., 0]
        length[moving] = np.linalg.norm(step, axis=1)
        step *= np.minimum(1, _STEP / np.maximum(length[moving], 1e-9))[:, None]
        # The template moved by `step` equals the patch, so the patch moves back by it.
        points1[moving] -= (affinity[moving] @ step[..., None])[..., 0]
    return points1, zncc, length


def _window(grey: np.ndarray, points: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Values (N, Y * X) of an image around points (N, 2), at offsets x (X,) of each of y (Y,)."""
    columns, rows = (offset.ravel() for offset in np.meshgrid(x, y))
    return bilinear_at(grey, points[:, :1] + columns, points[:, 1:] + rows)


def _standardised(patches: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Patches (N, P) with weighted mean 0 and deviation 1, and their deviations (N, 1).

    The noise is added to the deviation, so that flat patches stay small and correlate with nothing.
    """
    patches = patches - (patches @ weights)[:, None]
    deviation = np.sqrt((patches**2 @ weights)[:, None] + _NOISE**2)
    return patches / deviation, deviation
