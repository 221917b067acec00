"""Alignment of patches of the original images, which refines matches to a fraction of a pixel.

Each match moves to the strongest corner near it in image 2. The local affine map (affinity) cuts a
patch from image 1. This patch and the patch around the corner differ by a small shift, a gain and
an offset; the shifts of all patches are computed at once. If the views are far apart, few patches
are similar: the affinity is inaccurate, and the shift exceeds the size of the structure. Such
patches are aligned on images shrunk until the error of the matches is one pixel, with the affinity
adjusted, and then on the originals. Patches that stay dissimilar are dropped. If the images differ
much in scale, the larger is shrunk first: otherwise neighbouring samples of its patches would be
many pixels apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from dgc_pose.geometry.pixels import rescale
from dgc_pose.geometry.sampling import spread
from dgc_pose.images.image import Image, resize_by
from dgc_pose.matches import Matches
from dgc_pose.matching.patches import LocalMatches, Patches, align_patches, consistent
from dgc_pose.system.parallel import in_threads

_CORNER_BLOCK = 7  # pixels a side of the block over which a corner's strength is measured
PATCH_RADIUS = 7  # pixels of image 2: patches of 15x15
MIN_ZNCC = 0.8  # least correlation of a pair of aligned patches
CORNER_RADIUS = 4  # largest move of a match to a corner by default, pixels along each axis
_CORNER_MARGIN = _CORNER_BLOCK // 2 + 1  # pixels around a corner that its strength depends on
_STRIP = 256  # rows measured at a time: a whole large image would take hundreds of MiB
_SHIFT = 5.0  # largest shift, in units of the matches' initial error
_SETTLED = 0.1  # pixels: an alignment has converged if its last step is shorter
_ENOUGH = 300  # aligned patches; with fewer, the others are tried again on shrunk images
# Error of an aligned match along one axis, pixels of the originals; see docs/experiments.md.
ALIGNED_ERROR_PX = 0.5
NEIGHBOURS = 12  # nearest matches whose affinity a match must fit
MIN_MATCHES = 50  # fewer matches that agree with their neighbours are not refined
_SIMILAR = 1.5  # ratio of the images' scales up to which neither is shrunk


def refine(
    image1: Image,
    image2: Image,
    matches: Matches,
    max_matches: int,
    corner_radius: int = CORNER_RADIUS,
) -> tuple[Matches, Matches]:
    """The aligned matches, at most `max_matches`, evenly spread; and all matches that agree with
    their neighbours, moved where alignment succeeds. Both are empty if fewer than `MIN_MATCHES`
    agree. corner_radius: largest move to a corner, pixels along each axis of image 2."""
    local = consistent(matches, NEIGHBOURS)
    if len(local.index) < MIN_MATCHES:
        none = matches.subset(local.index[:0])
        return none, none

    agreeing = matches.subset(local.index)
    pixels1 = image1.pixels
    pixels2 = image2.pixels
    error_px = matches.error_px
    aligned = align(pixels1, pixels2, local, error_px, max_matches, corner_radius)
    good = aligned.converged & (aligned.zncc >= MIN_ZNCC)
    moved = replace(
        matches,
        points1=aligned.points1[good],
        points2=aligned.points2[good],
        confidence=aligned.zncc[good].clip(0, 1),
        error_px=ALIGNED_ERROR_PX * aligned.pixel,
    )

    rows = np.searchsorted(local.index, aligned.index[good])
    points1 = agreeing.points1.copy()
    points2 = agreeing.points2.copy()
    points1[rows] = moved.points1
    points2[rows] = moved.points2
    return moved, replace(agreeing, points1=points1, points2=points2)


@dataclass(frozen=True)
class Aligned:
    """Aligned matches, in the order in which they were chosen."""

    points1: np.ndarray  # (N, 2) float64, pixels of image 1
    points2: np.ndarray  # (N, 2) float64, corners of image 2
    zncc: np.ndarray  # (N,) float64, see `Patches`
    converged: np.ndarray  # (N,) bool: came to rest near its start, see `_converged`
    index: np.ndarray  # (N,) int, indices of the original matches
    pixel: float = 1.0  # pixel size of the aligned images, in pixels of the originals: their mean


def align(
    pixels1: np.ndarray,
    pixels2: np.ndarray,
    matches: LocalMatches,
    error_px: float,
    max_matches: int,
    corner_radius: int = CORNER_RADIUS,
) -> Aligned:
    """At most `max_matches` aligned matches at strong corners, evenly spread over image 2. Each
    shifts by at most a few times `error_px`, the error of the matches in pixels of image 1."""
    areas = np.linalg.det(matches.affinity) if len(matches.index) else np.ones(1)
    scale = float(np.median(np.sqrt(areas)))
    shrinks = min(1.0, 1 / scale), min(1.0, scale)
    if min(shrinks) > 1 / _SIMILAR:
        shrinks = 1.0, 1.0
    small1, small2, matches, scale1, scale2 = _shrunk(pixels1, pixels2, matches, *shrinks)
    error = error_px * scale1  # along each axis
    grey1, grey2 = (cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY) for pixels in (small1, small2))
    corners, strength = nearby_corners(grey2, matches.points2, corner_radius)
    rows = spread(corners, strength, (grey2.shape[1], grey2.shape[0]), max_matches)
    chosen = matches.subset(rows)
    corners = corners[rows]
    moved = corners - chosen.points2
    start = chosen.points1 + np.einsum("nij,nj->ni", chosen.affinity, moved)
    chosen = replace(chosen, points1=start, points2=corners)
    grey1 = grey1.astype(np.float32)
    grey2 = grey2.astype(np.float32)

    patches = align_patches(grey1, grey2, chosen, PATCH_RADIUS)
    converged = _converged(patches, start, grey1, _SHIFT * error)
    points1 = patches.points1
    zncc = patches.zncc
    rest = np.flatnonzero(~(converged & (zncc >= MIN_ZNCC)))
    if len(rows) - len(rest) < _ENOUGH:
        again1, again_zncc, similar = _from_coarse(grey1, grey2, chosen.subset(rest), error)
        again = rest[similar]
        points1[again] = again1
        zncc[again] = again_zncc
        converged[again] = True
    return Aligned(
        _to_original(points1, scale1),
        _to_original(corners, scale2),
        zncc,
        converged,
        chosen.index,
        pixel=float((1 / scale1 + 1 / scale2).mean()) / 2,
    )


def _from_coarse(
    grey1: np.ndarray, grey2: np.ndarray, matches: LocalMatches, error: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (M, 2), correlations (M,) and rows (M,) of the matches whose patches become similar on
    shrunk images with adjusted affinities. Points are aligned on the full images where this
    succeeds. error: of the matches, along each axis of image 1."""
    shrink = min(1.0, 1 / float(error.mean()))
    small1, small2, moved, scale1, scale2 = _shrunk(grey1, grey2, matches, shrink, shrink)
    coarse = align_patches(small1, small2, moved, PATCH_RADIUS, affine=True)
    coarse = replace(coarse, points1=_to_original(coarse.points1, scale1))
    near = _converged(coarse, matches.points1, grey1, _SHIFT * error)
    similar = np.flatnonzero(near & (coarse.zncc >= MIN_ZNCC))
    affinity = coarse.affinity[similar] * scale2 / scale1[:, None]
    points1 = coarse.points1[similar]
    zncc = coarse.zncc[similar]
    start = replace(matches.subset(similar), points1=points1, affinity=affinity)
    fine = align_patches(grey1, grey2, start, PATCH_RADIUS)
    better = _converged(fine, points1, grey1, _SHIFT * error) & (fine.zncc >= MIN_ZNCC)
    points1 = np.where(better[:, None], fine.points1, points1)
    return points1, np.where(better, fine.zncc, zncc), similar


