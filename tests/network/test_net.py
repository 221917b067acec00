"""The assembled network: shapes, sizes and keys as published."""

from dataclasses import replace

import pytest
import torch
from map_nets import SMALL

from dgc_pose.errors import InputError
from dgc_pose.network.config import PRESETS, preset
from dgc_pose.network.net import DGCNet, to_normalised, to_pixels

_DECODERS = (  # parameters and dilations
    (335_618, [1, 4, 12, 16]),
    (335_618, [1, 4, 6, 8]),
    (483_074, [1, 2, 3, 4]),
    (925_826, [1] * 5),
    (595_202, [1] * 5),
)


def _count(module: torch.nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


def _published_keys(mask: bool) -> set[str]:
    """Every key of the authors' checkpoints, written out from their layout."""
    convolutions = {0: (0,), 1: (0,), 2: (0, 2), 3: (0, 2, 4), 4: (0, 2, 4)}
    keys = {
        f"pyramid.level_{level}.{index}.{kind}"
        for level, indices in convolutions.items()
        for index in indices
        for kind in ("weight", "bias")
    }
    norm = ("weight", "bias", "running_mean", "running_var", "num_batches_tracked")
    blocks = [f"reg_{k}.conv{j}" for k in range(5) for j in range(5 if k > 2 else 4)]
    if mask:
        blocks += [f"matchability_net.conv{j}" for j in range(3)]
        keys |= {"matchability_net.conv3.weight", "matchability_net.conv3.bias"}
    for block in blocks:
        keys |= {f"{block}.0.weight", f"{block}.0.bias"}
        keys |= {f"{block}.1.{kind}" for kind in norm}
    keys |= {f"reg_{k}.final.{kind}" for k in range(5) for kind in ("weight", "bias")}
    return keys


def test_parameters_and_dilations_are_the_published_ones():
    dgc, dgcm = DGCNet(preset("dgc")), DGCNet(preset("dgcm"))
    parts = dgc, dgcm, dgcm.pyramid, dgcm.matchability_net
    assert [_count(part) for part in parts] == [10_310_602, 10_407_723, 7_635_264, 97_121]
    for level, (count, dilations) in enumerate(_DECODERS):
        decoder = dgcm.get_submodule(f"reg_{level}")
        assert _count(decoder) == count
        assert [block[0].dilation[0] for block in list(decoder)[:-1]] == dilations


def test_keys_are_the_published_ones():
    for name, mask in (("dgc", False), ("dgcm", True)):
        assert set(DGCNet(preset(name)).state_dict()) == _published_keys(mask)


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_maps_come_at_five_sizes(name):
    net = DGCNet(preset(name)).eval()
    image = torch.randn(1, 3, 240, 240, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        prediction = net(image, image.flip(3))
    assert [m.shape[1:] for m in prediction.maps] == [(2, s, s) for s in (15, 30, 60, 120, 240)]
    masks = {"dgc": [], "dgcm": [240]}.get(name, [15, 30, 60, 120, 240])
    assert [m.shape[1:] for m in prediction.logits] == [(1, s, s) for s in masks]


def test_align_corners_modes_sample_at_their_points():
    """A map made from pixels by either convention fetches exactly those pixels' features."""
    features = torch.randn(1, 4, 60, 60, generator=torch.Generator().manual_seed(0))
    pixels = torch.tensor([[3.0, 5.0], [0.0, 59.0], [17.0, 41.0]])
    for align_corners in (True, False):
        net = DGCNet(replace(preset("dgc"), align_corners=align_corners))
        place = to_normalised(pixels, (60, 60), align_corners)
        state = place.T.reshape(1, 2, 1, 3)
        warped = net.warp(features, state)[0, :, 0]
        expected = torch.stack([features[0, :, int(y), int(x)] for x, y in pixels], 1)
        torch.testing.assert_close(warped, expected, atol=1e-4, rtol=0)
        torch.testing.assert_close(to_pixels(place, (60, 60), align_corners), pixels)


@pytest.mark.parametrize("config", [SMALL, preset("dgcm-lite0")])
def test_a_part_of_a_level_decodes_as_the_whole_does(config):
    """Away from the part's border, as training needs it."""
    net = DGCNet(config).eval()
    generator = torch.Generator().manual_seed(5)
    channels = config.level_channels[1]
    source, target = torch.randn(2, 1, channels, 120, 120, generator=generator)
    state = torch.rand(1, 3, 120, 120, generator=generator) - 0.5
    rows, columns = slice(20, 90), slice(30, 100)
    with torch.no_grad():
        whole = net.refine(1, net.warp(source, state), target, state, (120, 120))
        part = state[:, :, rows, columns]
        warped = net.warp(source, part)
        found = net.refine(1, warped, target[:, :, rows, columns], part, (120, 120))
    inner = slice(15, -15)
    expected = whole[:, :, rows, columns][:, :, inner, inner]
    torch.testing.assert_close(found[:, :, inner, inner], expected, atol=1e-5, rtol=1e-4)


def test_unknown_presets_are_refused():
    with pytest.raises(InputError, match="no preset 'vgg'; there are dgc, dgcm, dgcm-lite0"):
        preset("vgg")
