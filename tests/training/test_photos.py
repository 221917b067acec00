"""Photographs in memory: which are held back, and places in other light."""

import cv2
import numpy as np
import pytest
import torch

from dgc_pose.errors import ImageError
from dgc_pose.training.draw import Draw
from dgc_pose.training.photos import load_held_back, load_photos


@pytest.fixture
def folder(tmp_path):
    rng, folder = np.random.default_rng(0), tmp_path / "photos"
    folder.mkdir()
    for index in range(60):
        pixels = rng.integers(0, 255, (20, 30, 3), dtype=np.uint8)
        cv2.imwrite(str(folder / f"p{index:03d}.png"), pixels)
    return folder


def test_the_name_alone_decides_who_validates(folder):
    (folder / "broken.jpg").write_bytes(b"no photograph")
    training, held_back = load_photos(folder)
    assert training.single + held_back.single == 60 and 1 <= held_back.single < 12
    assert torch.equal(training.bank.texels, load_photos(folder)[0].bank.texels)
    assert torch.equal(load_held_back(folder).bank.texels, held_back.bank.texels)
    assert load_held_back(folder, side=10).bank.size(torch.tensor(0)).tolist() == [15, 10]


def test_places_give_two_of_their_photographs(folder, tmp_path):
    for place, count in enumerate((2, 3)):
        (tmp_path / "light" / str(place)).mkdir(parents=True)
        for k in range(count):
            pixels = np.full((20 + place, 30, 3), 50 * place + 10 * k + 5, np.uint8)
            cv2.imwrite(str(tmp_path / f"light/{place}/{k}.png"), pixels)
    photos, _ = load_photos(folder, tmp_path / "light")
    assert len(photos.bank.start) == photos.single + 5
    first, second = photos.places_drawn(200, Draw("cpu", 0))
    places = [(k >= photos.single + 2) for k in (first, second)]
    assert torch.equal(*places) and 60 < int(places[0].sum()) < 140
    assert len({*first.tolist()}) == len({*second.tolist()}) == 5 and (first != second).any()
    cv2.imwrite(str(tmp_path / "light/0/other.png"), np.zeros((8, 8, 3), np.uint8))
    with pytest.raises(ImageError, match="light/0: must hold two photographs of one size"):
        load_photos(folder, tmp_path / "light")


@pytest.mark.parametrize("count", range(2, 12))
def test_one_of_few_photographs_is_held_back_whatever_their_names(folder, count):
    for path in sorted(folder.glob("*.png"))[count:]:
        path.unlink()
    training, held_back = load_photos(folder)
    assert training.single + held_back.single == count and training.single and held_back.single
    assert torch.equal(load_held_back(folder).bank.texels, held_back.bank.texels)


def test_a_folder_without_any_is_named(folder):
    for path in folder.glob("*.png"):
        if path.name != "p000.png":
            path.unlink()
    with pytest.raises(ImageError, match="one trains and one is held back, and it holds 1"):
        load_held_back(folder)
