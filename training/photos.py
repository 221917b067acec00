"""Photographs, decoded once and kept in memory."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from dgc_pose.errors import ImageError
from dgc_pose.images.folder import search_images
from dgc_pose.images.image import load_image, resize_by
from dgc_pose.training.bank import ImageBank
from dgc_pose.training.draw import Draw

SIDE = 300  # pixels of the shorter side in memory, at most
_log = logging.getLogger(__name__)
_HELD_BACK = 20  # one photograph in so many is held back for validation


@dataclass(frozen=True)
class Photos:
    """Photographs on a device: single ones, then those of places in other light."""

    bank: ImageBank
    single: int  # the first ones of the bank
    places: Tensor  # (P, 2) int64, the first photograph of a place and how many there are

    @classmethod
    def of(
        cls,
        images: Sequence[np.ndarray],
        places: Sequence[Sequence[np.ndarray]] = (),
        device: torch.device | str = "cpu",
    ) -> Photos:
        """Of images (h, w, 3) uint8, RGB; those of a place are aligned and of one size."""
        counts = torch.tensor([len(place) for place in places], dtype=torch.int64)
        first = len(images) + counts.cumsum(0) - counts
        every = [*images, *(image for place in places for image in place)]
        table = torch.stack([first, counts], 1).to(device)
        return cls(ImageBank.of(every, device), len(images), table)

    def places_drawn(self, count: int, draw: Draw) -> tuple[Tensor, Tensor]:
        """Two photographs (B,) each of one place."""
        first, photographs = self.places[draw.integers(count, count=len(self.places))].unbind(1)
        offsets = (draw.uniform(2, count) * photographs).long().minimum(photographs - 1)
        return first + offsets[0], first + offsets[1]


def load_photos(
    root: str | Path,
    light: str | Path | None = None,
    device: torch.device | str = "cpu",
) -> tuple[Photos, Photos]:
    """All photographs below a folder, made smaller: those that train, and those held back.

    light: a folder of folders, each with aligned photographs of one place in other light, which
    train. A photograph's name alone decides whether it is held back: one that validates a run never
    trains another, unless the folder is so small that this would leave none of either. Raises
    ImageError for fewer than two photographs, or if a folder holds no place.
    """
    training, held_back = _split(Path(root))
    places = [] if light is None else _places(Path(light))
    validating = Photos.of(_decoded(held_back, SIDE), device=device)
    return Photos.of(_decoded(training, SIDE), places, device), validating


def load_held_back(root: str | Path, side: int = SIDE) -> Photos:
    """The photographs that `load_photos` holds back, without decoding the others; the shorter side
    has `side` pixels at most. Raises as `load_photos` does."""
    return Photos.of(_decoded(_split(Path(root))[1], side))


def _split(root: Path) -> tuple[list[Path], list[Path]]:
    """The photographs below a folder, sorted: those that train, those held back."""
    numbers = {path: _number(path) for path in _images(root)}
    if len(numbers) < 2:
        raise ImageError(f"{root}: one trains and one is held back, and it holds {len(numbers)}")
    ranked = sorted(numbers, key=lambda path: (numbers[path] % _HELD_BACK != 0, numbers[path]))
    count = sum(number % _HELD_BACK == 0 for number in numbers.values())
    count = min(max(1, count), len(ranked) - 1)  # of a few names none may be, or all
    return sorted(ranked[count:]), sorted(ranked[:count])


def _number(path: Path) -> int:
    """A number by the name of a file, as if at random."""
    return int(hashlib.sha256(path.name.encode()).hexdigest()[:8], 16)


def _images(root: Path) -> list[Path]:
    content = search_images(root)
    for line in content.left_out:
        _log.warning("%s: %s", root, line)
    return sorted(root / name for name in content.names)


def _places(root: Path) -> list[list[np.ndarray]]:
    places = []
    for folder in sorted(path for path in root.iterdir() if path.is_dir()):
        places.append(_decoded(_images(folder), SIDE))
        if len(places[-1]) < 2 or len({image.shape for image in places[-1]}) > 1:
            raise ImageError(f"{folder}: must hold two photographs of one size and more")
    if not places:
        raise ImageError(f"{root}: holds no folders of photographs of one place")
    return places


def _decoded(paths: list[Path], side: int) -> list[np.ndarray]:
    """Those that can be read. Raises ImageError if none can."""
    images: list[np.ndarray] = []
    damaged: list[ImageError] = []  # one in thousands is no reason to stop
    for path in tqdm(paths, desc="photographs", unit="", disable=None, leave=False):
        try:
            pixels = load_image(path).pixels
        except ImageError as error:
            damaged.append(error)
            continue
        images.append(resize_by(pixels, min(1.0, side / min(pixels.shape[:2]))))
    if damaged and not images:
        raise damaged[0]
    if damaged:
        _log.warning("%d of %d photographs are left out: %s", len(damaged), len(paths), damaged[0])
    return images
