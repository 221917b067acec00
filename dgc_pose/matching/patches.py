"""Matches that agree with their neighbours, their affinities, and patches aligned by these.

Two views of a surface differ locally by an affine map (affinity). For each match, an affinity is
fitted to its nearest matches in image 2 by iteratively reweighted least squares; matches that do
not fit are dropped. A patch of image 2 and the patch that the affinity cuts from image 1 differ by
a small shift, a gain, an offset, and the error of the affinity. The inverse compositional
Lucas-Kanade iteration (Baker & Matthews, IJCV 2004) finds the shifts of many patches at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgc_pose.geometry.pixels import window_offsets
from dgc_pose.geometry.sampling import bilinear_at, nearest
from dgc_pose.matches import Matches
from dgc_pose.system.parallel import in_threads, slices

_ROUNDS = 4  # of reweighting; the tolerance shrinks from round to round
_TOLERANCE = 2.5  # residual in units of the matches' error at which the weight has fallen to 1/4
_LEAST_SUPPORT = 5  # least inliers, within twice the tolerance, including the match itself
_STRETCH = (0.2, 5.0)  # least and largest singular value of a plausible affinity
_ITERATIONS = 8
_AFFINE_ITERATIONS = 12
_STEP = 1.5  # largest step of one iteration, pixels
_CHUNK = 256  # patches at a time, so that they stay in the processor's cache
_STILL = 0.02  # pixels: after a shorter step, a patch is not moved again
_NOISE = 1.0  # grey levels, added to the contrast of a patch
_FLAT = np.sqrt(2) * _NOISE  # contrast, noise included, of a patch whose contrast equals the noise
_RIDGE = 1e-6  # on shifts, towards zero
_STIFFNESS = 0.02  # ridge on changes of the affinity: fewer patches diverge
_CHANGE = 2.0  # largest factor by which an affinity may stretch or shrink along any axis


@dataclass(frozen=True)
class LocalMatches:
    """Consistent matches: near points2[i], x maps to points1[i] + affinity[i] (x - points2[i])."""

    points1: np.ndarray  # (N, 2) float64, by the fitted affinity, pixels of image 1
    points2: np.ndarray  # (N, 2) float64, pixels of image 2
    affinity: np.ndarray  # (N, 2, 2) float64
    index: np.ndarray  # (N,) int, indices of the original matches

    def subset(self, kept: np.ndarray | slice) -> LocalMatches:
        return LocalMatches(
            self.points1[kept], self.points2[kept], self.affinity[kept], self.index[kept]
        )


def consistent(matches: Matches, neighbours: int) -> LocalMatches:
    """The matches that fit the affinity of their `neighbours` nearest matches in image 2."""
    points1 = matches.points1
    points2 = matches.points2
    finite = np.flatnonzero(np.isfinite(points1).all(1) & np.isfinite(points2).all(1))
    points1 = points1[finite]
    points2 = points2[finite]
    if len(points1) <= neighbours:
        return LocalMatches(points1[:0], points2[:0], np.zeros((0, 2, 2)), finite[:0])

    distance, index = nearest(points2, neighbours + 1)
    # All arrays have the axis of the matches last: NumPy is slow along short axes.
    near1, near2 = (np.take(points.T, index.T, axis=1) for points in (points1, points2))
    offsets = near2 - points2.T[:, None]
    design = np.concatenate([offsets, np.ones_like(offsets[:1])])  # (3, k + 1, N)

    tolerance = _TOLERANCE * matches.error_px
    reach = distance[:, -1] + tolerance
    distance1 = np.linalg.norm(near1 - np.median(near1, 1, keepdims=True), axis=0)
    weights = 1 / (1 + (distance1 / (3 * reach)) ** 2)
    # Ridge towards zero slope: keeps the fit finite for neighbours on a line or at one point.
    ridge = 1e-3 * (np.eye(3) * (1, 1, 0)) * tolerance**2

    for remaining in reversed(range(_ROUNDS)):
        weighted = design * weights
        normal = np.einsum("ikn,jkn->ijn", weighted, design).transpose(2, 0, 1) + ridge
        right = np.einsum("ikn,ckn->icn", weighted, near1).transpose(2, 0, 1)
        fit = np.ascontiguousarray(np.linalg.solve(normal, right).transpose(1, 2, 0))  # (3, 2, N)
        residual = np.linalg.norm((fit[:, :, None] * design[:, None]).sum(0) - near1, axis=0)
        weights = 1 / (1 + (residual / (tolerance * (1 + 2 * remaining))) ** 2) ** 2

    (xx, yx), (xy, yy), fitted = fit
    # Half the sum and half the difference of the singular values; middle - half < 0 if mirrored.
    middle = np.hypot(xx + yy, yx - xy) / 2
    half = np.hypot(xx - yy, yx + xy) / 2
    kept = (
        (np.linalg.norm(fitted - points1.T, axis=0) < 2 * tolerance)
        & ((residual < 2 * tolerance).sum(0) >= _LEAST_SUPPORT)
        & (middle - half > _STRETCH[0])  # no visible surface is mirrored
        & (middle + half < _STRETCH[1])
    )
    affinity = fit[:2, :, kept].transpose(2, 1, 0)
    return LocalMatches(fitted.T[kept], points2[kept], affinity, finite[kept])


@dataclass(frozen=True)
class Patches:
    """Patches of image 1 after alignment."""

    points1: np.ndarray  # (N, 2) float64, their centres, pixels of image 1
    affinity: np.ndarray  # (N, 2, 2) float64, maps offsets in image 2 to offsets in image 1
    # (N,) float64, correlation of both patches, -1 to 1; NaN (undefined) if either has no more
    # contrast than noise
    zncc: np.ndarray
    step: np.ndarray  # (N,) float64, length of the last step, pixels


def align_patches(
    grey1: np.ndarray,
    grey2: np.ndarray,
    matches: LocalMatches,
    radius: int,
    *,
    affine: bool = False,
) -> Patches:
    """The patches of image 1, aligned with patches of `radius` pixels around the points of image 2.

    grey: (H, W) float32. matches: points1 and affinity are the initial values. affine: adjust the
    affinity too; a patch whose affinity changes much gets a correlation of -1.
    """
    parts = in_threads(
        lambda part: _align(grey1, grey2, matches.subset(part), radius, affine),
        slices(len(matches.index), _CHUNK),
    )
    return Patches(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _align(
    grey1: np.ndarray, grey2: np.ndarray, matches: LocalMatches, radius: int, affine: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The arrays of `Patches`."""
    offsets, weights, patches, contrasts, gain = _template(grey2, matches.points2, radius, affine)
    most = min(_STEP, 0.4 * radius)  # below half the radius, a change of the affinity is invertible
    points1 = matches.points1.copy()
    affinity = matches.affinity.copy()
    zncc = np.zeros(len(points1))
    length = np.full(len(points1), np.inf)

    for _ in range(_AFFINE_ITERATIONS if affine else _ITERATIONS):
        moving = np.flatnonzero(length >= _STILL)
        if len(moving) == 0:
            break
        centres = points1[moving].astype(np.float32)
        # x and y separately: NumPy is slow along an axis of two.
        x, y = affinity[moving].transpose(1, 0, 2).astype(np.float32) @ offsets.T
        x += centres[:, :1]
        y += centres[:, 1:]

        patch, contrast = _standardised(bilinear_at(grey1, x, y), weights)
        expected = patches[moving]
        flat = np.minimum(contrast, contrasts[moving])[:, 0] < _FLAT
        zncc[moving] = np.where(flat, np.nan, (patch * expected) @ weights)
        step = (gain[moving] @ (patch - expected)[..., None])[..., 0]
        length[moving] = np.linalg.norm(step[:, :2], axis=1)
        if affine:
            length[moving] = np.maximum(length[moving], np.abs(step[:, 2:]).max(1))

        step *= np.minimum(1, most / np.maximum(length[moving], 1e-9))[:, None]
        # The template moved by `step` equals the patch, so the patch moves back by it.
        if affine:
            change = step[:, 2:].reshape(-1, 2, 2).transpose(0, 2, 1) / radius
            affinity[moving] = affinity[moving] @ np.linalg.inv(np.eye(2) + change)
        points1[moving] -= (affinity[moving] @ step[:, :2, None])[..., 0]

    if affine:
        zncc[~_alike(matches.affinity, affinity)] = -1
    return points1, affinity, zncc, length


