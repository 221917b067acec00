"""Alignment of whole images: image 1 warped by the dense map, the rest by optical flow.

Optical flow is exact for small motion and lost for large; the map takes the large one away. The
small one is found by dense inverse search (Kroeger et al., ECCV 2016; OpenCV's DIS), there and
back, and the two are composed.
"""

from __future__ import annotations

import cv2
import numpy as np

from dgc_pose.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.dense import resize
from dgc_pose.matching.matcher import CorrespondenceMap
from dgc_pose.matching.selection import even_subsample
from dgc_pose.refinement.guide import places_in_image1

ERROR_PX = 0.5  # of a match along one axis, in pixels of the resized image 2
_BACK_PX = 1.0  # of the resized image 2, that a pixel may come back off
_LEAST_SIDE = 16  # pixels; OpenCV's flow takes no smaller image


def match_flow(
    image1: Image,
    image2: Image,
    correspondences: CorrespondenceMap,
    *,
    matchability: float,
    long_side: int,
    max_matches: int,
) -> Matches:
    """Pixels of image 2, evenly spread, with the places that map and flow together name.

    Pixels count where the map has at least that matchability and the flow there and back agrees;
    the matchability is the confidence. Images larger than `long_side` are shrunk to it.
    """
    scale = min(1.0, long_side / max(image1.size + image2.size))
    first, second = (_shrunk(image.pixels, scale) for image in (image1, image2))
    height, width = second.shape
    if min(first.shape + second.shape) < _LEAST_SIDE:
        return Matches(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), ERROR_PX)
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).astype(np.float32)
    points2 = _resized(grid, (width, height), image2.size)
    there = places_in_image1(correspondences, points2.reshape(-1, 2)).reshape(grid.shape)
    places = _resized(there, image1.size, first.shape[::-1]).astype(np.float32)
    warped = _sampled(first, places)
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    forward, backward = (
        flow.calc(one, other, np.zeros((height, width, 2), np.float32))
        for one, other in ((second, warped), (warped, second))
    )
    moved = grid + forward
    returned = forward + _sampled(backward, moved)
    sure = cv2.resize(correspondences.matchability, (width, height))
    keep = (np.linalg.norm(returned, axis=-1) <= _BACK_PX) & (sure >= matchability)
    keep &= (moved >= 0).all(-1) & (moved <= (width - 1, height - 1)).all(-1)
    keep = even_subsample(keep, sure, max_matches)
    found = _sampled(places, moved)[keep]
    points1 = _resized(found, first.shape[::-1], image1.size)
    inside = (points1 >= -0.5).all(-1) & (points1 <= np.array(image1.size) - 0.5).all(-1)
    return Matches(
        points1[inside], points2[keep][inside], sure[keep][inside], error_px=ERROR_PX / scale
    )


def _sampled(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """An image at places (h, w, 2), bilinear, its edge repeated."""
    x, y = (np.ascontiguousarray(axis, np.float32) for axis in np.moveaxis(places, -1, 0))
    return cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _shrunk(pixels: np.ndarray, scale: float) -> np.ndarray:
    height, width = pixels.shape[:2]
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return cv2.cvtColor(resize(pixels, size), cv2.COLOR_RGB2GRAY)


def _resized(points: np.ndarray, size: tuple[int, int], other: tuple[int, int]) -> np.ndarray:
    """Places (..., 2) in an image of `size`, in the same image of another size; (w, h)."""
    return (points + 0.5) * np.divide(other, size) - 0.5
