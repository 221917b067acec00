"""Matching and refinement on a pretended device: the CPU's matches, and no devices mixed."""

from copy import deepcopy

import dense_scene
import numpy as np
import pytest
import torch
from pretend_gpu import DEVICE, pretended_gpu

from dgc_pose.images.image import Image
from dgc_pose.matching import MatchingOptions, NetworkMatcher
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import load_network
from dgc_pose.runtime.torch_engine import TorchEngine

OPTIONS = MatchingOptions(aligned="features")


@pytest.fixture(scope="module")
def images() -> list[Image]:
    return [Image(pixels) for pixels in dense_scene.pictures()]


def _there(net: DGCNet) -> TorchEngine:
    """On the device, with inverse temperatures that the pretended tensors can take views of."""
    engine = TorchEngine(deepcopy(net).to(DEVICE))
    with torch.inference_mode():
        engine.net.correlation_scales = engine.net.get_buffer("correlation_scales").clone()
    return engine


def test_refinement_by_features_is_that_of_the_cpu(images: list[Image]) -> None:
    net = load_network("dgcm-lite0").eval()
    on_cpu = NetworkMatcher(TorchEngine(net), OPTIONS).match(*images).matches
    with pretended_gpu():
        on_device = NetworkMatcher(_there(net), OPTIONS).match(*images).matches
    assert len(on_device) == len(on_cpu) > 50
    np.testing.assert_allclose(on_device.points1, on_cpu.points1, atol=0.01)
