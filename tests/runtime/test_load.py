"""Which runtime is taken, and what is refused."""

import sys
from functools import partial
from pathlib import Path

import pytest
import torch

from dgc_pose.errors import InputError, WeightsError
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.runtime import load
from dgc_pose.runtime.load import device_type, load_engine
from dgc_pose.training.run import save_weights


@pytest.fixture(scope="module")
def own_weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "own.safetensors"
    save_weights(DGCNet(preset("dgcm-lite0")), path)
    return path


@pytest.fixture
def no_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(load, "_may_have_gpu", lambda: False)


@pytest.fixture
def no_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)


def _kind(*given: object, **options: object) -> str:
    return type(load_engine(*given, **options)).__name__  # type: ignore[arg-type]


def test_shipped_weights_on_the_cpu_run_by_onnx_runtime(no_gpu: None, own_weights: Path) -> None:
    assert _kind() == _kind(device="cpu") == _kind("dgcm-lite0") == "OnnxEngine"
    assert _kind(runtime="torch") == _kind(own_weights) == "TorchEngine"
    assert _kind(own_weights, runtime="onnx") == "OnnxEngine"


def test_a_gpu_is_torch_s(monkeypatch: pytest.MonkeyPatch, own_weights: Path) -> None:
    monkeypatch.setattr(load, "_may_have_gpu", lambda: True)
    monkeypatch.setattr(load, "device_type", lambda name: "cuda")
    assert _kind() == "TorchEngine" and _kind(runtime="onnx") == "OnnxEngine"
    monkeypatch.undo()
    monkeypatch.setattr(load, "_may_have_gpu", lambda: True)
    monkeypatch.setattr("dgc_pose.network.weights.choose_device", lambda name: torch.device("meta"))
    assert device_type("auto") == "meta"
    monkeypatch.setattr("dgc_pose.network.weights.choose_device", lambda name: torch.device("cpu"))
    assert _kind() == "OnnxEngine"  # a driver without a card


def test_without_torch_what_needs_it_is_refused(no_torch: None, own_weights: Path) -> None:
    checkpoint = own_weights.with_suffix(".pth")
    checkpoint.touch()
    assert _kind() == _kind(own_weights) == "OnnxEngine"
    assert device_type("auto") == device_type("cpu") == "cpu"
    for call in (lambda: device_type("cuda"), lambda: load_engine(device="cuda")):
        with pytest.raises(InputError, match="torch.*not installed"):
            call()
    for call, what in (
        (partial(load_engine, own_weights, device="cpu", runtime="torch"), "runtime torch"),
        (partial(load_engine, half_precision=True), "half_precision"),
        (partial(load_engine, checkpoint), "own.pth"),
    ):
        with pytest.raises(InputError) as error:
            call()
        told = f"{what} needs torch, which is not installed: pip install '.[torch]'"
        assert str(error.value) == told


def test_other_requests_are_refused(no_gpu: None, tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="no such weights"):
        load_engine("nowhere.safetensors")
    with pytest.raises(WeightsError, match="no weights are shipped for dgcm "):
        load_engine("dgcm")
    with pytest.raises(InputError, match="on the CPU, not on cuda"):
        load_engine(device="cuda", runtime="onnx")
    with pytest.raises(InputError, match="half_precision"):
        load_engine(runtime="onnx", half_precision=True)
    with pytest.raises(InputError, match="device"):
        load_engine(device="quantum")
