"""A training run: stages follow each other, a killed run resumes exactly, weights load."""

import copy
import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from textures import drawn_photos
from torch import Tensor, nn

from dgc_pose.errors import DgcPoseError, InputError, WeightsError
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import COUNTER, folded, load_network, read_safetensors
from dgc_pose.training import run
from dgc_pose.training.losses import EncoderStage
from dgc_pose.training.options import Shares, TrainingOptions
from dgc_pose.training.pairs import TRAINING, PairSource
from dgc_pose.training.run import (
    Trainer,
    initialise_encoder,
    move_average,
    optimiser,
    save_weights,
    vgg_layers,
)

pytestmark = pytest.mark.slow
OPTIONS = TrainingOptions(steps=4, batch=1)


@pytest.fixture(scope="module")
def data():
    source = PairSource(drawn_photos(6, 96, places=2))
    return {TRAINING: source, "photos": replace(source, shares=Shares(1, 0, 0, 0))}


@pytest.fixture(autouse=True)
def little_validates(monkeypatch):
    monkeypatch.setattr(run, "_VALIDATION", 1)
    monkeypatch.setattr(run, "_VALIDATION_BATCH", 1)


def _log(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


def test_vgg_16_of_imagenet_stays_as_it_is(data, tmp_path):
    torch.save(_vgg16_state(5), tmp_path / "vgg16.pth")
    options = replace(OPTIONS, preset="dgcm", encoder=str(tmp_path / "vgg16.pth"), steps=2)
    first = Trainer(tmp_path / "run", options)
    first.train_step(data[TRAINING])
    first.save()
    second = Trainer(tmp_path / "run", options, resume=True)
    assert (first.step, second.step) == (1, 1) and not second.weights_path.exists()
    trained = vgg_layers(second.run(data).pyramid).state_dict(prefix="features.")
    for key, value in trained.items():
        assert torch.equal(value, _vgg16_state(5)[key]), key
    assert {row["stage"] for row in _log(tmp_path / "run")} == {"decoders"}
    assert load_network(second.weights_path).config.name == "dgcm"


def test_a_run_of_both_stages_writes_weights_that_load_with_their_card(data, tmp_path, capsys):
    options = replace(OPTIONS, encoder_share=0.5, init="dgcm-lite0", rate=0.01)
    net = Trainer(tmp_path, options).run(data)
    rows = _log(tmp_path)
    steps = [("encoder", 0), ("encoder", 2), ("decoders", 4)]
    assert [(row["stage"], row["step"]) for row in rows] == steps
    assert rows[0]["validation"]["photos"]["found16"] > 0.6  # shipped weights know their cells
    told = capsys.readouterr().err
    for words in ("decoders step 4, ", "loss ", "pairs_per_second ", "validation, photos:"):
        assert words in told
    loaded = load_network(tmp_path / "dgcm-lite0.safetensors")
    for key, value in loaded.state_dict().items():
        if not key.endswith(COUNTER):
            torch.testing.assert_close(value, net.state_dict()[key], rtol=2e-3, atol=1e-5)
    card = (tmp_path / "dgcm-lite0.md").read_text()
    for words in ("6, and 2 places", "| init | dgcm-lite0 |", "| encoder | 2 steps, "):
        assert words in card
    assert "photos: found16 0." in card


def test_half_precision_trains_as_single_precision_does(data, tmp_path):
    """The same pairs and draws: losses a percent or two apart, gradients along each other."""
    losses, gradients = [], []
    for half in (False, True):
        options = replace(OPTIONS, init="dgcm-lite0", encoder_share=1.0)
        trainer = Trainer(tmp_path / str(half), options)
        trainer.module.net.half_precision = half
        losses.append(float(trainer.train_step(data[TRAINING])["loss"]))
        parameters = [p for p in trainer.module.parameters() if p.requires_grad]
        gradients.append(torch.cat([p.grad.flatten() for p in parameters]))
        assert all(p.dtype == torch.float32 for p in parameters)
    assert losses[0] != losses[1] == pytest.approx(losses[0], rel=0.05)
    assert torch.cosine_similarity(*gradients, dim=0) > 0.8


def test_a_run_killed_in_every_stage_resumes_to_the_bit(data, tmp_path):
    options = replace(OPTIONS, encoder_share=0.5)
    first = Trainer(tmp_path / "1", options).run(data)
    for step in range(3):
        killed = Trainer(tmp_path / "2", options, resume=step > 0)
        assert killed.step == step and not killed.weights_path.exists()
        killed._write(killed.train_step(data[TRAINING]), {})
        killed.save()
        killed._write(killed.train_step(data[TRAINING]), {})  # lost with the kill
    again = Trainer(tmp_path / "2", options, resume=True)
    assert again.step == 3
    net = again.run(data)
    assert again.progress == 1 and again.weights_path.exists()
    for one, other in zip(first.parameters(), net.parameters(), strict=True):
        assert torch.equal(one, other)
    assert [again.stages[name]["steps"] for name in ("encoder", "decoders")] == [2, 2]
    assert [row["step"] for row in _log(tmp_path / "2")] == [1, 2, 3, 4]
    Trainer(tmp_path / "2", replace(options, steps=5), resume=True)  # a longer run goes on
    with pytest.raises(
        InputError, match="^steps returns to the encoder, but .* is at the decoders"
    ):
        Trainer(tmp_path / "2", replace(options, steps=20), resume=True)


def test_a_run_that_diverges_stops_and_saves_nothing_of_it(data, tmp_path):
    trainer = Trainer(tmp_path, OPTIONS)
    trainer.save()
    before = (tmp_path / "checkpoint.pt").read_bytes()
    with torch.no_grad():
        next(p for p in trainer.module.parameters() if p.requires_grad).fill_(torch.nan)
    with pytest.raises(DgcPoseError, match="is not finite at step"):
        trainer.run(data)
    assert (tmp_path / "checkpoint.pt").read_bytes() == before


def test_runs_are_not_overwritten_or_mixed(tmp_path):
    Trainer(tmp_path, OPTIONS).save()
    with pytest.raises(InputError, match=": resume continues"):
        Trainer(tmp_path, OPTIONS)
    for name, value, message in (
        ("seed", 1, "seed is 1, and 0 in the run of "),
        ("shares", Shares(1, 0, 0, 0), "shares is 100,0,0,0, and 20,8,20,52 in the run of "),
    ):
        with pytest.raises(InputError, match=f"^{message}"):
            Trainer(tmp_path, replace(OPTIONS, **{name: value}), resume=True)
    save_weights(DGCNet(preset("dgcm")), tmp_path / "other.safetensors")
    with pytest.raises(WeightsError, match="other.safetensors: weights of dgcm, not dgcm-lite0"):
        Trainer(tmp_path / "new", replace(OPTIONS, init=str(tmp_path / "other.safetensors")))
    (tmp_path / "checkpoint.pt").write_bytes(b"half a checkp")
    with pytest.raises(WeightsError, match=re.escape("checkpoint.pt")):
        Trainer(tmp_path, OPTIONS, resume=True)


def test_a_value_beyond_half_precision_is_kept(tmp_path):
    net = DGCNet(preset("dgcm-lite0")).eval()
    net.get_buffer("reg_3.conv0.1.running_var").fill_(3e5)
    with torch.no_grad():
        net.get_parameter("reg_2.final.weight")[0, 0, 0, 0] = 1e5
    save_weights(net, tmp_path / "w.safetensors")
    loaded = load_network(tmp_path / "w.safetensors")
    assert (loaded.get_buffer("reg_3.conv0.1.running_var") == 3e5).all()
    assert loaded.get_parameter("reg_2.final.weight")[0, 0, 0, 0] == 1e5
    _, arrays = read_safetensors(tmp_path / "w.safetensors")
    assert arrays["reg_3.conv0.0.weight"].dtype == "float16"
    assert max(abs(value).max() for value in folded(arrays).values()) <= 1e5


def test_the_average_is_the_sum_of_all_values_by_their_decays():
    """Of the weights, which lie between the values, and of the statistics; counters are copied."""
    norm = nn.BatchNorm1d(1)
    average, decay = copy.deepcopy(norm), 0.3
    expected, statistic = 1.0, 0.0  # as a norm begins
    for n, value in enumerate((0.5, 2.0, -1.0, 4.0, 1.5)):
        nn.init.constant_(norm.weight, value)
        nn.init.constant_(norm.get_buffer("running_mean"), -2 * value)
        norm.get_buffer("num_batches_tracked").fill_(n)
        move_average(average, norm, n + 1, decay)
        share = min(decay, (1 + n) / (10 + n))
        expected = share * expected + (1 - share) * value
        statistic = share * statistic + (1 - share) * -2 * value
    assert average.weight.item() == pytest.approx(expected, rel=1e-5)
    assert average.running_mean.item() == pytest.approx(statistic, rel=1e-5)
    assert int(average.num_batches_tracked) == 4
    assert norm.weight.requires_grad and norm.weight.item() == 1.5


def _torchvision_vgg16(seed: int) -> nn.Sequential:
    """The convolutions of torchvision's `vgg16().features`, "D" in its list of configurations."""
    torch.manual_seed(seed)
    layers: list[nn.Module] = []
    inputs = 3
    for width, count in ((64, 2), (128, 2), (256, 3), (512, 3), (512, 3)):
        for _ in range(count):
            layers += [nn.Conv2d(inputs, width, kernel_size=3, padding=1), nn.ReLU()]
            inputs = width
        layers.append(nn.MaxPool2d(kernel_size=2, stride=2))
    return nn.Sequential(*layers)


def _vgg16_state(seed: int = 4) -> dict[str, Tensor]:
    """As torchvision's file has it, a layer of the classifier included."""
    state = _torchvision_vgg16(seed).state_dict(prefix="features.")
    return {**state, "classifier.6.bias": torch.zeros(1000)}


def test_an_encoder_of_torchvision_has_its_features_and_other_weights_are_refused(tmp_path):
    path, state, net = tmp_path / "encoder.pth", _vgg16_state(), DGCNet(preset("dgcm"))
    torch.save(state, path)
    initialise_encoder(path, net)
    image, layers, ends = torch.randn(1, 3, 48, 64), _torchvision_vgg16(4), (2, 5, 10, 17, 24)
    with torch.no_grad():
        for end, features in zip(ends, net.pyramid(image), strict=True):
            torch.testing.assert_close(features, layers[:end](image))
    torch.save({**state, "features.2.weight": torch.zeros(64, 32, 3, 3)}, path)
    other = "the weights of VGG-16 in torchvision's layout: it has features.2.weight .64, 32, 3, 3."
    with pytest.raises(WeightsError, match=r"encoder\.pth .*" + other):
        initialise_encoder(path, net)


def test_a_backbone_learns_at_a_third_of_the_rate():
    net = DGCNet(preset("dgcm-lite0"))
    rest, backbone = optimiser(EncoderStage(net)).param_groups
    assert rest["share"] == 1 and backbone["share"] == 0.35
    body = [p for part in ("stem", "blocks") for p in net.pyramid.get_submodule(part).parameters()]
    assert [p.shape for p in backbone["params"]] == [p.shape for p in body]
    # Levels 0 and 1 and the decoders stay in this stage; the temperatures are the stage's own.
    heads = [m for n, m in net.pyramid.named_children() if n.startswith(("head", "lift", "merge"))]
    own = sum(p.numel() for part in heads for p in part.parameters())
    assert sum(p.numel() for p in rest["params"]) == own + 4
