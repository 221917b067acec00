"""Decoders put on an encoder whose features are a rotation, in feature space, of the old ones."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
import torch

from dgc_pose.errors import InputError, WeightsError
from dgc_pose.network.config import EfficientNet, preset
from dgc_pose.network.net import DGCNet, normalise
from dgc_pose.training.decoder_fit import fit_decoders
from dgc_pose.training.options import TrainingOptions
from dgc_pose.training.schedule import Schedule
from dgc_pose.training.synthesis.draw import seeded
from dgc_pose.training.synthesis.map_pairs import MapPairs


def _pairs(count: int) -> Iterator[MapPairs]:
    for index in range(count):
        generator = seeded("fit", index)
        image1 = torch.nn.functional.interpolate(
            torch.rand(2, 3, 40, 40, generator=generator), (240, 240), mode="bicubic"
        ).clamp(0, 1)
        image2 = image1.roll((4 * index, 8), (2, 3))
        still = torch.zeros(2, 240, 240)
        known = still.bool()
        yield MapPairs(image1, image2, torch.stack([still, still], -1), known, known)


@pytest.fixture(scope="module")
def trained() -> DGCNet:
    """A small network of random weights, whose decoders move every point."""
    lite = preset("dgcm-lite0")
    assert isinstance(lite.pyramid, EfficientNet)
    config = replace(
        lite,
        pyramid=replace(lite.pyramid, channels=(8, 12, 12)),
        decoders=tuple(
            replace(decoder, channels=(12,), dilations=(1,), local_radius=2)
            for decoder in lite.decoders
        ),
    )
    torch.manual_seed(4)
    return DGCNet(config).eval().requires_grad_(False)


@pytest.fixture(scope="module")
def rotated(trained: DGCNet) -> DGCNet:
    """The same network with the channels of levels 2, 3 and 4 rotated: their products are equal."""
    net = DGCNet(trained.config).eval().requires_grad_(False)
    net.load_state_dict(trained.state_dict())
    generator = torch.Generator().manual_seed(8)
    for layer in (net.pyramid.merge_2, net.pyramid.merge_3, net.pyramid.head_4):
        channels = layer.weight.shape[0]
        rotation = torch.linalg.qr(torch.randn(channels, channels, generator=generator))[0]
        layer.weight.copy_(torch.einsum("ij,jkyx->ikyx", rotation, layer.weight))
        layer.bias.copy_(rotation @ layer.bias)
    return net


def test_the_fit_gives_the_trained_networks_maps(trained: DGCNet, rotated: DGCNet) -> None:
    (pair,) = _pairs(1)
    images = [normalise(image[:1]) for image in (pair.image1, pair.image2)]
    with torch.no_grad():
        wanted = trained(*images).maps[2]
        before = (rotated(*images).maps[2] - wanted).norm(dim=1).median()
        fit_decoders(rotated, trained, _pairs(3))
        after = (rotated(*images).maps[2] - wanted).norm(dim=1).median()
    assert after * 120 < 0.1 * before * 120 < 10  # pixels


def test_decoders_of_other_widths_are_refused(trained: DGCNet) -> None:
    paper = DGCNet(preset("dgcm"))
    with pytest.raises(WeightsError, match="dgcm do not fit dgcm-lite0 at level 0"):
        fit_decoders(DGCNet(trained.config), paper, [])


def test_a_run_with_an_encoder_stage_is_refused() -> None:
    with pytest.raises(InputError, match="leaves the encoder as it is"):
        TrainingOptions(steps=1, fit_decoders="dgcm-lite0")
    TrainingOptions(steps=1, fit_decoders="dgcm-lite0", schedule=Schedule(0, 0.9, 0.1))
