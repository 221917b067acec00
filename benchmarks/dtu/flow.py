"""OpenCV's dense optical flow as a matcher: what stands beside a correspondence network."""

from __future__ import annotations

from typing import Literal, get_args

import cv2
import numpy as np

from dgc_pose.errors import InputError
from dgc_pose.image import Image
from dgc_pose.matching import CorrespondenceMap
from dgc_pose.matching.dense import resize

FlowName = Literal["dis", "farneback"]
FLOWS: tuple[FlowName, ...] = get_args(FlowName)
LONGEST_SIDE = 640  # of the images that the flow is computed on, pixels: larger ones are shrunk


class FlowMatcher:
    """DIS (Kroeger et al. 2016) or Farneback's flow (2003), from image 2's pixels into image 1."""

    def __init__(self, name: FlowName) -> None:
        if name not in FLOWS:
            raise InputError(f"a flow must be one of {', '.join(FLOWS)}, not '{name}'")
        self.name = name

    def correspond(self, image1: Image, image2: Image) -> CorrespondenceMap:
        """The map, over the pixels of image 2 or of its shrunk copy.

        Both images are brought to one size. Matchability is 1 where the flow back agrees, by
        `agreement`, and 0 elsewhere.
        """
        share = min(1.0, LONGEST_SIDE / max(image2.size))
        size = (max(round(share * image2.size[0]), 16), max(round(share * image2.size[1]), 16))
        grey1, grey2 = _grey(image1, size), _grey(image2, size)
        flow, back = self._flow(grey2, grey1), self._flow(grey1, grey2)
        return scaled_map(
            pixel_grid(size) + flow, agreement(flow, back), image1.size, image2.size
        )

    def _flow(self, of: np.ndarray, to: np.ndarray) -> np.ndarray:
        """Flow (H, W, 2) float32 on the pixels of the first image (H, W) uint8."""
        start = np.zeros((*of.shape, 2), np.float32)
        if self.name == "dis":
            dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
            return np.asarray(dis.calc(of, to, start))
        # The settings of OpenCV's own sample, with as many levels as leave 32 pixels a side.
        levels = max(1, int(np.log2(max(of.shape) / 32)))
        flow = cv2.calcOpticalFlowFarneback(
            of,
            to,
            start,
            pyr_scale=0.5,
            levels=levels,
            winsize=15,
            iterations=3,
            poly_n=5,
            poly_sigma=1.2,
            flags=0,
        )
        return np.asarray(flow)


def agreement(flow: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Where a flow (H, W, 2) and the flow back at its ends cancel: (H, W) float32, 1 or 0.

    |f + b|^2 < 0.01 (|f|^2 + |b|^2) + 0.5, in pixels (Sundaram et al. 2010, equation 5); 0 where
    the flow leaves the image.
    """
    height, width = flow.shape[:2]
    ends = (pixel_grid((width, height)) + flow).astype(np.float32)
    returned = cv2.remap(
        back.astype(np.float32),
        ends[..., 0],
        ends[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    off = ((flow + returned) ** 2).sum(-1)
    agrees = off < 0.01 * ((flow**2).sum(-1) + (returned**2).sum(-1)) + 0.5
    inside = ((ends >= -0.5) & (ends <= np.array([width, height]) - 0.5)).all(-1)
    return (agrees & inside).astype(np.float32)


def scaled_map(
    places: np.ndarray,
    matchability: np.ndarray,
    size1: tuple[int, int],
    size2: tuple[int, int],
) -> CorrespondenceMap:
    """A map over both images at one size, for images of sizes 1 and 2, by the half-pixel rule.

    places: (H, W, 2) pixels of image 1 at W x H, on the pixels of image 2 at W x H.
    """
    height, width = places.shape[:2]
    grid = pixel_grid((width, height))
    scale1, scale2 = np.divide(size1, (width, height)), np.divide(size2, (width, height))
    return CorrespondenceMap(
        map=((places + 0.5) * scale1 - 0.5).astype(np.float32),
        grid=((grid + 0.5) * scale2 - 0.5).astype(np.float32),
        matchability=np.asarray(matchability, dtype=np.float32),
        size1=size1,
        size2=size2,
    )


def pixel_grid(size: tuple[int, int]) -> np.ndarray:
    """The pixels (H, W, 2) float64 of an image of size (width, height): x and y of each."""
    x, y = np.meshgrid(np.arange(size[0], dtype=np.float64), np.arange(size[1], dtype=np.float64))
    return np.stack([x, y], -1)


def _grey(image: Image, size: tuple[int, int]) -> np.ndarray:
    return cv2.cvtColor(resize(image.pixels, size), cv2.COLOR_RGB2GRAY)
