"""Which runtime is taken, and what is refused."""

import sys
from functools import partial

import pytest
import torch

from dgc_pose.errors import InputError, WeightsError
from dgc_pose.matchers import device_type, load_engine
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.runtime import load
from dgc_pose.training.run import save_weights


@pytest.fixture(scope="module")
def own_weights(tmp_path_factory):
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "own.safetensors"
    save_weights(DGCNet(preset("dgcm-lite0")), path)
    return path


@pytest.fixture
def no_gpu(monkeypatch):
    monkeypatch.setattr(load, "_may_have_gpu", lambda: False)


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
    monkeypatch.setattr(load, "_may_have_gpu", lambda: True)
    monkeypatch.setattr(load, "device_type", lambda name: "cuda")
    assert _kind() == "TorchEngine" and _kind(runtime="onnx") == "OnnxEngine"
    monkeypatch.undo()
    monkeypatch.setattr(load, "_may_have_gpu", lambda: True)
    monkeypatch.setattr("dgc_pose.network.weights.choose_device", lambda name: torch.device("meta"))
    assert device_type("auto") == "meta"
    monkeypatch.setattr("dgc_pose.network.weights.choose_device", lambda name: torch.device("cpu"))
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
        partial(load_engine, half_precision=True),
        partial(load_engine, checkpoint),
    ):
        with pytest.raises(InputError, match="needs torch, which is not installed: pip install"):
            call()


def test_other_requests_are_refused(no_gpu, tmp_path):
    for options, error, words in (
        ({"weights": "nowhere.safetensors"}, WeightsError, "no such weights"),
        ({"weights": "dgcm"}, WeightsError, "no weights are shipped for dgcm "),
        ({"device": "cuda", "runtime": "onnx"}, InputError, "on the CPU, not on cuda"),
        ({"half_precision": True, "runtime": "onnx"}, InputError, "not in half_precision"),
        ({"device": "quantum"}, InputError, "device"),
    ):
        with pytest.raises(error, match=words):
            load_engine(**options)  # type: ignore[arg-type]
