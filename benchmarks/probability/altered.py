"""A posed pair as people have it: swapped, resized, with a border, turned, darker."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from dgc_pose.benchmarks.posed_pairs import PosedPair
from dgc_pose.images.image import resize

_SCALE = 1.5
_BORDER = 0.1  # of the longer side
_GAMMA = 1.8
_TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # of the axes of an image turned clockwise


def altered(pair: PosedPair, number: int) -> PosedPair:
    """One of the alterations, by the number in turn."""
    return ALTERATIONS[number % len(ALTERATIONS)](pair)


def swapped(pair: PosedPair) -> PosedPair:
    """Image 2 first."""
    truth = pair.truth
    if truth.R is not None and truth.t is not None:
        truth = replace(truth, R=truth.R.T, t=-truth.R.T @ truth.t)
    truth = replace(truth, camera1=truth.camera2, camera2=truth.camera1)
    return PosedPair(truth, pair.image2, pair.image1)


def enlarged(pair: PosedPair) -> PosedPair:
    """Image 2 is larger by half."""
    image, camera = pair.image2, pair.truth.camera2
    size = (round(_SCALE * image.size[0]), round(_SCALE * image.size[1]))
    camera2 = replace(camera, size=image.size).resized(size)
    image2 = replace(image, pixels=resize(image.pixels, size))
    return PosedPair(replace(pair.truth, camera2=camera2), pair.image1, image2)


def bordered(pair: PosedPair) -> PosedPair:
    """Image 2 has a grey border."""
    image, camera = pair.image2, pair.truth.camera2
    width = round(_BORDER * max(image.size))
    sides, grey = 4 * (width,), (128, 128, 128)
    pixels = cv2.copyMakeBorder(image.pixels, *sides, cv2.BORDER_CONSTANT, value=grey)
    K = camera.K + width * np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])
    image2 = replace(image, pixels=pixels)
    camera2 = replace(camera, K=K, size=image2.size)
    return PosedPair(replace(pair.truth, camera2=camera2), pair.image1, image2)


def turned(pair: PosedPair) -> PosedPair:
    """Image 2 is turned clockwise by 90 degrees."""
    image, camera, truth = pair.image2, pair.truth.camera2, pair.truth
    K = camera.K.copy()
    K[0, 0], K[1, 1] = camera.K[1, 1], camera.K[0, 0]
    K[0, 2], K[1, 2] = image.size[1] - 1 - camera.K[1, 2], camera.K[0, 2]
    image2 = replace(image, pixels=np.ascontiguousarray(np.rot90(image.pixels, -1)))
    truth = replace(truth, camera2=replace(camera, K=K, size=image2.size))
    if truth.R is not None and truth.t is not None:
        truth = replace(truth, R=_TURN @ truth.R, t=_TURN @ truth.t)
    return PosedPair(truth, pair.image1, image2)


def darkened(pair: PosedPair) -> PosedPair:
    """Image 2 has another gamma."""
    table = (255 * (np.arange(256) / 255) ** _GAMMA).round().astype(np.uint8)
    image2 = replace(pair.image2, pixels=table[pair.image2.pixels])
    return PosedPair(pair.truth, pair.image1, image2)


ALTERATIONS: tuple[Callable[[PosedPair], PosedPair], ...] = (
    *(swapped, enlarged, bordered),
    *(turned, darkened),
)
