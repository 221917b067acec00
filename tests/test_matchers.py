"""Matchers by name: what each gives, which runtime, what caches keep and fingerprints identify."""

import os
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import dense_scene
import numpy as np
import pytest
import torch

from dgc_pose import Camera, EstimationOptions, estimate_pose, load_matcher, matchers
from dgc_pose.cameras.camera import TwoViews
from dgc_pose.errors import InputError, WeightsError
from dgc_pose.images.cache import ImageCache
from dgc_pose.matchers import device_type, load_engine
from dgc_pose.matching import MatchingOptions, MatchResult, NetworkMatcher
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.training.run import save_weights

BARE = MatchingOptions(aligned="none")
FAST = EstimationOptions(runs=1, iterations=300)
IMAGES = dense_scene.images()
CAMERA = Camera(dense_scene.K, dense_scene.SIZE)


@pytest.fixture(scope="module")
def network() -> NetworkMatcher:
    matcher = load_matcher()
    assert isinstance(matcher, NetworkMatcher)
    return matcher


@pytest.fixture(scope="module")
def refined(network: NetworkMatcher) -> MatchResult:
    return network.match(*IMAGES)


def test_matches_state_the_weights_of_the_network_that_made_them(
    network: NetworkMatcher, refined: MatchResult
) -> None:
    """Those of each step, refined or not."""
    full = refined
    coarse = network.coarse(*IMAGES)
    assert coarse is not None
    poses = estimate_pose(full.matches, CAMERA, CAMERA, FAST).hypotheses
    views = [TwoViews(CAMERA, CAMERA, pose.R, pose.t) for pose in poses]
    steps = [full, coarse, network.refined(*IMAGES, coarse), network.guided(*IMAGES, full, views)]
    steps.append(load_matcher(matching=BARE).match(*IMAGES))
    assert all(step is not None and step.matches.weights == network.fingerprint for step in steps)
    assert load_matcher("sift").match(*IMAGES).matches.weights is None


@pytest.mark.parametrize("weights", ["shipped", None])
def test_only_the_shipped_network_s_matches_have_a_probability(
    refined: MatchResult, weights: str | None
) -> None:
    """It is fitted on them; without, the gates decide."""
    matches = refined.matches if weights else replace(refined.matches, weights=weights)
    pose = estimate_pose(matches, CAMERA, CAMERA, FAST, map_matches=refined.map_matches)
    assert pose.success and (pose.probability is None) == (weights is None)
    assert ("not known" in repr(pose)) == (weights is None)


@pytest.mark.parametrize(("name", "made"), [("sift", 4), ("dgcm-lite0", 6)])
def test_what_is_computed_of_an_image_is_kept(name: str, made: int) -> None:
    """Key points or features, and structure, of each; in a cache of any kind."""
    found = []
    for cache in (ImageCache(), None):
        matcher = load_matcher(name, cache=cache)
        found += [matcher.match(*IMAGES).matches.points1 for _ in range(2)]
        matcher.match(*IMAGES[::-1])
        assert matcher.cache.made == made
    assert all(np.array_equal(points, found[0]) for points in found)


def test_a_fingerprint_tells_weights_apart(tmp_path: Path) -> None:
    found = []
    for seed in (0, 1, 0):
        torch.manual_seed(seed)
        save_weights(DGCNet(preset("dgcm-lite0")), tmp_path / "w.safetensors")
        loaded = [load_matcher(tmp_path / "w.safetensors")]
        with os.scandir(tmp_path) as (entry,):  # which `open` takes, too
            loaded.append(load_matcher(entry))
        assert len({one.fingerprint for one in loaded}) == 1
        found.append(loaded[0].fingerprint)
    assert found[0] == found[2] != found[1] and len(found[0] or "") == 16


