"""Matching and refinement on a device that pretends: the CPU's matches, and no devices mixed."""

from __future__ import annotations

from copy import deepcopy

import dense_scene
import numpy as np
import pytest
import torch
from pretend_gpu import DEVICE, pretended_gpu

from dgc_pose.image import Image
from dgc_pose.matching import DenseMatcher, MatchingOptions
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import load_network
from dgc_pose.refinement import RefinementOptions, Refiner


@pytest.fixture(scope="module")
def images() -> list[Image]:
    return [Image(pixels) for pixels in dense_scene.pictures()]


@pytest.mark.parametrize("name", ["dgcm-lite", "dgcm+flow"])
def test_the_map_made_there_is_the_map_made_here(images: list[Image], name: str) -> None:
    torch.manual_seed(0)
    net = DGCNet(preset(name)).eval()
    here = DenseMatcher(net, MatchingOptions()).correspond_batch([(images[0], images[1])])[0]
    with pretended_gpu():
        matcher = DenseMatcher(deepcopy(net).to(DEVICE), MatchingOptions())
        there = matcher.correspond_batch([(images[0], images[1])])[0]
    np.testing.assert_allclose(there.map, here.map, atol=0.05)
    np.testing.assert_allclose(there.matchability, here.matchability, atol=1e-3)


def test_refinement_by_features_is_the_same_there(
    images: list[Image], monkeypatch: pytest.MonkeyPatch
) -> None:
    # The pretended device knows no bfloat16.
    monkeypatch.setattr("dgc_pose.refinement.native.multiplies_bfloat16", lambda device: False)
    net = load_network("dgcm-lite").eval()
    options = RefinementOptions(source="features")
    here = Refiner(DenseMatcher(net, MatchingOptions()), options).match(*images)
    with pretended_gpu():
        there_net = deepcopy(net).to(DEVICE)
        there = Refiner(DenseMatcher(there_net, MatchingOptions()), options).match(*images)
    assert len(there) == len(here) > 50
    np.testing.assert_allclose(there.points1, here.points1, atol=0.01)
