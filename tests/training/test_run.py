"""A training run: losses fall, stages follow each other, a killed run resumes exactly."""

import csv
import itertools
import re
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from map_nets import SMALL
from photos import drawn_photos
from torch import nn

from dgc_pose.errors import DgcPoseError, InputError, WeightsError
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.pyramid import Pyramid
from dgc_pose.network.weights import load_network
from dgc_pose.training.initialise import vgg_layers
from dgc_pose.training.log import ProgressLine
from dgc_pose.training.options import TrainingOptions
from dgc_pose.training.run import Trainer, save_weights
from dgc_pose.training.schedule import STAGES, Schedule, learning_rate
from dgc_pose.training.stages import DecoderStage, EncoderStage
from dgc_pose.training.synthesis.draw import Draw
from dgc_pose.training.synthesis.options import PairOptions
from dgc_pose.training.synthesis.photos import Photos
from dgc_pose.training.synthesis.random_pairs import make_pairs
from dgc_pose.training.validation import validate, validation_pairs

pytestmark = pytest.mark.slow

_WARPS_ONLY = PairOptions(scene_share=0.0)


@pytest.fixture(scope="module")
def photos() -> Photos:
    return drawn_photos(6, 96)


def _options(**changes: object) -> TrainingOptions:
    base = TrainingOptions(
        "dgcm-lite0", 1.0, pairs=_WARPS_ONLY, validation_count=1, batch=1, save_minutes=1e-9
    )
    return replace(base, **changes)  # type: ignore[arg-type]


def _draws(seed: int = 1) -> Draw:
    return Draw(torch.Generator().manual_seed(seed), torch.device("cpu"))


def _trainable(stage: nn.Module) -> list[nn.Parameter]:
    return [parameter for parameter in stage.parameters() if parameter.requires_grad]


def test_an_encoder_of_imagenet_stays_as_it_is(photos: Photos, tmp_path: Path) -> None:
    torch.manual_seed(5)
    layers = vgg_layers(Pyramid(preset("dgc")))
    torch.save(layers.state_dict(prefix="features."), tmp_path / "vgg16.pth")
    options = _options(preset="dgc", encoder=str(tmp_path / "vgg16.pth"), minutes=None, steps=4)
    first = Trainer((photos, photos), tmp_path / "run", options)
    first.run(minutes=1e-9)
    second = Trainer((photos, photos), tmp_path / "run", options, resume=True)
    assert (first.step, second.step) == (1, 1)
    started = second.net.get_parameter("reg_4.conv0.0.weight").clone()
    net = second.run()
    assert second.complete and not torch.equal(net.get_parameter("reg_4.conv0.0.weight"), started)
    trained = vgg_layers(net.pyramid).state_dict()
    for key, value in layers.state_dict().items():
        assert torch.equal(trained[key], value), key
    assert {path.name.split("_")[0] for path in (tmp_path / "run").glob("*.csv")} <= {
        "decoders",
        "polish",
    }


def test_encoder_loss_falls_on_a_fixed_batch(photos: Photos) -> None:
    torch.manual_seed(0)
    generator = torch.Generator().manual_seed(0)
    stage = EncoderStage(DGCNet(SMALL))
    pairs = make_pairs(photos, 2, 64, generator, _WARPS_ONLY)
    optimizer = torch.optim.AdamW(stage.parameters(), lr=2e-3)
    losses = []
    for _ in range(12):
        loss, shares = stage(pairs, _draws())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.8 * losses[0]
    assert set(shares) == {"found4", "found3", "found2"}


@pytest.mark.parametrize("name", ["dgcm-lite0", "dgcm"])
def test_decoder_loss_falls_and_the_pyramid_stays(photos: Photos, name: str) -> None:
    torch.manual_seed(0)
    net = DGCNet(preset(name))
    stage = DecoderStage(net)
    stage.train()
    before = {k: v.clone() for k, v in net.pyramid.state_dict().items()}
    pairs = make_pairs(photos, 1, 240, torch.Generator().manual_seed(0), _WARPS_ONLY)
    optimizer = torch.optim.AdamW(_trainable(stage), lr=1e-3)
    losses = []
    for _ in range(6 if name == "dgcm-lite0" else 3):
        loss, errors = stage(pairs, _draws(), noise_share=1.0)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < losses[0]
    assert set(errors) == {"epe15", "epe30", "epe60", "epe120", "epe240"}
    for key, value in net.pyramid.state_dict().items():
        assert torch.equal(value, before[key])


