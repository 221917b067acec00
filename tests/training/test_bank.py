"""Images in one row, sampled at points: against OpenCV, and mirrored at the edges."""

import cv2
import numpy as np
import torch

from dgc_pose.training.photos import ImageBank


def _images() -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [rng.integers(0, 256, (h, w, 3), dtype=np.uint8) for h, w in ((20, 33), (31, 17))]


def test_samples_between_pixels_are_bilinear_ones_of_the_right_image():
    images, rng = _images(), np.random.default_rng(1)
    bank = ImageBank.of(images)
    assert len(bank.start) == 2 and bank.size(torch.tensor(1)).tolist() == [17, 31]
    for number, image in enumerate(images):
        points = (rng.random((50, 2)) * (image.shape[1] - 1, image.shape[0] - 1)).astype(np.float32)
        expected = cv2.remap(image.astype(np.float32), points[:, 0], points[:, 1], cv2.INTER_LINEAR)
        found = bank.sample(torch.tensor(number), torch.from_numpy(points), torch.ones(50))
        # OpenCV has 32 steps between two pixels.
        np.testing.assert_allclose(255 * found, expected.reshape(-1, 3), atol=8.5)
        assert np.abs(255 * found.numpy() - expected.reshape(-1, 3)).mean() < 1.5


def test_an_image_goes_on_as_its_mirror_image():
    bank = ImageBank.of(_images()[:1])
    inside = torch.tensor([[2.0, 3.0], [5.5, 1.0]])
    for outside in (
        torch.stack([-1 - inside[:, 0], inside[:, 1]], -1),
        inside + 2 * bank.size(torch.tensor(0)),
    ):
        samples = [bank.sample(torch.tensor(0), p, torch.ones(2)) for p in (inside, outside)]
        torch.testing.assert_close(samples[0], samples[1], atol=1e-4, rtol=0)


def test_wide_spacing_takes_the_mean_of_the_pixels():
    image = _images()[0][:, :32]
    bank = ImageBank.of([image])
    y, x = torch.meshgrid(torch.arange(5.0), torch.arange(8.0), indexing="ij")
    found = bank.sample(torch.tensor(0), 4 * torch.stack([x, y], -1) + 1.5, torch.tensor(4.0))
    expected = image.reshape(5, 4, 8, 4, 3).mean((1, 3))
    np.testing.assert_allclose(255 * found, expected, atol=1.5)
