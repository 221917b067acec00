"""The network as a matcher: sizes, the half-pixel rule, rotations."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from map_nets import ShiftNet

from dgc_pose.errors import InputError
from dgc_pose.geometry.pixels import within
from dgc_pose.images.image import Image
from dgc_pose.matching import CorrespondenceMap, MatchingOptions, NetworkMatcher
from dgc_pose.matching.cache import image_cache
from dgc_pose.matching.dense import dense_map
from dgc_pose.matching.view import View
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.runtime.engine import DecodedMap
from dgc_pose.runtime.torch_engine import TorchEngine


def _image(width: int, height: int, seed: int = 0) -> Image:
    rng = np.random.default_rng(seed)
    blots = rng.integers(0, 256, (-(-height // 6), -(-width // 6), 3), dtype=np.uint8)
    return Image(cv2.resize(blots, (width, height), interpolation=cv2.INTER_CUBIC))


def _map(engine: TorchEngine, first: Image, second: Image) -> CorrespondenceMap:
    return dense_map(engine, first, second, image_cache())


@pytest.mark.parametrize("align_corners", [True, False])
def test_identity_maps_corners_to_corners_at_any_size(align_corners: bool) -> None:
    """The map that is the identity at 240 scales by the half-pixel rule to any pair of sizes."""
    engine = TorchEngine(ShiftNet(align_corners=align_corners))
    first, second = _image(1600, 1200), _image(320, 90)
    found = _map(engine, first, second)
    cells = np.arange(240)
    for points, size in ((found.map, first.size), (found.grid, second.size)):
        np.testing.assert_allclose(points[7, :, 0], (cells + 0.5) * size[0] / 240 - 0.5, atol=2e-3)
        np.testing.assert_allclose(points[:, 9, 1], (cells + 0.5) * size[1] / 240 - 0.5, atol=2e-3)
    assert found.map.dtype == found.grid.dtype == found.matchability.dtype == np.float32
    assert found.matchability.shape == (240, 240)


def test_a_mask_network_has_no_coarser_level() -> None:
    masked = NetworkMatcher(TorchEngine(DGCNet(preset("dgcm"))))
    assert masked.coarse(_image(100, 100), _image(100, 100)) is None
    with pytest.raises(InputError, match="finest"):
        NetworkMatcher(TorchEngine(DGCNet(preset("dgcm"))), MatchingOptions(finest=120))
    for name, value in (("finest", 100), ("aligned", "nothing")):
        with pytest.raises(InputError, match=name):
            MatchingOptions(**{name: value})  # type: ignore[arg-type]


def test_nothing_is_nan_whatever_the_network_says() -> None:
    matcher = NetworkMatcher(
        TorchEngine(ShiftNet(np.nan)), MatchingOptions(matchability=0.0, aligned="none")
    )
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
    found = _map(engine, upright, second)
    assert len(calls) == 2 and found.matchability.shape == (240, 240)
    # The identity between the whole of image 1 and the view of image 2.
    truth = (view2.to_view(found.grid) + 0.5) / view2.size * upright.size - 0.5
    shown = within(view2.to_view(found.grid), view2.size)
    np.testing.assert_allclose(found.map[shown], truth[shown], atol=0.8)
    assert (found.matchability[shown] > 0.8).all() and (found.matchability[~shown] == 0).all()
