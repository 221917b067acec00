"""CNNGeometric: its transformations against OpenCV and SciPy, its correlation against loops."""

import cv2
import numpy as np
import pytest
import torch
from procedural import procedural_textures
from scipy.interpolate import RBFInterpolator
from torch import Tensor

from dgc_pose.benchmarks.rivals.rocco import ENCODER, WEIGHTS, GeometricNet, load_rocco
from dgc_pose.network.config import preset
from dgc_pose.network.inference import for_inference
from dgc_pose.network.net import DGCNet
from dgc_pose.network.stored import read_tensors
from dgc_pose.network.weights import load_network, network_fingerprint
from dgc_pose.training.synthesis.spline import TPS_KNOTS

_AFFINE = np.array([[0.9, -0.2, 0.1], [0.15, 1.1, -0.05]])
_SPLINE = TPS_KNOTS.double().numpy() + 0.1 * np.random.default_rng(4).normal(size=(9, 2))


@pytest.fixture(scope="module")
def net() -> GeometricNet:
    torch.manual_seed(0)
    return GeometricNet(DGCNet(preset("dgcm-lite0"))).eval().requires_grad_(False)


def _constant(net: GeometricNet, affine: np.ndarray, spline: np.ndarray) -> GeometricNet:
    """A copy whose regressions give these numbers for every pair."""
    copy = for_inference(net)
    for regression, change in (
        (copy.affine, affine - np.eye(3)[:2]),
        (copy.spline, spline - TPS_KNOTS.numpy()),
    ):
        regression.final.weight.zero_()
        regression.final.bias.copy_(torch.from_numpy(change.ravel()))
    return copy


def _centres(size: int) -> np.ndarray:
    """Cells' centres (size, size, 2), -1 and +1 being the edges of the image."""
    axis = (2 * np.arange(size) + 1) / size - 1
    return np.stack(np.meshgrid(axis, axis), -1)


@pytest.mark.parametrize("size", [15, 60])
def test_a_map_is_the_affine_transformation_of_the_spline(net: GeometricNet, size: int) -> None:
    affine, spline = (torch.from_numpy(values)[None] for values in (_AFFINE, _SPLINE))
    points = _centres(size).reshape(-1, 2)
    bent = RBFInterpolator(TPS_KNOTS.double().numpy(), _SPLINE, kernel="thin_plate_spline")(points)
    for found, places in (
        (net.dense_map(affine, None, size), points),
        (net.dense_map(affine, spline, size), bent),
    ):
        expected = cv2.transform(places[None], _AFFINE)[0]
        np.testing.assert_allclose(found[0].flatten(1).T.numpy(), expected, atol=1e-9)


def test_the_source_is_warped_as_opencv_warps_it(
    net: GeometricNet, monkeypatch: pytest.MonkeyPatch
) -> None:
    image, seen = procedural_textures(1, 240, seed=2), []
    moved = _constant(net, _AFFINE, _SPLINE)

    def coarsest(warped: Tensor) -> Tensor:
        seen.append(warped)
        return torch.zeros(1, 128, 15, 15)

    monkeypatch.setattr(moved, "coarsest", coarsest)
    moved.transformations(image, torch.zeros_like(image))
    maps = (cv2.transform(_centres(240), _AFFINE) + 1) * 120 - 0.5
    x, y = np.moveaxis(maps.astype(np.float32), -1, 0)
    expected = cv2.remap(image[0].permute(1, 2, 0).numpy(), x, y, cv2.INTER_LINEAR)
    # OpenCV interpolates in steps of a 32nd of a pixel.
    assert np.abs(seen[-1][0].permute(1, 2, 0).numpy() - expected).mean() < 2e-3


def test_the_correlation_is_of_unit_length_and_not_negative(net: GeometricNet) -> None:
    rng = np.random.default_rng(5)
    source, target = (torch.from_numpy(rng.normal(size=(1, 7, 15, 15))) for _ in range(2))
    found = net.correlate(source, target)[0].numpy()
    assert found.shape == (225, 15, 15)
    for y, x in ((0, 0), (3, 11), (14, 7)):
        wanted = target[0, :, y, x].numpy()
        scores = np.zeros((15, 15))
        for ys in range(15):
            for xs in range(15):
                own = source[0, :, ys, xs].numpy()
                cosine = own @ wanted / np.linalg.norm(own) / np.linalg.norm(wanted)
                scores[xs, ys] = max(0.0, cosine)  # column by column
        np.testing.assert_allclose(
            found[:, y, x], scores.ravel() / np.linalg.norm(scores), atol=1e-5
        )


def test_the_weights_are_those_of_the_encoder_that_they_were_trained_on() -> None:
    net, (header, state) = load_rocco(), read_tensors(WEIGHTS, "pt")
    assert not net.training and not any(p.requires_grad for p in net.parameters())
    assert header[ENCODER] == network_fingerprint(load_network().pyramid)
    for key, value in net.state_dict().items():
        if key.startswith(("affine.", "spline.")) and not key.endswith("num_batches_tracked"):
            assert torch.equal(value, state.pop(key).float()), key
    assert state == {}