def test_the_noised_truth_is_near_the_truth(photos: Photos) -> None:
    """With the true map as input and untrained corrections, fine levels start within two cells."""
    net = DGCNet(preset("dgcm-lite0")).eval()
    for level in range(5):
        torch.nn.init.zeros_(net.get_submodule(f"reg_{level}.final").weight)
        torch.nn.init.zeros_(net.get_submodule(f"reg_{level}.final").bias)
    pairs = make_pairs(photos, 2, 240, torch.Generator().manual_seed(5), _WARPS_ONLY)
    with torch.no_grad():
        _, errors = DecoderStage(net).eval()(pairs, _draws(), noise_share=1.0)
    assert 0.2 < errors["epe240"] < 4 and 0.4 < errors["epe120"] < 8 and errors["epe15"] > 20


def test_polish_reaches_the_coarsest_decoder_from_the_finest_loss(photos: Photos) -> None:
    net = DGCNet(preset("dgcm-lite0"))
    pairs = make_pairs(photos, 1, 240, torch.Generator().manual_seed(0), _WARPS_ONLY)
    gradients = {}
    for end_to_end in (False, True):
        stage = DecoderStage(net, end_to_end=end_to_end)
        stage.train()
        net.zero_grad()
        loss, _ = stage(pairs, _draws())
        loss.backward()
        gradients[end_to_end] = net.get_submodule("reg_4.final").weight.grad.clone()
    assert not torch.equal(gradients[False], gradients[True])


def test_schedule_is_complete_in_the_time_given() -> None:
    schedule = Schedule(0.5, 0.3, 0.2)
    assert schedule.at(0.0) == ("encoder", 0.0)
    assert schedule.at(0.499)[0] == "encoder"
    assert schedule.at(0.5)[0] == "decoders"
    assert schedule.at(0.9)[0] == "polish"
    assert schedule.at(1.0) == ("polish", 1.0)
    assert Schedule(0.0, 1.0, 0.0).at(0.0)[0] == "decoders"
    rates = [learning_rate(STAGES["decoders"], p / 100) for p in range(101)]
    assert max(rates) == pytest.approx(STAGES["decoders"].learning_rate, rel=0.01)
    assert rates[0] < rates[2] > rates[-1] and rates[-1] < 0.02 * max(rates)
    with pytest.raises(InputError, match="sum to 1"):
        Schedule(0.5, 0.5, 0.5)


def test_shares_are_read_from_percentages() -> None:
    assert Schedule.parse("45, 45,10") == Schedule(0.45, 0.45, 0.1)
    for text in ("45,55", "20,40,30,10", "a,b,c", ""):
        with pytest.raises(InputError, match="three percentages.*encoder, decoders, polish"):
            Schedule.parse(text)


def test_half_precision_trains_as_single_precision_does(photos: Photos, tmp_path: Path) -> None:
    """The same pairs and draws: losses a percent or two apart, gradients along each other."""
    losses, gradients = [], []
    for half in (False, True):
        options = _options(half_precision=half)
        trainer = Trainer((photos, photos), tmp_path / str(half), options)
        losses.append(float(trainer.train_step(0.7)["loss"]))
        gradients.append(torch.cat([p.grad.flatten() for p in trainer.parameters]))
        assert all(p.dtype == torch.float32 for p in trainer.parameters)
    assert losses[0] != losses[1] == pytest.approx(losses[0], rel=0.05)
    assert torch.cosine_similarity(*gradients, dim=0) > 0.8


