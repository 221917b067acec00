"""Matches that agree with their neighbours, and the affinity that they share.

A surface is locally affine. For each match, the affinity of its nearest matches in image 2 is
fitted by iteratively reweighted least squares; matches that do not fit are dropped. The affinity
also predicts the shape in image 1 of a patch of image 2, which alignment needs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgc_pose.geometry.neighbours import nearest
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


def consistent(matches: Matches, neighbours: int) -> LocalMatches:
    """The matches that fit the affinity of their `neighbours` nearest in image 2."""
    points1, points2 = matches.points1, matches.points2
    finite = np.flatnonzero(np.isfinite(points1).all(1) & np.isfinite(points2).all(1))
    points1, points2 = points1[finite], points2[finite]
    if len(points1) <= neighbours:
        return LocalMatches(points1[:0], points2[:0], np.zeros((0, 2, 2)), finite[:0])
    distance, index = nearest(points2, neighbours + 1)
    offsets = points2[index] - points2[:, None]
    design = np.concatenate([offsets, np.ones((*offsets.shape[:2], 1))], -1)  # (N, k + 1, 3)
    nearest1 = points1[index]
    tolerance = _TOLERANCE * matches.error_px
    reach = distance[:, -1:] + tolerance
    distance1 = np.linalg.norm(nearest1 - np.median(nearest1, 1, keepdims=True), axis=-1)
    weights = 1 / (1 + (distance1 / (3 * reach)) ** 2)
    # Ridge towards zero slope: keeps the fit finite for neighbours on a line or at one point.
    ridge = 1e-3 * (np.eye(3) * (1, 1, 0)) * tolerance**2
    for remaining in reversed(range(_ROUNDS)):
        weighted = (design * weights[..., None]).transpose(0, 2, 1)
        fit = np.linalg.solve(weighted @ design + ridge, weighted @ nearest1)  # (N, 3, 2)
        residual = np.linalg.norm(design @ fit - nearest1, axis=-1)
        weights = 1 / (1 + (residual / (tolerance * (1 + 2 * remaining))) ** 2) ** 2
    affinity = fit[:, :2].transpose(0, 2, 1)
    stretch = np.linalg.svd(affinity, compute_uv=False)
    kept = (
        (np.linalg.norm(fit[:, 2] - points1, axis=1) < 2 * tolerance)
        & ((residual < 2 * tolerance).sum(1) >= _LEAST_SUPPORT)
        & (stretch[:, 1] > _STRETCH[0])
        & (stretch[:, 0] < _STRETCH[1])
        & (np.linalg.det(affinity) > 0)  # no visible surface is mirrored
    )
    return LocalMatches(fit[kept, 2], points2[kept], affinity[kept], finite[kept])
