"""Weights: those shipped, our files, the authors' layout, and errors that name file and keys."""

import hashlib
import re
from importlib import resources

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from dgc_pose.errors import WeightsError
from dgc_pose.network.config import PRESETS, preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import load_network, shipped
from dgc_pose.training.run import save_weights


def _random_net(name: str) -> DGCNet:
    """A net whose statistics differ from their initial values, so that a lost key shows."""
    torch.manual_seed(7)
    net = DGCNet(preset(name))
    for key, buffer in net.named_buffers():
        if "running" in key:
            buffer.copy_(0.5 + torch.rand_like(buffer))
    return net.eval()


@pytest.mark.parametrize(("name", "prefix"), [("dgc", "module."), ("dgcm", "")])
def test_authors_checkpoints_are_loaded_whole(tmp_path, name, prefix):
    """Those of one have no counters of batches."""
    net = _random_net(name)
    counter = "num_batches_tracked"
    state = {k: v for k, v in net.state_dict().items() if name == "dgc" or not k.endswith(counter)}
    path = tmp_path / "checkpoint.pth"
    torch.save({"state_dict": {prefix + k: v for k, v in state.items()}, "epoch": 70}, path)
    loaded = load_network(path)
    assert loaded.config.name == name
    assert not loaded.training and not any(p.requires_grad for p in loaded.parameters())
    own = loaded.state_dict()
    assert own.keys() == net.state_dict().keys()
    for key, value in net.state_dict().items():
        assert key.endswith(counter) or torch.equal(own[key], value), key


def test_own_weights_survive_the_disk_at_half_precision(tmp_path):
    net = _random_net("dgcm-lite0")
    save_weights(net, tmp_path / "a.safetensors")
    loaded = load_network(str(tmp_path / "a.safetensors"))
    assert loaded.config == preset("dgcm-lite0")
    for key, value in net.state_dict().items():
        if not key.endswith("num_batches_tracked"):
            stored = value if "running" in key else value.half().float()
            assert torch.equal(loaded.state_dict()[key], stored), key
    assert [p.name for p in tmp_path.iterdir()] == ["a.safetensors"]


def test_missing_and_unreadable_files_are_named(tmp_path):
    with pytest.raises(WeightsError, match="nowhere.pth"):
        load_network(tmp_path / "nowhere.pth")
    for name in ("a.pth", "b.safetensors"):
        for content in (b"", b"not weights at all"):
            (tmp_path / name).write_bytes(content)
            with pytest.raises(WeightsError, match=name) as caught:
                load_network(tmp_path / name)
            assert "\n" not in str(caught.value)


def test_the_first_differing_keys_are_named(tmp_path):
    state = dict(_random_net("dgc").state_dict())
    key = "reg_4.conv0.0.weight"
    for value, words in ((None, f"lacks {key}"), (torch.zeros(2), rf"has {key} \(2,\) instead of")):
        del state[key]
        if value is not None:
            state[key] = value
        torch.save({"state_dict": state}, tmp_path / "other.pth")
        with pytest.raises(
            WeightsError, match=rf"other\.pth does not contain the weights of dgc: it {words}"
        ):
            load_network(tmp_path / "other.pth")
        state[key] = torch.zeros(2)
    ours = {k: v.half() for k, v in _random_net("dgcm-lite0").state_dict().items()}
    for metadata, words in (
        ({"preset": "dgcm"}, "does not contain the weights of dgcm: it has pyramid"),
        ({}, "without a known preset"),
    ):
        save_file(ours, tmp_path / "x.safetensors", metadata=metadata)
        with pytest.raises(WeightsError, match=rf"x\.safetensors .*{words}"):
            load_network(tmp_path / "x.safetensors")


@pytest.mark.parametrize("name", shipped())
def test_shipped_weights_load_in_half_precision_and_have_a_card(name):
    folder = resources.files("dgc_pose") / "weights"
    net = load_network(name)
    assert name in PRESETS and net.config == PRESETS[name]
    with resources.as_file(folder / f"{name}.safetensors") as path:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        with safe_open(path, "pt") as file:
            assert {file.get_tensor(key).dtype for key in file.keys()} == {torch.float16}
    card = (folder / f"{name}.md").read_text(encoding="utf-8")
    assert digest in card
    for entry in ("Preset", "Data", "Steps", "Hardware", "Seed", "Command", "Scores"):
        assert re.search(rf"^\| {entry} \|", card, re.MULTILINE), entry