def test_weights_given_are_validated_before_the_first_step(
    photos: Photos, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = str(tmp_path / "given.safetensors")
    save_weights(DGCNet(preset("dgcm-lite0")), given)
    options = _options(minutes=None, steps=2, init=given, schedule=Schedule(0.0, 1.0, 0.0))
    rows: list[dict[str, object]] = []
    Trainer((photos, photos), tmp_path / "run", options).run(rows.append)
    expected = validate(load_network(given), validation_pairs(photos, 1, 1, _WARPS_ONLY))
    assert rows[0]["step"] == 0 and rows[0]["val_aepe"] == pytest.approx(expected["aepe"], rel=1e-3)
    with (tmp_path / "run" / "initial_validation_log.csv").open() as file:
        (first,) = csv.DictReader(file)
    assert float(first["val_aepe"]) == rows[0]["val_aepe"]
    ProgressLine(options)(rows[0])
    told = capsys.readouterr().err
    assert "step      0/2" in told and "validation  aepe" in told and "pairs/s" not in told


def test_a_run_writes_weights_that_load_and_a_log(
    photos: Photos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a clock that ticks a second at each look, so that every machine takes the same steps."""
    ticks = itertools.count()
    monkeypatch.setattr("dgc_pose.training.run.time.perf_counter", lambda: float(next(ticks)))
    rows: list[dict[str, object]] = []
    options = _options(minutes=0.5, schedule=Schedule(0.3, 0.4, 0.3), validate_minutes=0.1)
    net = Trainer((photos, photos), tmp_path, options).run(rows.append)
    stages = [str(row["stage"]) for row in rows]
    assert sorted(set(stages), key=stages.index) == list(STAGES)
    assert all(float(row["pairs_per_second"]) > 0 for row in rows)
    loaded = load_network(tmp_path / "dgcm-lite0.safetensors")
    pairs = validation_pairs(photos, 1, 1, _WARPS_ONLY)
    ours, shipped = validate(net.eval(), pairs), validate(loaded, pairs)
    assert shipped["aepe"] == pytest.approx(ours["aepe"], rel=0.05)
    with next(tmp_path.glob("polish_validation_*.csv")).open() as file:
        last = list(csv.DictReader(file))[-1]
    assert float(last["val_aepe"]) > 0 and int(last["step"]) == rows[-1]["step"]


def test_a_run_killed_in_every_stage_resumes_to_the_bit(photos: Photos, tmp_path: Path) -> None:
    options = _options(minutes=None, steps=4, schedule=Schedule(0.5, 0.25, 0.25))
    first = Trainer((photos, photos), tmp_path / "1", options).run()
    for step in range(4):
        again = Trainer((photos, photos), tmp_path / "2", options, resume=step > 0)
        assert again.step == step and not again.weights_path.exists()
        net = again.run(minutes=1e-6)
        if not again.complete:
            again.train_step(again.progress)  # after the checkpoint, and lost with the kill
    assert again.complete and again.weights_path.exists()
    for one, other in zip(first.parameters(), net.parameters(), strict=True):
        assert torch.equal(one, other)


def test_a_run_that_diverges_stops_and_saves_nothing_of_it(photos: Photos, tmp_path: Path) -> None:
    trainer = Trainer((photos, photos), tmp_path, _options())
    trainer.save()
    before = (tmp_path / "checkpoint.pt").read_bytes()
    with torch.no_grad():
        trainer.parameters[1].fill_(torch.nan)
    with pytest.raises(DgcPoseError, match="no number at step"):
        trainer.run(minutes=1e-6)
    assert (tmp_path / "checkpoint.pt").read_bytes() == before


def test_runs_are_not_overwritten_or_mixed(photos: Photos, tmp_path: Path) -> None:
    Trainer((photos, photos), tmp_path, _options()).save()
    with pytest.raises(InputError, match=": resume continues"):
        Trainer((photos, photos), tmp_path, _options())
    with pytest.raises(WeightsError, match="preset dgcm-lite0, not dgc"):
        Trainer((photos, photos), tmp_path, _options(preset="dgc"), resume=True)
    (tmp_path / "checkpoint.pt").write_bytes(b"half a checkp")
    with pytest.raises(WeightsError, match=re.escape("checkpoint.pt")):
        Trainer((photos, photos), tmp_path, _options(), resume=True)
