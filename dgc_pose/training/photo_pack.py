"""Photographs in one file, as squares of the training's size: small to carry, quick to load."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from dgc_pose.errors import ImageError, InputError
from dgc_pose.training.photos import Photos

_QUALITIES = range(95, 29, -5)  # of the JPEGs, from the best
_SAMPLE = 16  # one in so many photographs tells the size of all
_SLACK = 1.02  # by which a sample may be off


def pack_photos(photos: tuple[Photos, Photos], path: str | Path, limit_bytes: int) -> int:
    """Write those that train and those held back to one file; returns the JPEGs' quality.

    It is the best at which the file stays under `limit_bytes`. Raises InputError where none does.
    """
    pixels = torch.cat([p.pixels for p in photos])
    for quality in _QUALITIES:
        sample = pixels[::_SAMPLE]
        size = sum(map(len, _encoded(sample, quality))) / len(sample)
        if size * len(pixels) * _SLACK > limit_bytes:
            continue
        jpegs = _encoded(pixels, quality)
        ends = np.cumsum([len(jpeg) for jpeg in jpegs])
        content = save(
            {
                "jpegs": torch.from_numpy(np.concatenate(jpegs)),
                "ends": torch.from_numpy(ends),
                "held_back": torch.arange(len(pixels)) >= len(photos[0].pixels),
            }
        )
        if len(content) <= limit_bytes:
            temporary = Path(path).with_name(Path(path).name + ".part")
            temporary.write_bytes(content)
            os.replace(temporary, path)
            return quality
    least = size * len(pixels) / 2**20
    raise InputError(f"{len(pixels)} photographs need {least:.1f} MiB at the least")


def load_photo_pack(
    path: str | Path, limit: int | None = None, device: torch.device | str = "cpu"
) -> tuple[Photos, Photos]:
    """What `pack_photos` wrote, decoded: those that train, and those held back.

    limit: so many of those that train only. Raises ImageError where the file is not such a pack.
    """
    try:
        content = load(Path(path).read_bytes())
        jpegs, ends = content["jpegs"].numpy(), content["ends"].tolist()
        held_back = content["held_back"]
    except (SafetensorError, KeyError) as error:
        raise ImageError(f"{path}: not a pack of photographs") from error
    starts = [0, *ends[:-1]]
    with ThreadPoolExecutor() as pool:
        spans = zip(starts, ends, strict=True)
        squares = list(pool.map(lambda span: _decoded(jpegs[span[0] : span[1]]), spans))
    if any(square is None for square in squares) or held_back.all() or not held_back.any():
        raise ImageError(f"{path}: a pack of photographs that is damaged")
    pixels = torch.stack([square for square in squares if square is not None])
    sets = pixels[~held_back][:limit], pixels[held_back]
    return Photos.of(sets[0].to(device)), Photos.of(sets[1].to(device))


def _encoded(pixels: Tensor, quality: int) -> list[np.ndarray]:
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1]

    def encode(square: np.ndarray) -> np.ndarray:
        return cv2.imencode(".jpg", square.transpose(1, 2, 0)[..., ::-1], options)[1]

    with ThreadPoolExecutor() as pool:
        return list(pool.map(encode, pixels.cpu().numpy()))


def _decoded(jpeg: np.ndarray) -> Tensor | None:
    pixels = cv2.imdecode(jpeg, cv2.IMREAD_COLOR)
    if pixels is None:
        return None
    return torch.from_numpy(pixels[..., ::-1].transpose(2, 0, 1).copy())
