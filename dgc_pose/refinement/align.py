"""Alignment of patches of the originals: matches to a part of a pixel.

Each match moves to the strongest corner near it in image 2. The patch around it, and the one that
the local affinity cuts from image 1, differ by a small shift, a gain and an offset: the inverse
compositional Lucas-Kanade iteration (Baker & Matthews, IJCV 2004) finds the shift, all patches at
once. Patches that do not become alike are dropped. Where one image shows things much larger, it is
shrunk first: patches would pick single pixels of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from dgc_pose.matching.dense import resize
from dgc_pose.refinement.consistency import LocalMatches
from dgc_pose.refinement.sampling import bilinear
from dgc_pose.threads import in_threads

_CORNER_RADIUS = 4  # pixels that a match moves at most, along each axis, to a corner
_CORNER_BLOCK = 7  # pixels a side that a corner's strength is measured over
_ITERATIONS = 8
_STEP = 1.5  # pixels at most of one iteration
_CHUNK = 256  # patches at a time, which stay in the processor's cache
_STILL = 0.02  # pixels of a step after which a patch is left alone
_SETTLED = 0.1  # pixels: the last step of an alignment that has converged
_HALVES = np.array([[0.5, 0.0], [0.0, 0.5]])  # pixels, for central differences
_NOISE = 1.0  # grey levels: patches of less contrast are flat
_ALIKE = 1.5  # zoom between the images up to which they are taken as they are


@dataclass(frozen=True)
class Aligned:
    """What alignment made of matches, in their order."""

    points1: np.ndarray  # (N, 2) float64, pixels of image 1
    points2: np.ndarray  # (N, 2) float64, corners of image 2
    zncc: np.ndarray  # (N,) float64, correlation of the aligned patches, -1 to 1
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
    back_px: float | None = None,
) -> Aligned:
    """Aligns at most `max_matches` matches, evenly spread over image 2, the strongest corners.

    pixels: (H, W, 3) uint8. radius: of a patch, pixels of image 2. max_shift: pixels of image 1
    that a match may move by. back_px: pixels of image 2 that a match may come back off, aligned
    the other way round; None: that is not done.
    """
    zoom = float(np.median(np.sqrt(np.linalg.det(matches.affinity)))) if len(matches.index) else 1.0
    shrink = np.array([min(1.0, 1 / zoom), min(1.0, zoom)])
    if shrink.min() > 1 / _ALIKE:
        return _align(
            pixels1, pixels2, matches, radius, np.full(2, max_shift), max_matches, back_px
        )
    small1, small2 = _shrunk(pixels1, shrink[0]), _shrunk(pixels2, shrink[1])
    scale1, scale2 = _scale(pixels1, small1), _scale(pixels2, small2)
    found = _align(
        small1,
        small2,
        LocalMatches(
            (matches.points1 + 0.5) * scale1 - 0.5,
            (matches.points2 + 0.5) * scale2 - 0.5,
            scale1[:, None] * matches.affinity / scale2,
            matches.index,
        ),
        radius,
        max_shift * scale1,
        max_matches,
        None if back_px is None else back_px * float(scale2.mean()),
    )
    return replace(
        found,
        points1=(found.points1 + 0.5) / scale1 - 0.5,
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
    back_px: float | None,
) -> Aligned:
    """As `align`, of images that show things about equally large; max_shift along each axis."""
    grey1, grey2 = (
        cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY).astype(np.float32) for pixels in (pixels1, pixels2)
    )
    corners, strength = _nearby_corners(grey2, matches.points2)
    chosen = spread(corners, strength, (pixels2.shape[1], pixels2.shape[0]), max_matches)
    corners, affinity = corners[chosen], matches.affinity[chosen]
    moved = corners - matches.points2[chosen]
    start = matches.points1[chosen] + np.einsum("nij,nj->ni", affinity, moved)
    points1, zncc, step = _shifts(grey1, grey2, start, corners, affinity, radius)
    settled = (points1 >= 0).all(1) & (points1 <= (grey1.shape[1] - 1, grey1.shape[0] - 1)).all(1)
    settled &= np.linalg.norm((points1 - start) / max_shift, axis=1) <= 1
    settled &= step < _SETTLED
    if back_px is not None:
        back = np.linalg.inv(affinity)
        returned, _, _ = _shifts(grey2, grey1, corners, points1, back, radius)
        settled &= np.linalg.norm(returned - corners, axis=1) <= back_px
    return Aligned(points1, corners, zncc, settled, matches.index[chosen])


def _shrunk(pixels: np.ndarray, scale: float) -> np.ndarray:
    height, width = pixels.shape[:2]
    return resize(pixels, (max(1, round(width * scale)), max(1, round(height * scale))))


def _scale(pixels: np.ndarray, shrunk: np.ndarray) -> np.ndarray:
    """By how much an image was shrunk, along x and y."""
    return np.divide(shrunk.shape[1::-1], pixels.shape[1::-1])


def _nearby_corners(grey: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The strongest corner within the radius of each point, and its strength."""
    strength = cv2.cornerMinEigenVal(grey, _CORNER_BLOCK)
    axis = np.arange(-_CORNER_RADIUS, _CORNER_RADIUS + 1)
    near = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
    limit = (grey.shape[1] - 1, grey.shape[0] - 1)
    places = (np.rint(points).astype(np.int64)[:, None] + near).clip(0, limit)
    values = strength[places[..., 1], places[..., 0]]
    rows, best = np.arange(len(points)), values.argmax(1)
    return places[rows, best].astype(np.float64), values[rows, best]


