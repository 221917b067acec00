"""How the pairs of a plan are made from the pairs of a list.

A kind of pairs is a function of `LIST_KINDS`, of the list, the number of the pair and the numbers
that are drawn for it. A pair without a true pose has t None.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Literal, get_args

import cv2
import numpy as np

from dgc_pose.benchmarks.posed_pairs import ListedPairs, PosedPair
from dgc_pose.cameras.camera import Camera
from dgc_pose.images.image import Image, resize
from dgc_pose.mirror import mirror_image

Alteration = Literal["swapped", "enlarged", "bordered", "turned", "darkened"]
ALTERATIONS: tuple[Alteration, ...] = get_args(Alteration)
_SCALE = 1.5
_BORDER = 0.1  # over the longer side
_GAMMA = 1.8
_TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # to the axes of an image turned clockwise
_WRONG = (1.1, 1.6)  # factors of a wrong f, or their inverses
_WRONG_TURN = (1.03, 1.4)  # the same if the camera only turned
_SHOWN = 0.6  # share of a photograph's width and height that a turned camera shows
_ROLL = 0.05  # radians, of a turned camera, standard deviation
_TILT = 0.5  # radians, largest of a board about each axis
_AWAY = (0.7, 1.2)  # distance of a board, over that at which it is as wide as the image
_WALL = 150  # grey level around a board
_NOISE = 2.0  # grey levels, of a view


def _wrong_k(listed: ListedPairs, number: int, rng: np.random.Generator) -> PosedPair:
    """A pair whose K states a wrong focal length: of one camera, or every second one of both."""
    pair = listed.pair(number)
    factor = _wrong_factor(rng, _WRONG)
    camera2 = pair.camera2.with_focal(factor * pair.camera2.focal)
    if number % 2 == 0:
        return replace(pair, camera2=camera2)
    camera1 = pair.camera1.with_focal(factor * pair.camera1.focal)
    return replace(pair, camera1=camera1, camera2=camera2)


def _turned(listed: ListedPairs, number: int, rng: np.random.Generator) -> PosedPair:
    """Two views of image 1 by a camera that only turns, half of them with a wrong K."""
    pair = listed.pair(number)
    size = pair.image1.size
    K = pair.camera1.K
    view_K = K * [[1 / _SHOWN], [1 / _SHOWN], [1]]
    view_K[:2, 2] = (np.array(size) - 1) / 2
    # To opposite sides, so far that both views stay inside of image 1, more or less.
    direction = rng.uniform(0, 2 * np.pi)
    reach = (1 - _SHOWN) / 2 * rng.uniform(0.3, 0.9) * np.array(size)
    aside = reach * (np.cos(direction), np.sin(direction)) / K[[0, 1], [0, 1]]

    def view(x: float, y: float) -> tuple[Image, np.ndarray]:
        R = cv2.Rodrigues(np.array([y, -x, _ROLL * rng.standard_normal()]))[0]
        H = view_K @ R @ np.linalg.inv(K)
        pixels = cv2.warpPerspective(
            pair.image1.pixels, H, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101
        )
        return _photographed(pixels, rng), R

    image1, R1 = view(*aside)
    image2, R2 = view(*-aside)
    camera = Camera(view_K, size)
    if number % 2:
        camera = camera.with_focal(_wrong_factor(rng, _WRONG_TURN) * camera.focal)
    return PosedPair(image1, image2, camera, camera, R2 @ R1.T, None)


def _mirrored(listed: ListedPairs, number: int, rng: np.random.Generator) -> PosedPair:
    """A pair whose image 2 is mirrored left to right."""
    pair = listed.pair(number)
    image2, camera2 = mirror_image(pair.image2, pair.camera2, 1)
    return replace(pair, image2=image2, camera2=camera2, R=None, t=None)


def _board(listed: ListedPairs, number: int, rng: np.random.Generator) -> PosedPair:
    """Image 2 of another pair as a flat board that fills most of both views: before a blank wall,
    for a camera that moved, or itself moved before a still camera, which sees image 1 behind it."""
    pair = listed.pair(number)
    is_still = number % 2 == 1
    size = pair.image1.size
    camera = replace(pair.camera1, size=size)
    picture = listed.pair(int(rng.integers(len(listed.pairs)))).image2.pixels
    behind = pair.image1.pixels if is_still else np.full_like(pair.image1.pixels, _WALL)
    height, width = picture.shape[:2]
    # The board is 1 wide, and the pixels of the picture are points of z = 0.
    to_board = np.array([[1, 0, (1 - width) / 2], [0, 1, (1 - height) / 2], [0, 0, width]]) / width

    def view() -> tuple[Image, np.ndarray, np.ndarray]:
        R = cv2.Rodrigues(rng.uniform(-_TILT, _TILT, 3) * (1, 1, 0.3))[0]
        away = rng.uniform(*_AWAY) * camera.K[0, 0] / size[0]
        t = away * np.append(rng.uniform(-0.1, 0.1, 2), 1.0)
        H = camera.K @ np.column_stack([R[:, :2], t]) @ to_board
        seen = cv2.warpPerspective(picture, H, size)
        on_board = cv2.warpPerspective(np.ones((height, width), np.float32), H, size)
        pixels = behind + on_board[..., None] * (seen.astype(np.float32) - behind)
        return _photographed(pixels, rng), R, t

    image1, R1, t1 = view()
    image2, R2, t2 = view()
    if is_still:
        return PosedPair(image1, image2, camera, camera, np.eye(3), None)
    R = R2 @ R1.T
    return PosedPair(image1, image2, camera, camera, R, t2 - R @ t1)


def _wrong_factor(rng: np.random.Generator, factors: tuple[float, float]) -> float:
    factor = float(np.exp(rng.uniform(*np.log(factors))))
    return factor if rng.random() < 0.5 else 1 / factor


def _photographed(pixels: np.ndarray, rng: np.random.Generator) -> Image:
    """A view with another exposure and noise than the photograph that it is made from."""
    light = rng.uniform(0.85, 1.15) * pixels + _NOISE * rng.standard_normal(pixels.shape)
    return Image(light.clip(0, 255).round().astype(np.uint8))


def altered(pair: PosedPair, way: Alteration) -> PosedPair:
    """The pair with image 2 first or changed, with the true cameras and pose of the result."""
    pixels = pair.image2.pixels
    assert pair.R is not None and pair.t is not None
    K = pair.camera2.K.copy()
    R = pair.R
    t = pair.t
    height, width = pixels.shape[:2]
    if way == "swapped":
        return PosedPair(pair.image2, pair.image1, pair.camera2, pair.camera1, R.T, -R.T @ t)
    if way == "enlarged":
        size = (round(_SCALE * width), round(_SCALE * height))
        K = replace(pair.camera2, size=(width, height)).resized(size).K
        pixels = resize(pixels, size)
    elif way == "bordered":
        sides = 4 * (round(_BORDER * max(width, height)),)
        K[:2, 2] += sides[0]
        pixels = cv2.copyMakeBorder(pixels, *sides, cv2.BORDER_CONSTANT, value=(128, 128, 128))
    elif way == "turned":
        K[:2] = [K[1, 1], 0, height - 1 - K[1, 2]], [0, K[0, 0], K[0, 2]]
        pixels = np.ascontiguousarray(np.rot90(pixels, -1))
        R = _TURN @ R
        t = _TURN @ t
    else:
        pixels = (255 * (pixels / 255) ** _GAMMA).round().astype(np.uint8)
    image2 = replace(pair.image2, pixels=pixels)
    camera2 = replace(pair.camera2, K=K, size=image2.size)
    return replace(pair, image2=image2, camera2=camera2, R=R, t=t)


def _pasted(listed: ListedPairs, number: int, rng: np.random.Generator) -> PosedPair:
    """A pair of two places that look alike in part: image 2 keeps an ellipse; the rest is its own
    mirror image (odd numbers) or image 1 of another pair (even numbers)."""
    pair = listed.pair(number)
    pixels = pair.image2.pixels
    height, width = size = pixels.shape[:2]
    if number % 2:
        other = np.roll(pixels[:, ::-1], rng.integers(width), 1)
    else:
        other = listed.pair(int(rng.integers(len(listed.pairs)))).image1.pixels
        factor = rng.uniform(1.0, 1.4) * max(np.divide(size, other.shape[:2]))
        other = resize(
            other, (math.ceil(factor * other.shape[1]), math.ceil(factor * other.shape[0]))
        )
    middle = rng.uniform(0.3, 0.7, 2) * (width, height)
    axes = rng.uniform(0.2, 0.42, 2) * (width, height)
    box = (middle.tolist(), (2 * axes).tolist(), float(rng.uniform(0, 180)))
    ellipse = cv2.ellipse(np.zeros(size, np.float32), box, 1.0, -1)
    mask = cv2.GaussianBlur(ellipse, (0, 0), 0.8)[..., None]
    pasted = mask * pixels + (1 - mask) * other[:height, :width]
    image2 = replace(pair.image2, pixels=pasted.round().astype(np.uint8))
    return replace(pair, image2=image2, R=None, t=None)


LIST_KINDS: Mapping[str, Callable[[ListedPairs, int, np.random.Generator], PosedPair]] = {
    "list": lambda listed, number, rng: listed.pair(number),
    "pasted": _pasted,
    "wrong_k": _wrong_k,
    "turned": _turned,
    "mirrored": _mirrored,
    "board": _board,
}
