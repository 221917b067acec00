"""Matches by optical flow between image 2 and image 1 warped by the dense map.

Optical flow is accurate for small motion and fails for large motion; the warp removes the large
part. The rest is found by dense inverse search (Kroeger et al., ECCV 2016; OpenCV's DIS), and the
two are composed.
"""

from __future__ import annotations

import cv2
import numpy as np

from dgc_pose.geometry.pixels import pixel_grid, rescale
from dgc_pose.geometry.sampling import bilinear
from dgc_pose.images.image import Image, resize_by
from dgc_pose.matches import Matches
from dgc_pose.matching.matcher import CorrespondenceMap
from dgc_pose.matching.selection import even_subsample
from dgc_pose.refinement.guide import points_in_image1
from dgc_pose.refinement.options import FlowOptions

ERROR_PX = 0.5  # of a match along one axis, pixels of the resized image 2
_CYCLE_PX = 1.0  # largest cycle error, pixels of the resized image 2
_LEAST_SIDE = 16  # pixels; OpenCV's flow takes no smaller image


class FlowMatches:
    """Pixels of image 2, evenly spread, and their points by map and flow (a `MatchSource`)."""

    def __init__(self, options: FlowOptions | None = None) -> None:
        self.options = options or FlowOptions()

    def find(
        self, image1: Image, image2: Image, correspondence_map: CorrespondenceMap, matches: Matches
    ) -> Matches:
        """Matches wherever the map is matchable and the forward and backward flow agree.

        The confidence is the matchability. Images larger than `long_side` are shrunk to it.
        """
        scale = min(1.0, self.options.long_side / max(image1.size + image2.size))
        first, second = (
            cv2.cvtColor(resize_by(image.pixels, scale), cv2.COLOR_RGB2GRAY)
            for image in (image1, image2)
        )
        if min(first.shape + second.shape) < _LEAST_SIDE:
            return Matches(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), ERROR_PX)
        height, width = second.shape
        small1, small2 = first.shape[::-1], (width, height)
        grid = pixel_grid(small2).astype(np.float32)
        points2 = rescale(grid, small2, image2.size)
        mapped = points_in_image1(correspondence_map, points2.reshape(-1, 2)).reshape(grid.shape)
        mapped = rescale(mapped, image1.size, small1).astype(np.float32)
        warped = bilinear(first, mapped)
        flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        forward, backward = (
            flow.calc(one, other, np.zeros((height, width, 2), np.float32))
            for one, other in ((second, warped), (warped, second))
        )
        moved = grid + forward
        cycle = np.linalg.norm(forward + bilinear(backward, moved), axis=-1)
        matchability = cv2.resize(correspondence_map.matchability, small2)
        keep = (cycle <= _CYCLE_PX) & (matchability >= self.options.matchability)
        keep &= (moved >= 0).all(-1) & (moved <= (width - 1, height - 1)).all(-1)
        keep = even_subsample(keep, matchability, self.options.max_matches)
        points1 = rescale(bilinear(mapped, moved)[keep], small1, image1.size)
        inside = (points1 >= -0.5).all(-1) & (points1 <= np.array(image1.size) - 0.5).all(-1)
        return Matches(
            points1[inside],
            points2[keep][inside],
            matchability[keep][inside],
            error_px=ERROR_PX / scale,
        )
