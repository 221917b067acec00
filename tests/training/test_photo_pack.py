"""Photographs in one file: the same ones, nearly the same pixels, under the limit."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from dgc_pose.errors import ImageError, InputError
from dgc_pose.render.procedural import procedural_textures
from dgc_pose.training.photo_pack import load_photo_pack, pack_photos
from dgc_pose.training.photos import Photos


@pytest.fixture(scope="module")
def photos() -> tuple[Photos, Photos]:
    pixels = (255 * procedural_textures(40, 64, seed=5)).round().to(torch.uint8)
    return Photos.of(pixels[:34]), Photos.of(pixels[34:])


def test_packed_photographs_come_back(photos: tuple[Photos, Photos], tmp_path: Path) -> None:
    path = tmp_path / "p.safetensors"
    qualities = []
    for limit in (400_000, 60_000):
        qualities.append(pack_photos(photos, path, limit))
        assert path.stat().st_size <= limit
        for found, expected in zip(load_photo_pack(path), photos, strict=True):
            assert found.pixels.shape == expected.pixels.shape
            error = (found.pixels.float() - expected.pixels.float()).abs().mean((1, 2, 3))
            others = (found.pixels.float() - expected.pixels.roll(1, 0).float()).abs()
            assert (error < 0.5 * others.mean((1, 2, 3))).all()
    assert qualities[0] == 95 > qualities[1]
    assert len(load_photo_pack(path, limit=3)[0].pixels) == 3
    assert [p.name for p in tmp_path.iterdir()] == ["p.safetensors"]


def test_too_small_a_limit_and_other_files_are_refused(
    photos: tuple[Photos, Photos], tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=r"40 photographs need .* MiB at the least"):
        pack_photos(photos, tmp_path / "p", 10_000)
    assert not list(tmp_path.iterdir())
    (tmp_path / "p").write_bytes(b"no pack")
    with pytest.raises(ImageError, match="p: not a pack"):
        load_photo_pack(tmp_path / "p")
