"""The dense map: sizes, the half-pixel rule, and the search of rotation and scale."""

from functools import cache
from types import SimpleNamespace

import cv2
import dense_scene
import numpy as np
import pytest
from map_nets import ShiftNet

from dgc_pose.geometry.pixels import within
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.image import Image, resize
from dgc_pose.matchers import load_engine
from dgc_pose.matching import CorrespondenceMap, MatchingOptions, NetworkMatcher
from dgc_pose.matching.dense import dense_map, search_views
from dgc_pose.matching.view import View
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.runtime.torch_engine import TorchEngine


def _image(width: int, height: int, seed: int = 0) -> Image:
    rng = np.random.default_rng(seed)
    blots = rng.integers(0, 256, (-(-height // 6), -(-width // 6), 3), dtype=np.uint8)
    return Image(cv2.resize(blots, (width, height), interpolation=cv2.INTER_CUBIC))


def _map(engine: TorchEngine, first: Image, second: Image) -> CorrespondenceMap:
    return dense_map(engine, first, second, ImageCache())


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


def test_nothing_is_nan_whatever_the_network_says() -> None:
    matcher = NetworkMatcher(TorchEngine(ShiftNet(np.nan)), MatchingOptions(aligned="none"))
    result = matcher.match(_image(100, 100), _image(100, 100))
    assert result.correspondence_map is not None
    assert np.isfinite(result.correspondence_map.map).all()
    assert len(result.matches) == 0


@cache
def _engine() -> TorchEngine:
    return load_engine("dgcm-lite0", device="cpu", runtime="torch")


@cache
def _scene() -> np.ndarray:
    return cv2.resize(dense_scene.pictures()[0], (640, 480))


def _window(side: float) -> np.ndarray:
    """The middle of the scene, at 320x240."""
    extent = (round(640 * side), round(480 * side))
    return resize(
        View.window(Image(_scene()), extent, (319.5, 239.5), 0.0, 1.0).pixels(), (320, 240)
    )


def test_equal_views_need_no_search() -> None:
    """And the copies of an image are made once for all its pairs."""
    image, cache = Image(_scene()), ImageCache()
    other = Image(image.pixels[8:, 5:].copy())
    assert search_views(_engine(), image, other, cache) is None
    made = cache.made
    assert made > 2
    assert search_views(_engine(), image, other, cache) is None
    assert cache.made == made


@pytest.mark.parametrize("size", [(1, 500), (3000, 300)])
@pytest.mark.parametrize("first", [True, False])
def test_a_thin_image_is_not_rotated(size: tuple[int, int], first: bool) -> None:
    """Copies of 1x500 rotated by 45 degrees would have 4 million pixels each."""
    thin, scene = Image(resize(_scene(), size)), Image(_scene())
    encoded: list[np.ndarray] = []
    engine = SimpleNamespace(native=lambda pixels, cells: encoded.append(pixels))
    pair = (thin, scene) if first else (scene, thin)
    assert search_views(engine, *pair, ImageCache()) is None  # type: ignore[arg-type]
    assert not encoded


@pytest.mark.parametrize("angle", [75.0, 190.0])
def test_a_rotation_is_found_and_undone(angle: float) -> None:
    """The map is given over image 2 as it is."""
    image = Image(_scene())
    turned = View.whole(image, angle)
    rotated = Image(turned.pixels())
    views = search_views(_engine(), image, rotated, ImageCache())
    assert views is not None
    assert views[0] == View.whole(image)
    assert abs((views[1].angle_deg + angle + 180) % 360 - 180) <= 20
    corners = views[1].to_view(np.array([[0, 0], rotated.size]))
    assert (corners > -2).all() and (corners < np.array(views[1].size) + 2).all()
    found = _map(_engine(), image, rotated)
    shown = within(turned.to_image(found.grid), image.size)
    off = np.linalg.norm(found.map - turned.to_image(found.grid), axis=-1)
    assert np.median(off[shown]) < 3 and (found.matchability[shown] > 0.5).mean() > 0.6
    assert (found.matchability[~shown] < 0.5).mean() > 0.9


@pytest.mark.parametrize("closer", [1, 2])
def test_a_part_is_found_in_the_whole(closer: int) -> None:
    """One image shows the middle third of the other."""
    images = [Image(resize(_scene(), (320, 240))), Image(_window(1 / 3))]
    first, second = images if closer == 2 else images[::-1]
    views = search_views(_engine(), first, second, ImageCache())
    assert views is not None
    wide, close = views if closer == 2 else views[::-1]
    assert close == View.whole(images[1])
    assert wide.centre == pytest.approx((159.5, 119.5), abs=25)
    extent = np.array(wide.size) / wide.scale
    assert (extent > (320 / 3.5, 240 / 3.5)).all() and (extent < (320, 240)).all()
    assert views[1].angle_deg == 0
    found = _map(_engine(), first, second)
    shown = within(views[1].to_view(found.grid), views[1].size)
    assert (~shown).any() == (closer == 1) and not found.matchability[~shown].any()