def _template(
    grey: np.ndarray, points: np.ndarray, radius: int, affine: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Patches of image 2, and the linear maps from differences of a patch to motions.

    Returns the offsets (P, 2) of a patch's samples from its centre, pixels; their weights (P,), of
    sum 1; the patches (N, P), standardised; their contrasts (N, 1); and the gain (N, 2 or 6, P).
    The gain times a difference is the shift in pixels and, if affine, the columns of the change of
    the affinity times the radius.
    """
    axis = np.arange(-radius, radius + 1.0)
    halves = np.arange(-radius - 0.5, radius + 1.0)
    offsets = window_offsets(radius).astype(np.float32)
    weights = np.exp(-(offsets**2).sum(1) / (2 * (0.6 * radius) ** 2))
    weights /= weights.sum()

    patches, contrast = _standardised(_window(grey, points, axis, axis), weights)
    across = _window(grey, points, halves, axis)
    down = _window(grey, points, axis, halves)
    slopes = (
        np.diff(across.reshape(-1, len(axis), len(halves)), axis=2),
        np.diff(down.reshape(-1, len(halves), len(axis)), axis=1),
    )
    jacobian = np.stack(slopes, 1).reshape(-1, 2, len(offsets)) / contrast[..., None]

    ridge = np.full(2, _RIDGE)
    if affine:
        x, y = offsets.T / np.float32(radius)
        jacobian = np.concatenate([jacobian, jacobian * x, jacobian * y], 1)
        ridge = np.append(ridge, np.full(4, _STIFFNESS))
        # Remove what gain and offset explain: an enlargement can resemble a gain.
        jacobian -= (jacobian @ weights)[..., None]
        jacobian -= ((jacobian * patches[:, None]) @ weights)[..., None] * patches[:, None]

    weighted = jacobian * weights
    hessian = weighted @ jacobian.transpose(0, 2, 1) + np.diag(ridge)
    gain = np.linalg.inv(hessian).astype(np.float32) @ weighted
    return offsets, weights, patches, contrast, gain


def _alike(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Which affinities (N, 2, 2) differ by a stretch of less than `_CHANGE` along every axis."""
    change = np.linalg.inv(first) @ second
    stretch = np.linalg.svd(change, compute_uv=False)
    little = np.all((stretch < _CHANGE) & (stretch > 1 / _CHANGE), axis=1)
    return little & (np.linalg.det(change) > 0)


def _window(grey: np.ndarray, points: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Values (N, Y * X) of an image around points (N, 2), at offsets x (X,) for each of y (Y,)."""
    columns, rows = (offset.ravel() for offset in np.meshgrid(x, y))
    return bilinear_at(grey, points[:, :1] + columns, points[:, 1:] + rows)


def _standardised(patches: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Patches (N, P) with weighted mean 0 and standard deviation 1, and their deviations (N, 1).

    The deviation includes `_NOISE`, so that flat patches stay small and correlate with nothing.
    """
    patches = patches - (patches @ weights)[:, None]
    deviation = np.sqrt((patches**2 @ weights)[:, None] + _NOISE**2)
    return patches / deviation, deviation
