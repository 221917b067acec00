"""Pairs of images with cameras and the true pose, to evaluate poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dgc_pose.cameras.by_image import checked_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import Pair
from dgc_pose.errors import ImageError
from dgc_pose.geometry.pixels import exif_turn
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.image import Image


@dataclass(frozen=True, eq=False)
class PosedPair:
    """Two images, their cameras and the true pose: x2 = R x1 + t."""

    image1: Image
    image2: Image
    camera1: Camera  # of the image as the methods get it
    camera2: Camera
    R: np.ndarray | None  # (3, 3); None for images of two scenes
    t: np.ndarray | None  # (3,), any length; also None for a pure rotation


class ListedPairs:
    """Pairs of image files. A cache keeps images that were read recently."""

    def __init__(self, pairs: Sequence[Pair], *, size: tuple[int, int] | None = None) -> None:
        """size: (width, height) to resize the images to; None keeps their size.

        Raises ImageError, with the path, if any image is missing.
        """
        for pair in pairs:
            for path in (pair.path1, pair.path2):
                if not path.is_file():
                    raise ImageError(f"{path}: no such image; it is named in the pair list")
        self.pairs = pairs
        self._size = size
        self._images = ImageCache(2**29)

    def pair(self, number: int) -> PosedPair:
        """A pair by its number.

        Raises ImageError if an image cannot be read, InputError if a camera does not fit its image.
        """
        pair = self.pairs[number]
        image1, camera1, turn1 = self._shown(pair.path1, pair.camera1)
        image2, camera2, turn2 = self._shown(pair.path2, pair.camera2)
        R = turn2 @ pair.R @ turn1.T
        t = turn2 @ pair.t
        return PosedPair(image1, image2, camera1, camera2, R, t)

    def _shown(self, path: Path, camera: Camera) -> tuple[Image, Camera, np.ndarray]:
        """An upright image, its camera, and the rotation (3, 3) to its axes from the axes of the
        list, which describes the stored pixels."""
        image = self._images.read(Path(), str(path), size=self._size)
        turn = np.eye(3)
        full = image.stored_size or image.size
        turn[:2, :2] = exif_turn(image.exif.orientation)
        stored = full if turn[0, 0] else full[::-1]
        checked_camera(camera, stored, f"K of {image.name}")
        if image.exif.orientation != 1:
            camera = camera.turned(turn[:2, :2], stored)
        if self._size is not None:
            camera = replace(camera, size=full).resized(self._size)
        return image, camera, turn
