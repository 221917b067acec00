"""A posed pair as people have it: swapped, resized, with a border, turned, darker."""

from dataclasses import replace
from typing import Literal, get_args

import cv2
import numpy as np

from dgc_pose.benchmarks.posed_pairs import PosedPair
from dgc_pose.images.image import resize

Alteration = Literal["swapped", "enlarged", "bordered", "turned", "darkened"]
ALTERATIONS: tuple[Alteration, ...] = get_args(Alteration)
_SCALE, _BORDER, _GAMMA = 1.5, 0.1, 1.8  # the border over the longer side
_TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # of the axes of an image turned clockwise


def altered(pair: PosedPair, way: Alteration) -> PosedPair:
    """The pair, whose poses are known, with image 2 first or changed; and what is true of it."""
    truth, pixels = pair.truth, pair.image2.pixels
    assert truth.R is not None and truth.t is not None
    K, R, t = truth.camera2.K.copy(), truth.R, truth.t
    height, width = pixels.shape[:2]
    if way == "swapped":
        truth = replace(truth, camera1=truth.camera2, camera2=truth.camera1, R=R.T, t=-R.T @ t)
        return PosedPair(truth, pair.image2, pair.image1)
    if way == "enlarged":
        size = (round(_SCALE * width), round(_SCALE * height))
        K = replace(truth.camera2, size=(width, height)).resized(size).K
        pixels = resize(pixels, size)
    elif way == "bordered":
        sides = 4 * (round(_BORDER * max(width, height)),)
        K[:2, 2] += sides[0]
        pixels = cv2.copyMakeBorder(pixels, *sides, cv2.BORDER_CONSTANT, value=(128, 128, 128))
    elif way == "turned":
        K[:2] = [K[1, 1], 0, height - 1 - K[1, 2]], [0, K[0, 0], K[0, 2]]
        pixels, R, t = np.ascontiguousarray(np.rot90(pixels, -1)), _TURN @ R, _TURN @ t
    else:
        pixels = (255 * (pixels / 255) ** _GAMMA).round().astype(np.uint8)
    image2 = replace(pair.image2, pixels=pixels)
    camera2 = replace(truth.camera2, K=K, size=image2.size)
    return PosedPair(replace(truth, camera2=camera2, R=R, t=t), pair.image1, image2)
