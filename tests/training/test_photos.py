"""Photographs in memory: which are held back, places in other light, and samples of the bank,
against OpenCV and mirrored at the edges."""

import cv2
import numpy as np
import pytest
import torch
from textures import write_photos

from dgc_pose.errors import ImageError
from dgc_pose.training.draw import Draw
from dgc_pose.training.photos import ImageBank, load_held_back, load_photos


def _images() -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [rng.integers(0, 256, (h, w, 3), dtype=np.uint8) for h, w in ((20, 33), (31, 17))]


def test_samples_between_pixels_are_bilinear_ones_of_the_right_image():
    images, rng = _images(), np.random.default_rng(1)
    bank = ImageBank.of(images)
    assert bank.size(torch.tensor(1)).tolist() == [17, 31]
    for number, image in enumerate(images):
        points = (rng.random((50, 2)) * (image.shape[1] - 1, image.shape[0] - 1)).astype(np.float32)
        expected = cv2.remap(image.astype(np.float32), points[:, 0], points[:, 1], cv2.INTER_LINEAR)
        found = bank.sample(torch.tensor(number), torch.from_numpy(points), torch.ones(50))
        # OpenCV has 32 steps between two pixels.
        np.testing.assert_allclose(255 * found, expected.reshape(-1, 3), atol=8.5)
        assert np.abs(255 * found.numpy() - expected.reshape(-1, 3)).mean() < 1.5


def test_an_image_goes_on_as_its_mirror_image_and_wide_spacing_takes_means():
    bank, first = ImageBank.of(_images()[:1]), torch.tensor(0)
    inside = torch.tensor([[2.0, 3.0], [5.5, 1.0]])
    for outside in (
        inside * torch.tensor([-1, 1]) - torch.tensor([1, 0]),
        inside + 2 * bank.size(first),
    ):
        samples = [bank.sample(first, p, torch.ones(2)) for p in (inside, outside)]
        torch.testing.assert_close(*samples, atol=1e-4, rtol=0)
    image = _images()[0][:, :32]
    y, x = torch.meshgrid(torch.arange(5.0), torch.arange(8.0), indexing="ij")
    found = ImageBank.of([image]).sample(
        first, 4 * torch.stack([x, y], -1) + 1.5, torch.tensor(4.0)
    )
    np.testing.assert_allclose(255 * found, image.reshape(5, 4, 8, 4, 3).mean((1, 3)), atol=1.5)


@pytest.fixture
def folder(tmp_path):
    write_photos(tmp_path / "photos", 60)
    return tmp_path / "photos"


def test_a_photograph_is_held_back_by_its_name_and_one_of_few_always_is(folder):
    (folder / "broken.jpg").write_bytes(b"no photograph")
    training, held_back = load_photos(folder)
    assert training.single + held_back.single == 60 and 1 <= held_back.single < 12
    assert torch.equal(training.bank.texels, load_photos(folder)[0].bank.texels)
    assert torch.equal(load_held_back(folder).bank.texels, held_back.bank.texels)
    assert load_held_back(folder, side=10).bank.size(torch.tensor(0)).tolist() == [12, 10]
    paths = sorted(folder.glob("*.png"))
    for count in (11, 6, 3, 2):
        for path in paths[count:]:
            path.unlink(missing_ok=True)
        training, held_back = load_photos(folder)
        assert training.single + held_back.single == count
        assert training.single and held_back.single
    paths[1].unlink()
    with pytest.raises(ImageError, match="two photographs are needed, and it has 1"):
        load_held_back(folder)


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
    with pytest.raises(
        ImageError, match="light/0: needs at least two photographs, all of one size"
    ):
        load_photos(folder, tmp_path / "light")
