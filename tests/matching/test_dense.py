"""The network as a matcher: sizes, the half-pixel rule, the cycle error, rotations."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from map_nets import ShiftNet

from dgc_pose.errors import InputError
from dgc_pose.geometry.pixels import within
from dgc_pose.images.image import Image
from dgc_pose.matching import CorrespondenceMap, DenseMatcher, MatchingOptions
from dgc_pose.matching.view import View
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.runtime.engine import DecodedMap
from dgc_pose.runtime.torch_engine import TorchEngine


def _image(width: int, height: int, seed: int = 0) -> Image:
    rng = np.random.default_rng(seed)
    blots = rng.integers(0, 256, (-(-height // 6), -(-width // 6), 3), dtype=np.uint8)
    return Image(cv2.resize(blots, (width, height), interpolation=cv2.INTER_CUBIC))


def _map(matcher: DenseMatcher, first: Image, second: Image) -> CorrespondenceMap:
    return matcher.correspondence_map(first, second)


@pytest.mark.parametrize("align_corners", [True, False])
def test_identity_maps_corners_to_corners_at_any_size(align_corners: bool) -> None:
    """The map that is the identity at 240 scales by the half-pixel rule to any pair of sizes."""
    matcher = DenseMatcher(TorchEngine(ShiftNet(align_corners=align_corners)))
    first, second = _image(1600, 1200), _image(320, 90)
    found = _map(matcher, first, second)
    cells = np.arange(240)
    for points, size in ((found.map, first.size), (found.grid, second.size)):
        np.testing.assert_allclose(points[7, :, 0], (cells + 0.5) * size[0] / 240 - 0.5, atol=2e-3)
        np.testing.assert_allclose(points[:, 9, 1], (cells + 0.5) * size[1] / 240 - 0.5, atol=2e-3)
    assert found.map.dtype == found.grid.dtype == found.matchability.dtype == np.float32
    assert found.matchability.shape == (240, 240) and found.cycle is None


def test_the_cycle_error_is_the_distance_after_both_maps() -> None:
    """Forward by +1 cell and back by +1 cell is an error of 2 cells, in pixels of image 2."""
    options = MatchingOptions(cycle_px=5.0, matchability=0.0)
    matcher = DenseMatcher(TorchEngine(ShiftNet(2 / 240, align_corners=False)), options)
    pair = _image(480, 480), _image(960, 480)
    result = matcher.match(*pair)
    found = result.correspondence_map
    assert found is not None and found.cycle is not None
    np.testing.assert_allclose(found.cycle[:, :200], 2 * 960 / 240, atol=0.05)
    assert len(result.matches) == 0
    still = DenseMatcher(TorchEngine(ShiftNet(0.0)), options)
    result = still.match(*pair)
    assert result.correspondence_map is not None
    np.testing.assert_allclose(result.correspondence_map.cycle, 0, atol=0.05)
    assert len(result.matches) > 1000


def test_a_mask_network_has_no_coarser_level() -> None:
    masked = DenseMatcher(TorchEngine(DGCNet(preset("dgcm"))))
    assert masked.coarse_map(_image(100, 100), _image(100, 100)) is None
    with pytest.raises(InputError, match="finest"):
        DenseMatcher(TorchEngine(DGCNet(preset("dgcm"))), MatchingOptions(finest=120))
    with pytest.raises(InputError, match="finest"):
        MatchingOptions(finest=100)  # type: ignore[arg-type]


def test_nothing_is_nan_whatever_the_network_says() -> None:
    matcher = DenseMatcher(TorchEngine(ShiftNet(np.nan)), MatchingOptions(matchability=0.0))
    result = matcher.match(_image(100, 100), _image(100, 100))
    assert result.correspondence_map is not None
    assert np.isfinite(result.correspondence_map.map).all()
    assert len(result.matches) == 0


@pytest.mark.parametrize("angle", [90.0, 180.0, 270.0, 40.0])
def test_a_rotation_is_found_and_undone(angle: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a net that matches upright images alone: the map of the view that the search suggests is
    given over image 2 as it is."""
    upright = _image(300, 200)
    rotated = View.whole(upright.size, angle)
    second = Image(rotated.cut(upright.pixels))
    view2 = View.whole(second.size, -angle)
    suggested = (View.whole(upright.size), view2)
    monkeypatch.setattr("dgc_pose.matching.dense.search_views", lambda *given: suggested)
    engine = TorchEngine(ShiftNet(align_corners=False))
    decode, calls = engine.decode, []

    def decode_upright_alone(*given: Any) -> DecodedMap:
        calls.append(given)
        value = np.float32(0.1 if len(calls) == 1 else 0.9)
        return replace(decode(*given), matchability=np.full((240, 240), value))

    monkeypatch.setattr(engine, "decode", decode_upright_alone)
    found = _map(DenseMatcher(engine), upright, second)
    assert len(calls) == 2 and found.matchability.shape == (240, 240)
    # The identity between the whole of image 1 and the view of image 2.
    truth = (view2.to_view(found.grid) + 0.5) / view2.size * upright.size - 0.5
    shown = within(view2.to_view(found.grid), view2.size)
    np.testing.assert_allclose(found.map[shown], truth[shown], atol=0.8)
    assert (found.matchability[shown] > 0.8).all() and (found.matchability[~shown] == 0).all()
