"""ONNX Runtime gives what torch gives, in every process and thread, and torch what its net does."""

import json
import multiprocessing
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from importlib import resources

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from safetensors.numpy import load_file, save_file

from dgc_pose.errors import InputError, WeightsError
from dgc_pose.images.image import load_image, resize
from dgc_pose.matchers import load_engine
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet, normalise
from dgc_pose.network.weights import find_weights, folded, load_network
from dgc_pose.runtime.engine import GRAPHS, WEIGHTS
from dgc_pose.runtime.onnx_engine import OnnxEngine
from dgc_pose.runtime.session import session_threads
from dgc_pose.runtime.torch_engine import TorchEngine, for_inference
from dgc_pose.training.run import save_weights


@pytest.fixture(scope="module")
def engines():
    path = find_weights("dgcm-lite0")
    return OnnxEngine(path), load_engine(path, device="cpu", runtime="torch")


@pytest.fixture(scope="module")
def pictures():
    folder = resources.files("dgc_pose") / "data" / "rendered"
    return [load_image(str(folder / f"image{number}.jpg")).pixels for number in (1, 2)]


@pytest.mark.parametrize("small", [False, True])
def test_the_map_is_torch_s(engines, pictures, small):
    """Of a wide image and an upright one, and of small ones."""
    height, width = pictures[0].shape[:2]
    crops = [pictures[0][height // 4 : -height // 4], pictures[1][:, width // 5 : -width // 5]]
    crops = [resize(part, (90, 70)) if small else np.ascontiguousarray(part) for part in crops]
    onnx, by_torch = ([engine.encode(crop) for crop in crops] for engine in engines)
    for finest in (240, 60, 240):  # the last goes on from that before
        found, matchability = engines[0].decode(*onnx, finest)
        wanted, expected = engines[1].decode(*by_torch, finest)
        assert found.dtype == matchability.dtype == np.float32
        apart = np.linalg.norm(found - wanted, axis=-1)
        assert np.median(apart) < 1e-3 and np.quantile(apart, 0.99) < 0.02
        off = np.abs(matchability - expected)
        assert np.quantile(off, 0.99) < 1e-3
        assert wanted.std() > 1  # a map that is the same everywhere would show nothing


def test_features_are_torch_s(engines, pictures):
    onnx, by_torch = engines
    assert onnx.config == by_torch.config and onnx.fingerprint == by_torch.fingerprint
    coarsest, wanted = (engine.coarsest(engine.encode(pictures[0])) for engine in engines)
    np.testing.assert_allclose(coarsest, wanted, atol=1e-4)
    assert onnx.encode(pictures[0]).nbytes == by_torch.encode(pictures[0]).nbytes
    found, native = (engine.native(pictures[0], (13, 9)) for engine in engines)
    for level in ("coarse", "middle", "fine"):
        own, other = getattr(found, level), getattr(native, level)
        assert own.flags.c_contiguous and own.dtype == np.float32 and own.shape == other.shape
        np.testing.assert_allclose(own, other, atol=1e-4)


def test_own_weights_of_a_preset_run_too(tmp_path, pictures):
    """Batch norms whose statistics and factors are not 0 and 1 are folded as torch folds them."""
    torch.manual_seed(3)
    net = DGCNet(preset("dgcm-lite0")).eval()
    with torch.no_grad():
        for name, value in net.named_buffers():
            if name.endswith("running_var"):
                value.uniform_(0.5, 2)
        for name, value in net.named_parameters():
            if name.startswith("reg_"):
                value.add_(0.1 * torch.randn_like(value))
    save_weights(net, tmp_path / "own.safetensors")
    onnx = OnnxEngine(tmp_path / "own.safetensors")
    wanted = for_inference(load_network(tmp_path / "own.safetensors")).state_dict()
    own = folded(load_file(tmp_path / "own.safetensors"))
    assert set(own) == set(wanted)
    for key, value in own.items():
        np.testing.assert_allclose(value, wanted[key].numpy(), atol=1e-5, rtol=1e-4)
    features = [onnx.encode(one) for one in pictures]
    assert np.isfinite(onnx.decode(*features, 60)[0]).all()


def test_the_graphs_hold_no_weights_and_know_their_preset():
    files = list(GRAPHS.iterdir())
    assert sum(file.stat().st_size for file in files) < 100_000
    named = json.loads((GRAPHS / WEIGHTS).read_text())
    assert {file.name for file in files} == {WEIGHTS, *named["graphs"]}
    state = DGCNet(preset("dgcm-lite0")).state_dict()
    shapes = {k: list(v.shape) for k, v in state.items() if "num_batches" not in k}
    assert named["stored"] == shapes


def test_the_same_in_threads_and_in_a_forked_process(pictures):
    engine = OnnxEngine(find_weights("dgcm-lite0"))
    small = [resize(one, (96, 64)) for one in pictures]
    alone = [engine.native(one, (6, 4)).fine for one in small]
    with ThreadPoolExecutor(3) as pool:
        found = list(pool.map(lambda one: engine.native(one, (6, 4)).fine, small * 3))
    assert all(np.array_equal(one, alone[k % 2]) for k, one in enumerate(found))
    context = multiprocessing.get_context("fork")
    queue = context.SimpleQueue()
    child = context.Process(target=lambda: queue.put(engine.native(small[0], (6, 4)).fine.sum()))
    child.start()
    child.join(120)
    assert child.exitcode == 0 and queue.get() == alone[0].sum()


def test_threads_are_opencv_s_and_no_more_than_openmp_allows(monkeypatch):
    monkeypatch.setattr("dgc_pose.runtime.session.cv2.getNumThreads", lambda: 4)
    for allowed, expected in (("", 4), ("1", 1), ("3,2", 3), ("6", 4), ("many", 4), ("0", 4)):
        monkeypatch.setenv("OMP_NUM_THREADS", allowed)
        assert session_threads() == expected


def test_weights_that_do_not_fit_are_refused(tmp_path):
    weights = load_file(find_weights("dgcm-lite0"))
    for preset_name, error, words in (
        ("dgcm-lite0", WeightsError, "it lacks reg_0.final.bias"),
        ("dgcm", InputError, "is for dgcm, which has no ONNX graphs"),
    ):
        weights.pop("reg_0.final.bias", None)
        save_file(weights, tmp_path / "w.safetensors", {"preset": preset_name})
        with pytest.raises(error, match=words):
            OnnxEngine(tmp_path / "w.safetensors")


def test_features_are_those_of_the_net():
    """In double precision."""
    torch.manual_seed(0)
    net = DGCNet(preset("dgcm-lite0")).eval().requires_grad_(False)
    pixels = np.random.default_rng(0).integers(0, 256, (64, 96, 3), dtype=np.uint8)
    found = TorchEngine(net).native(pixels, (6, 4))
    planes = torch.from_numpy(pixels).permute(2, 0, 1)[None].double() / 255
    truth = net.double().pyramid(normalise(planes))
    for level, exact in zip((found.fine, found.middle, found.coarse), truth[2:], strict=True):
        wanted = F.normalize(exact[0], dim=0).permute(1, 2, 0).numpy()
        assert (wanted * level).sum(-1).min() > 1 - 1e-5


def test_every_tensor_is_on_the_device_of_the_network(monkeypatch):
    """Operations on tensors of two devices are refused, on one without numbers too. Maps come at
    five sizes, and the mask of dgcm at the last one."""
    monkeypatch.setattr(torch, "autocast", lambda *_, **__: nullcontext())
    with torch.inference_mode():
        for name, (height, width) in (("dgcm-lite0", (96, 128)), ("dgcm", (240, 240))):
            net = DGCNet(preset(name)).eval().to("meta")
            prediction = net(*torch.rand(2, 1, 3, height, width, device="meta"))
            assert all(part.is_meta for part in prediction.maps + prediction.logits)
            sizes = [(height // k, width // k) for k in (16, 8, 4, 2, 1)]
            assert [part.shape for part in prediction.maps] == [(1, 2, *size) for size in sizes]
            masks = sizes[-1:] if name == "dgcm" else sizes
            assert [part.shape for part in prediction.logits] == [(1, 1, *size) for size in masks]
