"""Initialising from trained weights: features stay the same, and the right weights are loaded."""

from pathlib import Path

import pytest
import torch

from dgc_pose.errors import WeightsError
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import save_weights
from dgc_pose.training.initialise import initialise_backbone, initialise_from, initialise_stage
from dgc_pose.training.options import InitPart
from dgc_pose.training.stages import EncoderStage


@pytest.mark.parametrize("name", ["dgcm-lite0", "dgcm"])
@pytest.mark.parametrize("training", [False, True])
def test_an_unfolded_pyramid_gives_the_same_features(name: str, training: bool) -> None:
    torch.manual_seed(0)
    net = DGCNet(preset(name))
    stage = EncoderStage(net)
    images = torch.randn(2, 3, 48, 48)
    initialise_stage(stage, net, images)
    stage.train(training)
    with torch.no_grad():
        expected, found = net.pyramid(images), stage.pyramid(images)
    for level in range(5):
        scale = float(expected[level].abs().max())
        torch.testing.assert_close(found[level], expected[level], rtol=1e-3, atol=2e-3 * scale)
    if name == "dgcm-lite0":
        scales = stage.log_scales.exp()
        torch.testing.assert_close(scales[:2], net.get_buffer("correlation_scales"))


def _differs(net: DGCNet, other: DGCNet, prefix: str) -> bool:
    states = net.state_dict(), other.state_dict()
    keys = [key for key in states[0] if key.startswith(prefix) and key.endswith("weight")]
    return any(not torch.allclose(states[0][k], states[1][k], atol=2e-3) for k in keys)


def test_an_ablation_takes_the_pyramid_and_a_twin_all_or_the_pyramid(tmp_path: Path) -> None:
    torch.manual_seed(1)
    trained = DGCNet(preset("dgcm-lite0"))
    trained.get_buffer("correlation_scales").fill_(33.0)
    save_weights(trained, tmp_path / "w.safetensors")
    cases: list[tuple[str, InitPart, bool]] = [
        ("dgcm-lite0", "all", False),
        ("dgcm-lite0", "encoder", True),
        ("dgcm-lite0+no-l2", "all", True),
    ]
    for name, part, decoders_differ in cases:
        net = DGCNet(preset(name))
        assert _differs(net, trained, "pyramid.")
        initialise_from(tmp_path / "w.safetensors", net, part)
        assert not _differs(net, trained, "pyramid.")
        assert _differs(net, trained, "reg_3.") == decoders_differ
        assert (net.get_buffer("correlation_scales") == 33.0).all()


def test_another_pyramid_is_refused(tmp_path: Path) -> None:
    save_weights(DGCNet(preset("dgcm-lite0")), tmp_path / "w.safetensors")
    with pytest.raises(WeightsError, match=r"w\.safetensors: weights of dgcm-lite0.*dgc "):
        initialise_from(tmp_path / "w.safetensors", DGCNet(preset("dgc")))


def test_a_pretrained_encoder_passes_through_its_stage_unchanged() -> None:
    torch.manual_seed(2)
    net = DGCNet(preset("dgcm-lite0"))
    stage = EncoderStage(net)
    for parameter in stage.pyramid.parameters():
        torch.nn.init.zeros_(parameter)
    initialise_stage(stage, net, torch.randn(1, 3, 32, 32))
    before = {k: v.clone() for k, v in net.pyramid.state_dict().items()}
    stage.write(net)
    assert all(torch.equal(before[k], v) for k, v in net.pyramid.state_dict().items())


def test_backbone_weights_of_or_for_another_encoder_are_refused(tmp_path: Path) -> None:
    torch.save({"conv.weight": torch.zeros(1)}, tmp_path / "backbone.pth")
    images = torch.randn(1, 3, 32, 32)
    for name, why in (("dgcm", "has no"), ("dgcm-lite0", "not weights of")):
        with pytest.raises(WeightsError, match=rf"backbone\.pth: .*{why} EfficientNet-Lite0"):
            initialise_backbone(tmp_path / "backbone.pth", DGCNet(preset(name)), images)
