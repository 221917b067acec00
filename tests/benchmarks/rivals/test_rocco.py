"""CNNGeometric: its transformations against OpenCV and SciPy, its correlation against loops."""

import cv2
import numpy as np
import pytest
import torch
from scipy.interpolate import RBFInterpolator

from dgc_pose.benchmarks.rivals.rocco import ENCODER, WEIGHTS, GeometricNet, load_rocco
from dgc_pose.benchmarks.spline import TPS_KNOTS
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.stored import read_tensors
from dgc_pose.network.weights import load_network, network_fingerprint

_AFFINE = np.array([[0.9, -0.2, 0.1], [0.15, 1.1, -0.05]])
_SPLINE = TPS_KNOTS.double().numpy() + 0.1 * np.random.default_rng(4).normal(size=(9, 2))


@pytest.fixture(scope="module")
def net() -> GeometricNet:
    torch.manual_seed(0)
    return GeometricNet(DGCNet(preset("dgcm-lite0"))).eval().requires_grad_(False)


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
