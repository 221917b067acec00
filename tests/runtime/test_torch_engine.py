"""The network run by torch: shapes, precision, batches, fingerprints."""

from contextlib import nullcontext

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet, normalise
from dgc_pose.runtime.torch_engine import TorchEngine


@pytest.fixture(scope="module", params=[False, True], ids=["single", "half"])
def net(request):
    """In either precision; a processor without bfloat16 computes it the slow way."""
    torch.manual_seed(0)
    net = DGCNet(preset("dgcm-lite0")).eval().requires_grad_(False)
    net.half_precision = request.param
    return net


def _noise(width: int, height: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def test_half_precision_hardly_changes_the_features(net):
    pixels, half = _noise(96, 64), net.half_precision
    found = TorchEngine(net).native(pixels, (6, 4))
    planes = torch.from_numpy(pixels).permute(2, 0, 1)[None].double() / 255
    levels = DGCNet(preset("dgcm-lite0")).double().pyramid
    levels.load_state_dict({key: value.double() for key, value in net.pyramid.state_dict().items()})
    with torch.no_grad():
        truth = levels(normalise(planes))
    for level, exact in zip((found.fine, found.middle, found.coarse), truth[2:], strict=True):
        wanted = F.normalize(exact[0], dim=0).permute(1, 2, 0).numpy()
        cosine = (wanted * level).sum(-1)
        assert cosine.min() > (0.99 if half else 1 - 1e-5)
        assert half == bool(cosine.min() < 1 - 1e-6)  # rounded where it is asked for alone


def test_every_tensor_is_on_the_device_of_the_network(monkeypatch):
    """Operations on tensors of two devices are refused, on one without numbers too."""
    monkeypatch.setattr(torch, "autocast", lambda *_, **__: nullcontext())
    with torch.inference_mode():
        for name, shape in (("dgcm-lite0", (96, 128)), ("dgcm", (240, 240))):
            net = DGCNet(preset(name)).eval().to("meta")
            prediction = net(*torch.rand(2, 1, 3, *shape, device="meta"))
            assert all(part.is_meta for part in prediction.maps + prediction.logits)
            assert prediction.maps[-1].shape == (1, 2, *shape)