def test_other_names_are_paths_to_weights() -> None:
    with pytest.raises(WeightsError, match="nowhere.pth is not a file, and no weights"):
        load_matcher("nowhere.pth")
    with pytest.raises(
        InputError,
        match="nowhere is neither a file nor a matcher; the matchers are dgcm-lite0, sift, ",
    ):
        load_matcher("nowhere")


def test_a_coarse_pass_is_coarse_and_what_it_leads_to_is_fine(
    network: NetworkMatcher, refined: MatchResult
) -> None:
    full = refined
    coarse = network.coarse(*IMAGES)
    assert coarse is not None and coarse.correspondence_map is not None
    assert max(coarse.correspondence_map.matchability.shape) < 75
    fine = network.refined(*IMAGES, coarse)
    assert fine is not None and fine.correspondence_map is coarse.correspondence_map
    counts = [len(result.matches) for result in (coarse, fine, full)]
    assert 50 < counts[0] and counts[1] == pytest.approx(counts[2], rel=0.1)
    for result in (coarse, fine):
        truth = dense_scene.points_in_image1(result.matches.points2)
        assert np.median(np.linalg.norm(result.matches.points1 - truth, axis=1)) < 0.15


@pytest.fixture(scope="module")
def own_weights(tmp_path_factory):
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "own.safetensors"
    save_weights(DGCNet(preset("dgcm-lite0")), path)
    return path


@pytest.fixture
def no_gpu(monkeypatch):
    monkeypatch.setattr(matchers, "_may_have_gpu", lambda: False)


@pytest.fixture
def no_torch(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)


def _kind(*given: object, **options: object) -> str:
    return type(load_engine(*given, **options)).__name__  # type: ignore[arg-type]


def test_shipped_weights_on_the_cpu_run_by_onnx_runtime(no_gpu, own_weights):
    assert _kind() == _kind(device="cpu") == _kind("dgcm-lite0") == "OnnxEngine"
    assert _kind(runtime="torch") == _kind(own_weights) == "TorchEngine"
    assert _kind(own_weights, runtime="onnx") == "OnnxEngine"


def test_a_gpu_is_torch_s(monkeypatch, own_weights):
    monkeypatch.setattr(matchers, "_may_have_gpu", lambda: True)
    monkeypatch.setattr(matchers, "device_type", lambda name: "cuda")
    assert _kind() == "TorchEngine" and _kind(runtime="onnx") == "OnnxEngine"
    monkeypatch.undo()
    monkeypatch.setattr(matchers, "_may_have_gpu", lambda: True)
    monkeypatch.setattr(matchers, "choose_device", lambda name: torch.device("meta"))
    assert device_type("auto") == "meta"
    monkeypatch.setattr(matchers, "choose_device", lambda name: torch.device("cpu"))
    assert _kind() == "OnnxEngine"  # a driver without a card


def test_without_torch_what_needs_it_is_refused(no_torch, own_weights):
    checkpoint = own_weights.with_suffix(".pth")
    checkpoint.touch()
    assert _kind() == _kind(own_weights) == "OnnxEngine"
    assert device_type("auto") == device_type("cpu") == "cpu"
    for call in (
        partial(device_type, "cuda"),
        partial(load_engine, device="cuda"),
        partial(load_engine, own_weights, device="cpu", runtime="torch"),
        partial(load_engine, checkpoint),
    ):
        with pytest.raises(InputError, match="needs torch, which is not installed: pip install"):
            call()


def test_other_requests_are_refused(no_gpu, tmp_path):
    for options, error, words in (
        ({"weights": "nowhere.safetensors"}, WeightsError, "is not a file, and no weights"),
        ({"weights": "dgcm"}, WeightsError, "no weights are shipped for dgcm "),
        (
            {"device": "cuda", "runtime": "onnx"},
            InputError,
            "device must be cpu for ONNX Runtime, not cuda",
        ),
        ({"device": "mps"}, InputError, "device must be auto, cpu, cuda or cuda:N, not 'mps'"),
    ):
        with pytest.raises(error, match=words):
            load_engine(**options)  # type: ignore[arg-type]
