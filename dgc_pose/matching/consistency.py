"""Matches that agree with their neighbours, and the affinity that they share.

A surface is locally affine. For each match, the affinity of its nearest matches in image 2 is
fitted by iteratively reweighted least squares; matches that do not fit are dropped. The affinity
also predicts the shape in image 1 of a patch of image 2, which alignment needs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgc_pose.geometry.sampling import nearest
from dgc_pose.matches import Matches

_ROUNDS = 4  # of reweighting, the tolerance shrinking from round to round
_TOLERANCE = 2.5  # residual in units of the matches' error at which the weight has fallen to 1/4
_LEAST_SUPPORT = 5  # of the matches fitted, within twice the tolerance, the match itself included
_STRETCH = (0.2, 5.0)  # least and largest singular value of a plausible affinity


@dataclass(frozen=True)
class LocalMatches:
    """Consistent matches: near points2[i], x goes to points1[i] + affinity[i] (x - points2[i])."""

    points1: np.ndarray  # (N, 2) float64, by the affinity fitted, pixels of image 1
    points2: np.ndarray  # (N, 2) float64, pixels of image 2
    affinity: np.ndarray  # (N, 2, 2) float64
    index: np.ndarray  # (N,) int, of the matches that they come from

    def subset(self, kept: np.ndarray | slice) -> LocalMatches:
        """Some of the matches. kept: (N,) bool, indices, or a slice."""
        return LocalMatches(
            self.points1[kept], self.points2[kept], self.affinity[kept], self.index[kept]
        )


def consistent(matches: Matches, neighbours: int) -> LocalMatches:
    """The matches that fit the affinity of their `neighbours` nearest in image 2."""
    points1, points2 = matches.points1, matches.points2
    finite = np.flatnonzero(np.isfinite(points1).all(1) & np.isfinite(points2).all(1))
    points1, points2 = points1[finite], points2[finite]
    if len(points1) <= neighbours:
        return LocalMatches(points1[:0], points2[:0], np.zeros((0, 2, 2)), finite[:0])
    distance, index = nearest(points2, neighbours + 1)
    # The matches last in all arrays: NumPy is slow along short axes.
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
    # Half the sum and half the difference of the singular values; this is negative if mirrored.
    middle, half = np.hypot(xx + yy, yx - xy) / 2, np.hypot(xx - yy, yx + xy) / 2
    kept = (
        (np.linalg.norm(fitted - points1.T, axis=0) < 2 * tolerance)
        & ((residual < 2 * tolerance).sum(0) >= _LEAST_SUPPORT)
        & (middle - half > _STRETCH[0])  # no visible surface is mirrored
        & (middle + half < _STRETCH[1])
    )
    affinity = fit[:2, :, kept].transpose(2, 1, 0)
    return LocalMatches(fitted.T[kept], points2[kept], affinity, finite[kept])
