"""The assembled network: shapes, sizes and keys as published, and the paper's ablations."""

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from map_nets import SMALL

from dgc_pose.errors import InputError
from dgc_pose.network.config import PRESETS, preset
from dgc_pose.network.coordinates import identity_map, to_normalised, to_pixels
from dgc_pose.network.net import DGCNet

_DECODERS = {0: 335_618, 1: 335_618, 2: 483_074, 3: 925_826, 4: 595_202}


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


def test_parameter_counts_are_the_published_ones() -> None:
    dgc, dgcm = DGCNet(preset("dgc")), DGCNet(preset("dgcm"))
    assert _count(dgc) == 10_310_602
    assert _count(dgcm) == 10_407_723
    assert _count(dgcm.pyramid) == 7_635_264
    assert _count(dgcm.matchability_net) == 97_121
    for level, count in _DECODERS.items():
        assert _count(dgcm.get_submodule(f"reg_{level}")) == count


@pytest.mark.parametrize(("name", "mask"), [("dgc", False), ("dgcm", True)])
def test_keys_are_the_published_ones(name: str, mask: bool) -> None:
    assert set(DGCNet(preset(name)).state_dict()) == _published_keys(mask)


def test_dilations_and_channels_of_the_decoders() -> None:
    net = DGCNet(preset("dgcm"))
    dilations = {2: [1, 2, 3, 4], 1: [1, 4, 6, 8], 0: [1, 4, 12, 16]}
    inputs = {4: 227, 3: 514, 2: 258, 1: 130, 0: 130}
    for level, channels in inputs.items():
        blocks = [m for m in net.get_submodule(f"reg_{level}").children()][:-1]
        assert blocks[0][0].in_channels == channels
        expected = dilations.get(level, [1] * 5)
        assert [block[0].dilation[0] for block in blocks] == expected
        assert [block[0].padding[0] for block in blocks] == expected


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_maps_come_at_five_sizes(name: str) -> None:
    net = DGCNet(preset(name)).eval()
    image = torch.randn(1, 3, 240, 240, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        prediction = net(image, image.flip(3))
    assert [m.shape[1:] for m in prediction.maps] == [(2, s, s) for s in (15, 30, 60, 120, 240)]
    masks = {"dgc": [], "dgcm": [240]}.get(name, [15, 30, 60, 120, 240])
    assert [m.shape[1:] for m in prediction.logits] == [(1, s, s) for s in masks]


@pytest.mark.parametrize(
    "changes",
    [
        {"output": "displacement"},
        {"normalise_features": False},
        {"correlation": "local"},
    ],
)
def test_each_ablation_changes_the_map(changes: dict[str, object]) -> None:
    base = preset("dgc")
    config = replace(base, **changes)  # type: ignore[arg-type]
    torch.manual_seed(0)
    one = DGCNet(base).eval()
    other = DGCNet(config).eval()
    state = {k: v for k, v in one.state_dict().items() if v.shape == other.state_dict()[k].shape}
    other.load_state_dict(state, strict=False)
    generator = torch.Generator().manual_seed(3)
    source, target = torch.rand(2, 1, 512, 15, 15, generator=generator)
    with torch.no_grad():
        levels = [source] * 5, [target] * 5  # of which level 4 alone is read
        first, second = (net.decode(*levels, finest=15).maps[0] for net in (one, other))
    assert not torch.equal(first, second)


def test_displacement_is_added_to_the_identity() -> None:
    """With decoders that put out zero, the map is the identity at every level."""
    net = DGCNet(replace(preset("dgc"), output="displacement")).eval()
    for level in range(5):
        torch.nn.init.zeros_(net.get_submodule(f"reg_{level}.final").weight)
        torch.nn.init.zeros_(net.get_submodule(f"reg_{level}.final").bias)
    with torch.no_grad():
        maps = net(torch.zeros(1, 3, 240, 240), torch.zeros(1, 3, 240, 240)).maps
    for place in maps:
        size = place.shape[-1]
        expected = torch.linspace(-1, 1, size)
        torch.testing.assert_close(place[0, 0, 3], expected)
        torch.testing.assert_close(place[0, 1, :, 5], expected)


def test_without_dilation_keeps_the_parameters() -> None:
    plain = DGCNet(preset("dgc+no-dilation"))
    assert _count(plain) == 10_310_602
    assert all(m.dilation == (1, 1) for m in plain.modules() if isinstance(m, torch.nn.Conv2d))


def test_align_corners_modes_sample_at_their_points() -> None:
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


def test_a_window_decodes_as_the_whole_does() -> None:
    """Refining a part of a level gives the whole level's result, away from the part's border."""
    for config in (replace(SMALL, output="absolute"), SMALL, preset("dgcm-lite0")):
        net = DGCNet(config).eval()
        generator = torch.Generator().manual_seed(5)
        channels = config.level_channels[1]
        source, target = torch.randn(2, 1, channels, 120, 120, generator=generator)
        state = torch.cat([identity_map(120, False, source), torch.zeros(1, 1, 120, 120)], 1)
        window = (slice(20, 90), slice(30, 100))
        with torch.no_grad():
            whole = net.refine(1, net.warp(source, state), target, state)
            part = state[:, :, window[0], window[1]]
            seen = target[:, :, window[0], window[1]]
            found = net.refine(1, net.warp(source, part), seen, part, window)
        inner = slice(15, -15)
        expected = whole[:, :, window[0], window[1]][:, :, inner, inner]
        torch.testing.assert_close(found[:, :, inner, inner], expected, atol=1e-5, rtol=1e-4)


def test_evidence_is_the_maximum_over_pairs_of_scales() -> None:
    net = DGCNet(preset("dgcm-lite0"))
    net.correlation_scales = torch.tensor([3.0, 0.0])
    generator = torch.Generator().manual_seed(2)
    sizes = (240, 120, 60, 30, 15, 15, 30)
    source, target = ([torch.randn(1, 8, s, s, generator=generator) for s in sizes] for _ in "ab")
    evidence = net.correlate(source, target)
    unit = [[F.normalize(f[k][0], dim=0) for k in (4, 5)] for f in (source, target)]
    for xs, ys, xt, yt in ((0, 0, 0, 0), (3, 7, 11, 2), (14, 1, 5, 14)):
        products = [
            float(unit[0][k][:, ys, xs] @ unit[1][j][:, yt, xt])
            for k, j in ((0, 0), (1, 0), (0, 1))
        ]
        found = float(evidence[0, xs * 15 + ys, yt * 15 + xt])
        assert found == pytest.approx(3 * max(products), abs=1e-4)


def test_unknown_presets_and_ablations_are_refused() -> None:
    for ablation in ("flow", "local-correlation"):
        with pytest.raises(InputError, match=f"{ablation} is no ablation of dgcm-lite0"):
            preset(f"dgcm-lite0+{ablation}")
    with pytest.raises(InputError, match="dgcm-lite0"):
        preset("vgg")
