"""Training of the regressions of transformations, by the trainer of all networks."""

import csv
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from photos import drawn_photos

from dgc_pose.errors import InputError, WeightsError
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import build_network, load_network, save_weights
from dgc_pose.training.initialise import initialise_from
from dgc_pose.training.options import TrainingOptions
from dgc_pose.training.regression_stage import RegressionStage
from dgc_pose.training.run import Trainer
from dgc_pose.training.schedule import Schedule
from dgc_pose.training.synthesis.draw import Draw
from dgc_pose.training.synthesis.options import WARPS, PairOptions
from dgc_pose.training.synthesis.photos import Photos
from dgc_pose.training.synthesis.random_pairs import make_pairs
from dgc_pose.training.validation import validate, validation_pairs

_PAIRS = PairOptions(scene_share=0.0, warps=WARPS["paper-affine-tps"])
_DRAW = Draw(torch.Generator().manual_seed(3))


@pytest.fixture(scope="module")
def photos() -> Photos:
    return drawn_photos(6, 96)


def _stage(end_to_end: bool = False) -> RegressionStage:
    torch.manual_seed(0)
    stage = RegressionStage(build_network(preset("rocco")), end_to_end)  # type: ignore[arg-type]
    return stage.train()


def _options(**changes: object) -> TrainingOptions:
    base = TrainingOptions(
        "rocco", steps=6, pairs=_PAIRS, validation_count=2, batch=2, schedule=Schedule(0, 0.5, 0.5)
    )
    return replace(base, **changes)  # type: ignore[arg-type]


def test_the_loss_falls_on_a_fixed_batch_and_the_encoder_stays(photos: Photos) -> None:
    stage = _stage()
    before = {k: v.clone() for k, v in stage.net.pyramid.state_dict().items()}
    pairs = make_pairs(photos, 4, 240, torch.Generator().manual_seed(0), _PAIRS)
    optimizer = torch.optim.AdamW([p for p in stage.parameters() if p.requires_grad], lr=2e-4)
    losses = []
    for _ in range(8):
        loss, figures = stage(pairs, _DRAW)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.7 * losses[0]
    assert losses[-1] == pytest.approx(float(figures["epe_affine"] + figures["epe"]) / 16)
    for key, value in stage.net.pyramid.state_dict().items():
        assert torch.equal(value, before[key])


def test_the_loss_is_the_mean_distance_of_visible_points(photos: Photos) -> None:
    """Before training both maps are the identity: the distances are those of the true map."""
    pairs = make_pairs(photos, 2, 240, torch.Generator().manual_seed(1), _PAIRS)
    loss, figures = _stage()(pairs, _DRAW)
    places = torch.arange(30.0) * 8 + 3.5
    grid = torch.stack(torch.meshgrid(places, places, indexing="xy"), -1)
    # Of smooth maps the centre of a cell is the mean of the pixels around it.
    around = [(slice(dy, None, 8), slice(dx, None, 8)) for dy in (3, 4) for dx in (3, 4)]
    truth = torch.stack([pairs.map[:, y, x] for y, x in around]).mean(0)
    valid = torch.stack([pairs.valid[:, y, x] for y, x in around]).all(0)
    expected = float((truth - grid).norm(dim=-1)[valid].mean())
    assert float(figures["epe"]) == pytest.approx(expected, rel=1e-3)
    assert float(figures["epe_affine"]) == pytest.approx(expected, rel=1e-3)
    assert float(loss.detach()) == pytest.approx(2 * expected / 16, rel=1e-3)


def test_polish_reaches_the_affine_regression_from_the_splines_loss(photos: Photos) -> None:
    pairs = make_pairs(photos, 2, 240, torch.Generator().manual_seed(0), _PAIRS)
    gradients = []
    for end_to_end in (False, True):
        stage = _stage(end_to_end)
        torch.nn.init.normal_(stage.net.spline.final.weight, std=0.01)
        stage(pairs, _DRAW)[0].backward()
        gradients.append(stage.net.affine.final.weight.grad.clone())
    assert not torch.allclose(*gradients, rtol=0.01)


def test_a_run_writes_weights_that_load_and_a_log(photos: Photos, tmp_path: Path) -> None:
    trainer = Trainer((photos, photos), tmp_path, _options())
    rows: list[dict[str, object]] = []
    trained = trainer.run(rows.append)
    assert trainer.complete and rows[-1]["stage"] == "polish"
    loaded = load_network(tmp_path / "rocco.safetensors")
    pairs = validation_pairs(photos, 2, 2, _PAIRS)
    figures = validate(loaded, pairs)
    assert figures["aepe"] == pytest.approx(validate(trained, pairs)["aepe"], rel=1e-2)
    with (tmp_path / "polish_validation_log.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert float(row["val_aepe"]) == pytest.approx(figures["aepe"], rel=1e-2)


def test_a_killed_run_resumes_to_the_same_loss(photos: Photos, tmp_path: Path) -> None:
    def losses(trainer: Trainer, steps: int) -> list[float]:
        return [float(trainer.train_step(0.1)["loss"]) for _ in range(steps)]

    expected = losses(Trainer((photos, photos), tmp_path / "whole", _options()), 4)
    first = Trainer((photos, photos), tmp_path / "killed", _options())
    found = losses(first, 2)
    first.save()
    losses(first, 1)  # trained after the checkpoint and lost with the kill
    second = Trainer((photos, photos), tmp_path / "killed", _options(), resume=True)
    assert found + losses(second, 2) == pytest.approx(expected, rel=1e-4)


def test_the_encoder_is_neither_trained_nor_given(tmp_path: Path) -> None:
    assert _options(schedule=Schedule(0.5, 0.4, 0.1)).stages == Schedule(0, 0.8, 0.2)
    with pytest.raises(InputError, match="rocco takes no encoder"):
        _options(encoder="lite.pth")
    torch.manual_seed(1)
    save_weights(DGCNet(preset("dgcm-lite0")), tmp_path / "other.safetensors")
    with pytest.raises(WeightsError, match="other.safetensors: rocco takes no other encoder"):
        initialise_from(tmp_path / "other.safetensors", build_network(preset("rocco")))


def test_a_run_begins_with_the_weights_it_is_given(tmp_path: Path) -> None:
    torch.manual_seed(2)
    given = build_network(preset("rocco"))
    torch.nn.init.normal_(given.get_submodule("affine.final").weight)
    save_weights(given, tmp_path / "given.safetensors")
    net = build_network(preset("rocco"))
    initialise_from(tmp_path / "given.safetensors", net)
    for key, value in load_network(tmp_path / "given.safetensors").state_dict().items():
        assert torch.equal(net.state_dict()[key], value), key
