"""Photographs, decoded once and stored on the device in one tensor, sampled at any points."""

from __future__ import annotations

import hashlib
import logging
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from dgc_pose.errors import ImageError
from dgc_pose.images.folder import search_images
from dgc_pose.images.image import load_image, resize_by
from dgc_pose.training.draw import Draw

SIDE = 300  # pixels, largest length of the shorter side in memory
LEVELS = 4  # of the mip pyramid: the image, and three halvings
_log = logging.getLogger(__name__)
_SHARPNESS = 1.2  # factor of the spacing of samples that selects the mip level
_HELD_BACK = 20  # one photograph in 20 is held back for validation


@dataclass(frozen=True)
class ImageBank:
    """N images with their mip levels."""

    texels: Tensor  # (T,) int32, R + 2^8 G + 2^16 B
    start: Tensor  # (N, LEVELS) int64, the first texel of a level
    sizes: Tensor  # (N, LEVELS, 2) int64, width and height

    @classmethod
    def of(cls, images: Iterable[np.ndarray], device: torch.device | str = "cpu") -> ImageBank:
        """Make a bank of images (h, w, 3) uint8, RGB."""
        levels = []
        sizes = []
        for image in images:
            for _ in range(LEVELS):
                wide = image.astype(np.int32)
                levels.append((wide[..., 0] | wide[..., 1] << 8 | wide[..., 2] << 16).ravel())
                sizes.append(image.shape[1::-1])
                half = [max(1, (side + 1) // 2) for side in sizes[-1]]
                image = cv2.resize(image, half, interpolation=cv2.INTER_AREA)
        start = np.cumsum([0, *(len(level) for level in levels[:-1])]).reshape(-1, LEVELS)
        table = torch.tensor(sizes).view(-1, LEVELS, 2)
        parts = torch.from_numpy(np.concatenate(levels)), torch.from_numpy(start), table
        return cls(*(part.to(device) for part in parts))

    def size(self, image: Tensor) -> Tensor:
        """Width and height (..., 2) float of images (...) int64."""
        return self.sizes[image, 0].float()

    def sample(self, image: Tensor, points: Tensor, spacing: Tensor) -> Tensor:
        """Bilinear colours (..., 3) in [0, 1] at points (..., 2), pixels; mirrored at the edges.

        image: (...) int64; spacing: (...), pixels between two samples, which determine the mip
        level. Both broadcast with the points.
        """
        level = (_SHARPNESS * spacing).clamp(min=1).log2().long().clamp(max=LEVELS - 1)
        start = self.start[image, level]
        size = self.sizes[image, level]
        place = (points + 0.5) / self.sizes[image, 0]
        mirrored = 1 - (place.remainder(2) - 1).abs()  # on an endless row of mirrored copies
        inside = torch.minimum((mirrored * size - 0.5).clamp(min=0), size - 1)
        first = inside.long()
        u, v = (inside - first).unsqueeze(-2).unbind(-1)
        left, top = first.unbind(-1)
        right, bottom = torch.minimum(first + 1, size - 1).unbind(-1)
        upper = start + top * size[..., 0]
        lower = start + bottom * size[..., 0]
        above = torch.lerp(self._colours(upper + left), self._colours(upper + right), u)
        below = torch.lerp(self._colours(lower + left), self._colours(lower + right), u)
        return torch.lerp(above, below, v) / 255

    def view(self, image: Tensor, points: Tensor) -> Tensor:
        """Views (B, H, W, 3) of images (B,) at points (B, H, W, 2), pixels, which are about evenly
        spaced."""
        return self.sample(image[:, None, None], points, spacing(points))

    def _colours(self, index: Tensor) -> Tensor:
        """Unpacked texels (..., 3) float32 in [0, 255]."""
        packed = self.texels[index]
        return torch.stack([packed & 255, packed >> 8 & 255, packed >> 16], -1).float()


def spacing(points: Tensor) -> Tensor:
    """The mean distance (B, 1, 1) between neighbours in a grid of points (B, H, W, 2)."""
    steps = points[:, 1:, 1:] - points[:, :-1, :-1]
    return steps.norm(dim=-1).mean((1, 2))[:, None, None] / math.sqrt(2)


@dataclass(frozen=True)
class Photos:
    """Photographs on a device: single ones, then photographs of places in different light."""

    bank: ImageBank
    single: int  # number of single photographs, the first of the bank
    places: Tensor  # (P, 2) int64, a place's first photograph and number of photographs

    @classmethod
    def of(
        cls,
        images: Sequence[np.ndarray],
        places: Sequence[Sequence[np.ndarray]] = (),
        device: torch.device | str = "cpu",
    ) -> Photos:
        """From images (h, w, 3) uint8, RGB; the images of a place are aligned and have one size."""
        counts = torch.tensor([len(place) for place in places], dtype=torch.int64)
        first = len(images) + counts.cumsum(0) - counts
        every = [*images, *(image for place in places for image in place)]
        table = torch.stack([first, counts], 1).to(device)
        return cls(ImageBank.of(every, device), len(images), table)

    def places_drawn(self, count: int, draw: Draw) -> tuple[Tensor, Tensor]:
        """For each of `count` random places, two photographs, (B,) each."""
        first, photographs = self.places[draw.integers(count, count=len(self.places))].unbind(1)
        offsets = (draw.uniform(2, count) * photographs).long().minimum(photographs - 1)
        return first + offsets[0], first + offsets[1]


def load_photos(
    root: Path, light: Path | None = None, device: torch.device | str = "cpu"
) -> tuple[Photos, Photos]:
    """Load all photographs below a folder, resized: those for training, and those held back.

    light: a folder of folders for training, each with aligned photographs of one place in different
    light. Only a photograph's name decides whether it is held back, so that it never trains another
    run, unless the folder is so small that one of the two groups would be empty. Raises ImageError
    for fewer than two photographs, or if `light` or one of its folders has no place.
    """
    training, held_back = _split(root)
    folders = [] if light is None else sorted(path for path in light.iterdir() if path.is_dir())
    places = [_decoded(_images(folder), SIDE) for folder in folders]
    for folder, place in zip(folders, places, strict=True):
        if len(place) < 2 or len({image.shape for image in place}) > 1:
            raise ImageError(f"{folder}: needs at least two photographs, all of one size")
    if light is not None and not places:
        raise ImageError(f"{light}: needs a folder of photographs for each place, and has none")
    validating = Photos.of(_decoded(held_back, SIDE), device=device)
    return Photos.of(_decoded(training, SIDE), places, device), validating


def load_held_back(root: Path, side: int = SIDE) -> Photos:
    """Load only the photographs that `load_photos` holds back, with a shorter side of at most
    `side` pixels. Raises the errors of `load_photos`."""
    return Photos.of(_decoded(_split(root)[1], side))


def _split(root: Path) -> tuple[list[Path], list[Path]]:
    """The photographs below a folder, sorted: those for training, those held back."""
    numbers = {
        path: int(hashlib.sha256(path.name.encode()).hexdigest()[:8], 16) for path in _images(root)
    }
    if len(numbers) < 2:
        raise ImageError(f"{root}: two photographs are needed, and it has {len(numbers)}")
    ranked = sorted(numbers, key=lambda path: (numbers[path] % _HELD_BACK != 0, numbers[path]))
    count = sum(number % _HELD_BACK == 0 for number in numbers.values())
    count = min(max(1, count), len(ranked) - 1)  # of few names, none or all may be
    return sorted(ranked[count:]), sorted(ranked[:count])


def _images(root: Path) -> list[Path]:
    content = search_images(root)
    for line in content.skipped:
        _log.warning("%s: %s", root, line)
    for name, why in content.bad.items():
        _log.warning("%s: %s: %s", root, name, why)
    return sorted(root / name for name in content.names)


def _decoded(paths: list[Path], side: int) -> list[np.ndarray]:
    """Decode the readable images, resized. Raises ImageError if none is readable."""
    images = list[np.ndarray]()
    damaged = list[ImageError]()
    for path in tqdm(paths, desc="photographs", unit="", disable=None, leave=False):
        try:
            pixels = load_image(path).pixels
            images.append(resize_by(pixels, min(1.0, side / min(pixels.shape[:2]))))
        except ImageError as error:  # one damaged file of thousands does not stop the run
            damaged.append(error)
    if damaged and not images:
        raise damaged[0]
    if damaged:
        _log.warning("%d of %d photographs are skipped: %s", len(damaged), len(paths), damaged[0])
    return images
