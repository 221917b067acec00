"""The network as a matcher: sizes, the half-pixel rule, the way back."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from dgc_pose.errors import InputError, WeightsError
from dgc_pose.image import Image
from dgc_pose.matching import DenseMatcher, MatchingOptions, load_matcher
from dgc_pose.matching.dense import resize
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet


def _constant_net(shift: float = 0.0, *, align_corners: bool = True) -> DGCNet:
    """A net that maps every cell to itself, shifted in x by a normalised amount."""
    config = replace(preset("dgcm-lite"), output="displacement", align_corners=align_corners)
    net = DGCNet(config).eval()
    for level in range(5):
        final = net.get_submodule(f"reg_{level}.final")
        torch.nn.init.zeros_(final.weight)
        torch.nn.init.zeros_(final.bias)
    with torch.no_grad():
        net.get_submodule("reg_0.final").bias[0] = shift
    return net


def _image(width: int, height: int, seed: int = 0) -> Image:
    rng = np.random.default_rng(seed)
    return Image(rng.integers(0, 256, (height, width, 3), dtype=np.uint8))


@pytest.mark.parametrize("align_corners", [True, False])
def test_identity_maps_corners_to_corners_at_any_size(align_corners: bool) -> None:
    """The map that is the identity at 240 scales by the half-pixel rule to any pair of sizes."""
    matcher = DenseMatcher(_constant_net(align_corners=align_corners))
    first, second = _image(1600, 1200), _image(320, 90)
    found = matcher.correspond(first, second)
    cells = np.arange(240)
    for places, size in ((found.map, first.size), (found.grid, second.size)):
        np.testing.assert_allclose(places[7, :, 0], (cells + 0.5) * size[0] / 240 - 0.5, atol=2e-3)
        np.testing.assert_allclose(places[:, 9, 1], (cells + 0.5) * size[1] / 240 - 0.5, atol=2e-3)
    assert found.map.dtype == found.grid.dtype == found.matchability.dtype == np.float32
    assert found.matchability.shape == (240, 240) and found.cycle is None


def test_a_shift_of_the_map_is_a_shift_in_pixels() -> None:
    """2 / 240 of the normalised width, edges at -1 and +1, is one cell: 1600 / 240 pixels."""
    matcher = DenseMatcher(_constant_net(2 / 240, align_corners=False))
    found = matcher.correspond(_image(1600, 1200), _image(1600, 1200))
    shift = np.broadcast_to((1600 / 240, 0), found.map.shape)
    np.testing.assert_allclose(found.map - found.grid, shift, atol=3e-3)


def test_cycle_measures_the_way_back() -> None:
    """There by +1 cell and back by +1 cell ends 2 cells off, in pixels of image 2."""
    options = MatchingOptions(cycle_px=5.0, matchability=0.0)
    matcher = DenseMatcher(_constant_net(2 / 240, align_corners=False), options)
    found = matcher.correspond(_image(480, 480), _image(960, 480))
    assert found.cycle is not None
    np.testing.assert_allclose(found.cycle[:, :200], 2 * 960 / 240, atol=0.05)
    assert len(matcher.select(found)) == 0
    still = DenseMatcher(_constant_net(0.0), options)
    found = still.correspond(_image(480, 480), _image(960, 480))
    np.testing.assert_allclose(found.cycle, 0, atol=0.05)
    assert len(still.select(found)) > 1000


def test_a_coarser_finest_level_is_the_network_s_own_coarser_map() -> None:
    """The same numbers as the full pass makes on the way, on that level's grid."""
    torch.manual_seed(0)
    net = DGCNet(preset("dgcm-lite")).eval()
    first, second = _image(480, 360, 1), _image(320, 240, 2)
    full = DenseMatcher(net)
    with torch.no_grad():
        inputs = full._input(first.pixels), full._input(second.pixels)
        prediction = net(*inputs)
    for level, cells in ((1, 120), (2, 60)):
        options = MatchingOptions(finest=cells, roll_share=0.0, cycle_px=10.0)  # type: ignore[arg-type]
        found = DenseMatcher(net, options).correspond(first, second)
        wanted = prediction.maps[-1 - level][0].movedim(0, -1).numpy()  # edges at -1 and +1
        wanted = (wanted + 1) * first.size / np.array(2) - 0.5
        np.testing.assert_allclose(found.map, wanted, atol=0.01)
        step = np.divide(second.size, cells)
        np.testing.assert_allclose(found.grid[0, 0], step / 2 - 0.5, atol=1e-4)
        np.testing.assert_allclose(found.grid[2, 1] - found.grid[1, 0], step, atol=1e-4)
        assert found.map.shape == (cells, cells, 2) and found.matchability.shape == (cells, cells)
        assert found.cycle is not None and found.cycle.shape == (cells, cells)


def test_the_way_back_at_a_coarser_level() -> None:
    """There and back by 1/60 of the width each: 2/60 of image 2's width off, at any level."""
    options = MatchingOptions(cycle_px=5.0, finest=60)
    net = _constant_net(align_corners=False)
    with torch.no_grad():
        net.get_submodule("reg_2.final").bias[0] = 2 / 60
    found = DenseMatcher(net, options).correspond(_image(480, 480), _image(960, 480))
    assert found.cycle is not None
    np.testing.assert_allclose(found.cycle[:, :50], 2 * 960 / 60, atol=0.05)


