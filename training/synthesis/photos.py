"""Photographs, decoded once and kept in memory."""

from __future__ import annotations

import hashlib
import logging
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from dgc_pose.errors import ImageError
from dgc_pose.images.folder import search_images
from dgc_pose.images.image import load_image
from dgc_pose.training.synthesis.render.bank import TextureBank

SIDE = 288  # pixels; photographs are kept as squares, as the network squares its input
_log = logging.getLogger(__name__)
_HELD_BACK = 20  # one photograph in so many is held back for validation


@dataclass(frozen=True)
class Photos:
    """Photographs in memory: pixels for the warps, textures for the ray-caster."""

    pixels: Tensor  # (N, 3, side, side) uint8, RGB
    textures: TextureBank

    @classmethod
    def of(cls, pixels: Tensor) -> Photos:
        return cls(pixels, TextureBank.from_photos(pixels))

    def to(self, device: torch.device | str) -> Photos:
        return Photos(self.pixels.to(device), self.textures.to(torch.device(device)))


def load_photos(
    root: str | Path, side: int = SIDE, limit: int | None = None
) -> tuple[Photos, Photos]:
    """All photographs below a folder, squared: those that train, and those held back.

    A photograph's name alone decides whether it is held back: one that validates a run never
    trains another. Raises ImageError if the folder holds none.
    """
    training, held_back = _split(root, limit)
    count = len(training) + len(held_back)
    lacking = f"{root}: {count} photographs; training needs dozens at least"
    return _decode(training, side, lacking), _decode(held_back, side, lacking)


def load_held_back(root: str | Path, side: int = SIDE) -> Photos:
    """The photographs that `load_photos` holds back, without decoding the others.

    Raises ImageError if there is none.
    """
    training, held_back = _split(root)
    count = len(training) + len(held_back)
    lacking = f"{root}: {count} photographs, none of them held back: take dozens at least"
    return _decode(held_back, side, lacking)


def resized_planes(pixels: np.ndarray, size: tuple[int, int]) -> Tensor:
    """Pixels (h, w, 3) uint8 resized to (width, height), as planes (3, height, width)."""
    shrinks = pixels.shape[1] >= size[0] and pixels.shape[0] >= size[1]
    interpolation = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    resized = cv2.resize(pixels, size, interpolation=interpolation)
    return torch.from_numpy(np.ascontiguousarray(resized.transpose(2, 0, 1)))


def _split(root: str | Path, limit: int | None = None) -> tuple[list[Path], list[Path]]:
    """The first `limit` photographs below a folder, sorted: those that train, those held back."""
    content = search_images(root)
    for line in content.left_out:
        _log.warning("%s: %s", root, line)
    parts: tuple[list[Path], list[Path]] = [], []
    for path in sorted(Path(root, name) for name in content.names)[:limit]:
        digest = hashlib.sha256(path.name.encode()).hexdigest()[:8]
        parts[int(digest, 16) % _HELD_BACK == 0].append(path)
    return parts


def _decode(paths: list[Path], side: int, lacking: str) -> Photos:
    squares: list[Tensor] = []
    damaged: list[ImageError] = []  # one in thousands is no reason to stop
    for path in tqdm(paths, desc="photographs", unit="", disable=None, leave=False):
        try:
            pixels = load_image(path, upright=True).pixels
        except ImageError as error:
            damaged.append(error)
            continue
        squares.append(resized_planes(pixels, (side, side)))
    if damaged:
        _log.warning("%d of %d photographs are left out: %s", len(damaged), len(paths), damaged[0])
    if not squares:
        raise ImageError(lacking)
    return Photos.of(torch.stack(squares))
