"""Distillation: the teacher's map is a target where confident, and a truth where none is known."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from dgc_pose.errors import InputError
from dgc_pose.network.config import preset
from dgc_pose.network.coordinates import to_pixels
from dgc_pose.network.net import DGCNet
from dgc_pose.network.statistics import normalise
from dgc_pose.synthesis.draw import Draw
from dgc_pose.synthesis.map_pairs import MapPairs
from dgc_pose.training.stages import DecoderStage, TeacherTarget
from dgc_pose.training.teacher import Teacher


@pytest.fixture(scope="module")
def pairs() -> MapPairs:
    generator = torch.Generator().manual_seed(0)
    image1, image2 = torch.rand(2, 1, 3, 240, 240, generator=generator)
    known = torch.zeros(1, 240, 240, dtype=torch.bool)
    known[:, :, :120] = True
    valid = known & (torch.rand(1, 240, 240, generator=generator) < 0.5)
    truth = torch.full((1, 240, 240, 2), torch.nan)
    truth[known] = 120.0
    return MapPairs(image1, image2, truth, valid, known)


def _strided(images: torch.Tensor) -> torch.Tensor:
    # Laid out as the teacher has them, since an untrained network's peaks depend on the last digit.
    return normalise(images).contiguous(memory_format=torch.channels_last)


def test_the_teacher_fills_in_what_is_not_known(pairs: MapPairs) -> None:
    torch.manual_seed(0)
    net = DGCNet(preset("dgcm-lite0")).eval()
    taught, target = Teacher(net, 0.7).target(pairs)
    with torch.no_grad():
        prediction = net(_strided(pairs.image1), _strided(pairs.image2))
    place = to_pixels(prediction.maps[-1].movedim(1, -1), (240, 240), align_corners=False)
    sure = prediction.logits[-1][:, 0].sigmoid() > 0.5
    torch.testing.assert_close(target.map, place, atol=1e-2, rtol=1e-3)
    assert target.weight == 0.7 and torch.equal(target.confident, sure)
    assert taught.known.all()
    assert torch.equal(taught.map[:, :, :120], pairs.map[:, :, :120])
    assert torch.equal(taught.valid[:, :, :120], pairs.valid[:, :, :120])
    assert torch.equal(taught.map[:, :, 120:], target.map[:, :, 120:])
    assert torch.equal(taught.valid[:, :, 120:], sure[:, :, 120:])


def test_what_is_not_known_teaches_nothing(pairs: MapPairs) -> None:
    """Whatever stands at unknown pixels, the loss is the same, and so is the gradient."""
    losses, gradients = [], []
    torch.manual_seed(0)
    net = DGCNet(preset("dgcm-lite0"))
    for value in (torch.nan, 7.0):
        truth = torch.where(pairs.known[..., None], pairs.map, value)
        stage = DecoderStage(net).eval()
        draws = Draw(torch.Generator().manual_seed(0), torch.device("cpu"))
        loss, _ = stage(replace(pairs, map=truth), draws, noise_share=1.0)
        net.zero_grad()
        loss.backward()
        losses.append(float(loss.detach()))
        gradients.append(net.get_submodule("reg_2.final").weight.grad.clone())
    assert losses[0] == losses[1] and torch.equal(*gradients)


def test_a_target_adds_its_weight_times_its_own_loss(pairs: MapPairs) -> None:
    """On pairs without any truth the map's loss is the target's: double the weight, double it."""
    torch.manual_seed(0)
    net = DGCNet(preset("dgc"))
    nothing = torch.zeros_like(pairs.valid)
    blank = MapPairs(pairs.image1, pairs.image2, pairs.map, nothing, nothing)
    place = torch.full((1, 240, 240, 2), 60.0)
    losses = []
    for weight in (0.0, 0.5, 1.0):
        draws = Draw(torch.Generator().manual_seed(0), torch.device("cpu"))
        with torch.no_grad():
            target = TeacherTarget(place, ~nothing, weight)
            losses.append(float(DecoderStage(net).eval()(blank, draws, 0.0, target)[0]))
    assert losses[0] == 0 and losses[1] > 0
    assert losses[2] == pytest.approx(2 * losses[1], rel=1e-5)


def test_a_teacher_needs_a_mask() -> None:
    with pytest.raises(InputError, match="dgc has no matchability"):
        Teacher(DGCNet(preset("dgc")), 0.5)
