"""Pairs of a list with image 2 rolled, shrunk or cropped, as other cameras would have taken it.

A camera rolled about its optical axis, with another focal length and another window, sees an affine
copy of the picture, so that cameras and poses stay exact. Image 2 is `K' Rz K^-1` of its pixels.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from dgc_pose.benchmarks.posed_pairs import ListedPairs, PosedPair
from dgc_pose.benchmarks.scores import PairScore
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import Pair
from dgc_pose.images.image import Image, resize_by
from dgc_pose.system.options import check_options, option


@dataclass(frozen=True)
class ImageChange:
    """What image 2 is changed by. Raises InputError, naming the field, on a value out of range."""

    roll: float = option(  # counter-clockwise
        0.0, "Roll image 2 by so many degrees, on black.", metavar="DEG", min=-360, max=360
    )
    roll_at_random: bool = option(False, "Roll image 2 of each pair by 30 to 330 degrees.")
    shrink: float = option(1.0, "Make image 2 so many times smaller.", metavar="F", min=1, max=100)
    crop: float = option(1.0, "Keep the middle 1/F of image 2.", metavar="F", min=1, max=100)

    def __post_init__(self) -> None:
        check_options(self)

    def angles(self, count: int) -> list[float]:
        """Degrees of each of so many pairs."""
        if not self.roll_at_random:
            return [self.roll] * count
        return list(map(float, np.random.default_rng(0).uniform(30, 330, count)))


class ChangedPairs(ListedPairs):
    """The pairs of a list with image 2 changed; its name says how."""

    def __init__(
        self, pairs: Sequence[Pair], change: ImageChange, kind: type[PairScore] = PairScore
    ) -> None:
        super().__init__(pairs, kind)
        self.change = change
        self.angles = change.angles(len(pairs))
        self.ids = [
            {
                "image1": pair.name1,
                "image2": f"{pair.name2} roll {angle:.1f} / {change.shrink:g} x {change.crop:g}",
            }
            for pair, angle in zip(pairs, self.angles, strict=True)
        ]

    def pair(self, number: int) -> PosedPair:
        pair, change = super().pair(number), self.change
        image2, camera2, turn = changed_view(
            pair.image2, pair.truth.camera2, self.angles[number], change.shrink, change.crop
        )
        return PosedPair(pair.truth.turned(turn, camera2), pair.image1, image2)


def changed_view(
    image: Image, camera: Camera, angle_deg: float, shrink: float = 1.0, crop: float = 1.0
) -> tuple[Image, Camera, np.ndarray]:
    """An image rolled counter-clockwise, shrunk and cropped; its camera; and the rotation (3, 3)
    from the camera before to the camera after.

    The camera must be without lens distortion. Its new focal lengths are equal.
    """
    width, height = (max(1, round(side / crop)) for side in image.size)
    left, top = (image.size[0] - width) // 2, (image.size[1] - height) // 2
    pixels = image.pixels[top : top + height, left : left + width]
    K = camera.K - [[0, 0, left], [0, 0, top], [0, 0, 0]]
    if shrink > 1:
        pixels = resize_by(pixels, 1 / shrink)
        K = Camera(K, (width, height)).resized((pixels.shape[1], pixels.shape[0])).K
    height, width = pixels.shape[:2]
    radians = math.radians(angle_deg)
    cosine, sine = math.cos(radians), math.sin(radians)
    turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    if angle_deg % 360 == 0:
        return Image(np.ascontiguousarray(pixels)), Camera(K, (width, height)), turn
    focal = math.sqrt(K[0, 0] * K[1, 1])
    affine = np.diag([focal, focal, 1]) @ turn @ np.linalg.inv(K)
    edges = np.array([[x, y, 1] for x in (-0.5, width - 0.5) for y in (-0.5, height - 0.5)])
    corners = (edges @ affine.T)[:, :2]
    shift = -corners.min(0) - 0.5  # the outer edge of the first pixel is at -0.5
    size = (*(int(side) for side in np.ceil(np.ptp(corners, 0) - 1e-6)),)
    affine[:2, 2] += shift
    rolled = cv2.warpAffine(pixels, affine[:2], size, flags=cv2.INTER_LINEAR)
    K = np.array([[focal, 0, shift[0]], [0, focal, shift[1]], [0, 0, 1]])
    return Image(rolled), Camera(K, (size[0], size[1])), turn