def test_a_mask_network_has_no_coarser_level() -> None:
    with pytest.raises(InputError, match="finest"):
        DenseMatcher(DGCNet(preset("dgcm")), MatchingOptions(finest=120))
    with pytest.raises(InputError, match="finest"):
        MatchingOptions(finest=100)  # type: ignore[arg-type]


def test_the_same_images_give_the_same_matches() -> None:
    torch.manual_seed(0)
    matcher = DenseMatcher(DGCNet(preset("dgcm-lite")), MatchingOptions(matchability=0.0))
    pair = _image(200, 150, 1), _image(180, 240, 2)
    one, two = matcher.match(*pair), matcher.match(*pair)
    assert len(one) > 0
    assert np.array_equal(one.points1, two.points1)
    assert np.array_equal(one.confidence, two.confidence)


def test_nothing_is_nan_whatever_the_network_says() -> None:
    net = _constant_net()
    with torch.no_grad():
        net.get_submodule("reg_0.final").bias.fill_(torch.nan)
    matcher = DenseMatcher(net, MatchingOptions(matchability=0.0))
    found = matcher.correspond(_image(100, 100), _image(100, 100))
    assert np.isfinite(found.map).all()
    assert len(matcher.select(found)) == 0


def test_a_roll_is_found_and_undone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a net that matches only its own orientation, the turned image's map is turned back, and
    no other roll is decoded."""
    upright = _image(300, 200)
    matcher = DenseMatcher(_constant_net())

    def matchability(prediction: object) -> np.ndarray:
        seen = (decoded[-1] + roll) % 4 == 0
        return np.full((240, 240), 0.9 if seen else 0.1, np.float32)

    decoded: list[int] = []
    at_roll = matcher._at_roll

    def remembered(pairs: object, turns: int, cache: object) -> object:
        decoded.append(turns)
        return at_roll(pairs, turns, cache)  # type: ignore[arg-type]

    monkeypatch.setattr(matcher, "_at_roll", remembered)
    monkeypatch.setattr("dgc_pose.matching.dense._matchability", matchability)
    for roll in range(4):
        turned = Image(np.rot90(upright.pixels, roll).copy())
        decoded.clear()
        found = matcher.correspond(upright, turned)
        assert decoded == ([0] if roll == 0 else [0, -roll % 4])
        assert found.matchability.mean() > 0.8
        # Each cell of the turned image must map to the place whose colour it shows.
        for row, column in ((30, 50), (200, 120), (3, 236)):
            x, y = found.map[row, column]
            u, v = found.grid[row, column]
            back = np.rot90(np.arange(200 * 300).reshape(200, 300), roll)[round(v), round(u)]
            assert abs(back % 300 - x) <= 1.6 and abs(back // 300 - y) <= 1.6


def test_resize_keeps_places() -> None:
    """A ramp stays the ramp of the half-pixel rule, shrunk, enlarged, or each along one axis."""
    height, width = 300, 480
    x = np.arange(width) * 0.5
    ramp = np.repeat(np.repeat(x[None, :, None], height, 0), 3, 2)
    for size in ((240, 240), (960, 600), (240, 600), (960, 100)):
        found = resize(ramp.astype(np.float32), size)
        assert found.shape == (size[1], size[0], 3)
        expected = ((np.arange(size[0]) + 0.5) * width / size[0] - 0.5) * 0.5
        inner = slice(4, -4)
        np.testing.assert_allclose(found[5, inner, 0], expected[inner], atol=1e-3)


def test_shrinking_averages() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (960, 960, 3), dtype=np.uint8)
    found = resize(noise, (240, 240)).astype(float)
    expected = noise.reshape(240, 4, 240, 4, 3).mean((1, 3))
    assert np.abs(found - expected).max() <= 1
    assert cv2.resize(noise, (240, 240)).std() > 2 * found.std()  # plain bilinear would alias


def test_weights_and_devices_that_are_not_there() -> None:
    with pytest.raises(WeightsError, match="no such weights"):
        load_matcher("nowhere.safetensors")
    with pytest.raises(InputError, match="device"):
        load_matcher(device="quantum")
    if not torch.cuda.is_available():
        with pytest.raises(InputError, match="CUDA"):
            load_matcher(device="cuda")


def test_a_batch_gives_what_its_pairs_give_alone() -> None:
    """Of several sizes, with the way back, and with those turned that match badly upright."""
    torch.manual_seed(0)
    options = MatchingOptions(matchability=0.0, cycle_px=5.0)
    matcher = DenseMatcher(DGCNet(preset("dgcm-lite")), options)
    pairs = [
        (_image(200, 150, 1), _image(180, 240, 2)),
        (_image(100, 100, 3), _image(300, 100, 4)),
        (_image(90, 120, 5), _image(160, 120, 6)),
    ]
    means = [float(matcher.correspond(*pair).matchability.mean()) for pair in pairs]
    weakest = replace(options, roll_share=(sorted(means)[0] + sorted(means)[1]) / 2)
    matcher = DenseMatcher(matcher.net, weakest)
    for pair, found in zip(pairs, matcher.correspond_batch(pairs), strict=True):
        alone = matcher.correspond(*pair)
        np.testing.assert_allclose(found.map, alone.map, atol=0.02)
        np.testing.assert_allclose(found.matchability, alone.matchability, atol=1e-4)
        assert found.cycle is not None and alone.cycle is not None
        np.testing.assert_allclose(found.cycle, alone.cycle, atol=0.05)
        assert (found.size1, found.size2) == (pair[0].size, pair[1].size)