def _shrunk(
    pixels1: np.ndarray, pixels2: np.ndarray, matches: LocalMatches, *shrinks: float
) -> tuple[np.ndarray, np.ndarray, LocalMatches, np.ndarray, np.ndarray]:
    """Both images, each shrunk by its factor; the matches in pixels of the shrunk images; and for
    each image its scale along both axes (2,), shrunk pixels per original pixel."""
    small1 = resize_by(pixels1, shrinks[0])
    small2 = resize_by(pixels2, shrinks[1])
    sizes = [pixels.shape[1::-1] for pixels in (pixels1, small1, pixels2, small2)]
    scale1 = np.divide(sizes[1], sizes[0])
    scale2 = np.divide(sizes[3], sizes[2])
    moved = LocalMatches(
        rescale(matches.points1, *sizes[:2]),
        rescale(matches.points2, *sizes[2:]),
        scale1[:, None] * matches.affinity / scale2,
        matches.index,
    )
    return small1, small2, moved, scale1, scale2


def _to_original(points: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Points of a shrunk image in pixels of the original: the inverse of `rescale`, to the bit."""
    return (points + 0.5) / scale - 0.5


def _converged(
    patches: Patches, start: np.ndarray, image: np.ndarray, max_shift: np.ndarray | float
) -> np.ndarray:
    """Which patches came to rest on the image, within `max_shift` of their start: (N,) bool."""
    points = patches.points1
    on_image = ((points >= 0) & (points <= np.subtract(image.shape[1::-1], 1))).all(1)
    near = np.linalg.norm((points - start) / max_shift, axis=1) <= 1
    return on_image & near & (patches.step < _SETTLED)


def locate(
    grey1: np.ndarray, grey2: np.ndarray, matches: LocalMatches, *, radius: int, max_shift: float
) -> Aligned:
    """As `align`, but for all matches, with their points in image 2 fixed, and without shrunk
    images. max_shift: pixels of image 1."""
    patches = align_patches(grey1, grey2, matches, radius)
    converged = _converged(patches, matches.points1, grey1, max_shift)
    return Aligned(patches.points1, matches.points2, patches.zncc, converged, matches.index)


def nearby_corners(
    grey: np.ndarray, points: np.ndarray, radius: int = CORNER_RADIUS
) -> tuple[np.ndarray, np.ndarray]:
    """The strongest corner (N, 2) within `radius` pixels of each point (N, 2) along each axis, and
    its strength (N,). grey: (H, W) uint8 or float32."""
    height, width = grey.shape
    near = np.arange(-radius, radius + 1)
    x, y = np.rint(points).astype(np.int64).T[:, :, None] + near
    x = x.clip(0, width - 1)
    y = y.clip(0, height - 1)
    corners = np.empty((len(points), 2))
    strength = np.empty(len(points), np.float32)
    strip = y[:, radius] // _STRIP

    def measure(number: int) -> None:
        here = np.flatnonzero(strip == number)
        columns = x[here]
        rows = y[here]
        left, top = (max(0, int(axis.min()) - _CORNER_MARGIN) for axis in (columns, rows))
        bottom, right = (int(axis.max()) + _CORNER_MARGIN + 1 for axis in (rows, columns))
        measured = cv2.cornerMinEigenVal(grey[top:bottom, left:right], _CORNER_BLOCK)
        values = measured[(rows - top)[:, :, None], (columns - left)[:, None]]
        values = values.reshape(len(here), -1)
        each = np.arange(len(here))
        best = values.argmax(1)
        row, column = np.divmod(best, len(near))
        corners[here] = np.stack([columns[each, column], rows[each, row]], -1)
        strength[here] = values[each, best]

    in_threads(measure, np.unique(strip).tolist())
    return corners, strength