def spread(
    points: np.ndarray, strength: np.ndarray, size: tuple[int, int], most: int
) -> np.ndarray:
    """Indices of at most `most` of the points (N, 2): the strongest of each square block.

    strength: (N,). size: (width, height) of the image that the points lie in.
    """
    order = np.argsort(-strength, kind="stable")
    side = 1.0
    while True:
        blocks = (points[order] // side) @ (1, size[0] // side + 1)
        _, first = np.unique(blocks, return_index=True)
        if len(first) <= most:
            return np.sort(order[first])
        side *= 1.1


def _shifts(
    grey1: np.ndarray,
    grey2: np.ndarray,
    points1: np.ndarray,
    points2: np.ndarray,
    affinity: np.ndarray,
    radius: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places (N, 2) in image 1 after alignment, their correlation, and the last step in pixels."""

    def shift(start: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        part = slice(start, start + _CHUNK)
        return _shift(grey1, grey2, points1[part], points2[part], affinity[part], radius)

    found = in_threads(shift, range(0, max(1, len(points1)), _CHUNK))
    places, zncc, length = (np.concatenate(values) for values in zip(*found, strict=True))
    return places, zncc, length


def _shift(
    grey1: np.ndarray,
    grey2: np.ndarray,
    points1: np.ndarray,
    points2: np.ndarray,
    affinity: np.ndarray,
    radius: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `_shifts`, all at once."""
    axis = np.arange(-radius, radius + 1.0)
    offsets = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)  # (P, 2)
    weights = np.exp(-(offsets**2).sum(1) / (2 * (0.6 * radius) ** 2)).astype(np.float32)
    weights /= weights.sum()
    around2 = points2[:, None] + offsets
    template, contrast = _standardised(bilinear(grey2, around2), weights)
    slopes = [bilinear(grey2, around2 + half) - bilinear(grey2, around2 - half) for half in _HALVES]
    jacobian = np.stack(slopes, -1) / contrast[..., None]  # (N, P, 2)
    weighted = jacobian * weights[:, None]
    hessian = jacobian.transpose(0, 2, 1) @ weighted + 1e-6 * np.eye(2)
    gain = np.linalg.inv(hessian).astype(np.float32) @ weighted.transpose(0, 2, 1)  # (N, 2, P)
    around1 = (offsets @ affinity.transpose(0, 2, 1)).astype(np.float32)
    places = points1.copy()
    zncc, length = np.zeros(len(places)), np.full(len(places), np.inf)
    for _ in range(_ITERATIONS):
        moving = np.flatnonzero(length >= _STILL)
        if len(moving) == 0:
            break
        patch, _ = _standardised(
            bilinear(grey1, places[moving, None].astype(np.float32) + around1[moving]), weights
        )
        zncc[moving] = (patch * template[moving]) @ weights
        step = (gain[moving] @ (patch - template[moving])[..., None])[..., 0]
        length[moving] = np.linalg.norm(step, axis=1)
        step *= np.minimum(1, _STEP / np.maximum(length[moving], 1e-9))[:, None]
        # The template moved by `step` is the patch: so the patch's place moves back by it.
        places[moving] -= (affinity[moving] @ step[..., None])[..., 0]
    return places, zncc, length


def _standardised(patches: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Patches (N, P) with weighted mean 0 and deviation 1, and their deviations (N, 1).

    The noise is added to the deviation, so that flat patches stay small and resemble nothing.
    """
    patches = patches - (patches @ weights)[:, None]
    deviation = np.sqrt((patches**2 @ weights)[:, None] + _NOISE**2)
    return patches / deviation, deviation
