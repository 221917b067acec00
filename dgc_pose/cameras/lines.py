"""Focal length from the lines of an image.

In built scenes, most lines run along three perpendicular directions (Coughlan and Yuille 1999).
Their vanishing points fit few focal lengths. The first direction comes from a point where many
lines meet. The two others have one degree of freedom: the angle around the first, which is searched
for each focal length of a grid (Lu et al., WACV 2017).
"""

from __future__ import annotations

import cv2
import numpy as np

from dgc_pose.cameras.camera import LOG_FOCALS
from dgc_pose.images.image import Image, resize_by

# Likelihood of a focal length with score s, for n segments: proportional to
# exp(SHARPNESS sqrt(n) (s - best s)), mixed with a share CHANCE of a uniform likelihood. Fitted by
# `dgc-pose fit-probability`.
SHARPNESS = 3.0
CHANCE = 0.03
_SIDE = 800  # longer side for the detection of segments, pixels
_MIN_LENGTH = 15.0  # of a segment, pixels
_MOST = 160  # segments: the longest are used
_LEAST = 8  # segments: fewer give no evidence
_WIDTH = 1.5  # largest distance of a segment's end from a line to its vanishing point, pixels
_PAIRS = 400  # pairs of segments; the lines of each meet in a candidate point
_POINTS = 8  # number of candidates kept
_COMMON = 0.6  # largest share of the lines of a candidate that a better one has too
_ANGLES = np.radians(np.arange(0.0, 90.0, 2.0))  # of the second direction around the first


def log_likelihoods(image: Image) -> np.ndarray:
    """The log-likelihood of each of `LOG_FOCALS` (G,), with the principal point in the middle. 0
    everywhere if the image has few segments or its pixels are not square."""
    if image.pixel_aspect != 1:
        return np.zeros(len(LOG_FOCALS))
    return calibrated(*focal_scores(image))


def calibrated(
    scores: np.ndarray, count: int, sharpness: float = SHARPNESS, chance: float = CHANCE
) -> np.ndarray:
    """The log-likelihoods (G,) from scores (G,) and the number of segments."""
    likelihood = np.exp(sharpness * np.sqrt(count) * (scores - scores.max()))
    mixed: np.ndarray = np.log((1 - chance) * likelihood / likelihood.mean() + chance)
    return mixed


def focal_scores(image: Image) -> tuple[np.ndarray, int]:
    """For each of `LOG_FOCALS`, the share of the segments' length that fits three perpendicular
    directions (G,); and the number of segments. Masked pixels have no segments."""
    ends = _segments(image)
    scores = np.zeros(len(LOG_FOCALS))
    if len(ends) < _LEAST:
        return scores, 0
    half = (ends[:, 1] - ends[:, 0]) / 2
    x, y = ends.mean(1).T
    length = np.linalg.norm(half, axis=1)
    share = (length / length.sum()).astype(np.float32)
    normals = np.column_stack([-half[:, 1], half[:, 0], half[:, 1] * x - half[:, 0] * y])
    ones = np.ones_like(x)
    squares = np.column_stack([ones, ones, x**2 + y**2, -2 * x, -2 * y])
    lines = normals.astype(np.float32), squares.astype(np.float32)
    points = _meeting_points(normals, lines, share)
    if not len(points):
        return scores, 0

    on_first = _agreement(points, *lines)
    side = min(max(image.size), _SIDE)
    cos = np.cos(_ANGLES)[:, None]
    sin = np.sin(_ANGLES)[:, None]
    for k, focal in enumerate(side * np.exp(LOG_FOCALS)):
        rays = points / (focal, focal, 1.0)
        across = np.linalg.svd(rays[:, None])[2][:, 1:, None]  # (P, 2, 1, 3)
        second = cos * across[:, 0] + sin * across[:, 1]
        third = cos * across[:, 1] - sin * across[:, 0]
        others = np.stack([second, third]).reshape(-1, 3) * (focal, focal, 1.0)
        on_others = _agreement(others, *lines).reshape(2, len(points), len(_ANGLES), -1).max(0)
        scores[k] = float((np.maximum(on_others, on_first[:, None]) @ share).max())
    return scores, len(ends)


def _segments(image: Image) -> np.ndarray:
    """The ends (N, 2, 2) of the longest segments, in pixels of the shrunk image from its middle."""
    scale = min(1.0, _SIDE / max(image.size))
    grey = resize_by(cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY), scale)
    found = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(grey)[0]
    ends = np.zeros((0, 2, 2)) if found is None else found.reshape(-1, 2, 2).astype(float)
    ends = ends[~image.is_masked((ends + 0.5) / scale - 0.5).any(1)]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    longest = np.argsort(-length, kind="stable")[:_MOST]
    ends = ends[longest[length[longest] >= _MIN_LENGTH]]
    middle: np.ndarray = (np.array(grey.shape[::-1]) - 1) / 2
    return ends - middle


def _agreement(points: np.ndarray, normals: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """How well each segment points to each of (P, 3) homogeneous pixels: max(1 - d^2, 0) (P, N). d
    is the distance of its end from the line through its middle and the point, over `_WIDTH`.

    normals: of the segments' lines (N, 3), scaled to half the length of the segment. squares:
    coefficients (N, 5) of the squared distance between the middle and the point.
    """
    points = (points / np.linalg.norm(points, axis=1, keepdims=True)).astype(np.float32)
    x, y, z = points.T
    away = np.column_stack([x * x, y * y, z * z, x * z, y * z]) @ squares.T
    distance = points @ normals.T
    distance *= distance
    distance /= np.maximum(away, np.float32(1e-12)) * np.float32(_WIDTH**2)
    np.subtract(1, distance, out=distance)
    return np.maximum(distance, 0, out=distance)


def _meeting_points(
    normals: np.ndarray, lines: tuple[np.ndarray, np.ndarray], share: np.ndarray
) -> np.ndarray:
    """Points (P, 3), homogeneous pixels, where the lines of most segments meet. Each shares at most
    `_COMMON` of its lines with any point before it."""
    by_length = share.astype(float) / share.sum(dtype=float)
    first, second = np.random.default_rng(0).choice(len(share), (2, _PAIRS), p=by_length)
    points = np.cross(normals[first], normals[second])
    points = points[np.linalg.norm(points, axis=1) > 1e-9]
    agreeing = _agreement(points, *lines) * share
    kept: list[int] = []
    for k in np.argsort(-agreeing.sum(1), kind="stable").tolist():
        most = _COMMON * agreeing[k].sum()
        if all(np.minimum(agreeing[k], agreeing[other]).sum() < most for other in kept):
            kept.append(k)
        if len(kept) == _POINTS:
            break
    return points[kept]
