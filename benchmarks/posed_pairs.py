"""Data sets for the evaluation of poses: pairs of images with cameras and the true pose."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dgc_pose.cameras.by_image import checked_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import Pair
from dgc_pose.errors import ImageError
from dgc_pose.geometry.pixels import exif_turn
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.image import Image

if TYPE_CHECKING:
    from dgc_pose.training.room_pairs import RoomPairs

Ids = Mapping[str, str]


@dataclass(frozen=True, eq=False)
class Truth:
    """What is known of a pair: x2 = R x1 + t."""

    ids: Ids  # columns of the pair's rows
    camera1: Camera  # of the images as the methods see them
    camera2: Camera
    R: np.ndarray | None  # (3, 3); None for images of two scenes
    t: np.ndarray | None  # (3,), any length; None as well for a camera that only rotated


@dataclass(frozen=True, eq=False)
class PosedPair:
    """Two images, with what is known of them."""

    truth: Truth
    image1: Image
    image2: Image


class ListedPairs:
    """Pairs of image files. An image that was read recently is not read again."""

    def __init__(self, pairs: Sequence[Pair], *, size: tuple[int, int] | None = None) -> None:
        """size: (width, height) that the images are brought to; None leaves them as stored."""
        self.pairs = pairs
        self.ids = [{"image1": pair.name1, "image2": pair.name2} for pair in pairs]
        self._size = size
        self._images = ImageCache(2**29)

    def read(self, first: int = 0) -> Iterator[PosedPair]:
        """The pairs from number `first` on.

        Raises ImageError if an image cannot be read, InputError if a camera does not fit its image.
        """
        return (self.pair(number) for number in range(first, len(self.pairs)))

    def pair(self, number: int) -> PosedPair:
        """A pair by its number. Raises as `read` does."""
        pair = self.pairs[number]
        image1, camera1, turn1 = self._shown(pair.path1, pair.camera1)
        image2, camera2, turn2 = self._shown(pair.path2, pair.camera2)
        R, t = turn2 @ pair.R @ turn1.T, turn2 @ pair.t
        truth = Truth(self.ids[number], camera1, camera2, R, t)
        return PosedPair(truth, image1, image2)

    def _shown(self, path: Path, camera: Camera) -> tuple[Image, Camera, np.ndarray]:
        """An upright image and its camera, and the turn (3, 3) to its axes from those of a list,
        which is of the pixels as stored."""
        image, turn = self._images.read(Path(), str(path), size=self._size), np.eye(3)
        full = image.stored_size or image.size
        turn[:2, :2] = exif_turn(image.exif.orientation)
        stored = full if turn[0, 0] else full[::-1]
        checked_camera(camera, stored, f"K of {image.name}")
        if image.exif.orientation != 1:
            camera = camera.turned(turn[:2, :2], stored)
        if self._size is not None:
            camera = replace(camera, size=full).resized(self._size)
        return image, camera, turn


def posed_pair(views: RoomPairs, ids: Ids) -> PosedPair:
    """The first pair of a batch."""
    from dgc_pose.training.map_pairs import image_arrays

    image1, image2 = (
        Image(image_arrays(view[:1])[0]) for view in (views.maps.image1, views.maps.image2)
    )
    camera1 = Camera(views.source.K[0].double().numpy(), image1.size)
    camera2 = Camera(views.target.K[0].double().numpy(), image2.size)
    pose = views.target.seen_by(views.source).pose[0].double().numpy()
    return PosedPair(Truth(ids, camera1, camera2, pose[:, :3], pose[:, 3]), image1, image2)


def require_images(pairs: Sequence[Pair]) -> None:
    """Raise ImageError, with the path, if an image is missing: before the work, not within it."""
    for pair in pairs:
        for path in (pair.path1, pair.path2):
            if not path.is_file():
                raise ImageError(f"{path}: no such image; it is named in the pair list")
