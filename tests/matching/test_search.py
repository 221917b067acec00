"""The search of rotation and scale, on pictures whose rotation and scale are known."""

from functools import cache
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from dgc_pose.images.image import Image, resize
from dgc_pose.matching.cache import ImageCache
from dgc_pose.matching.view import View
from dgc_pose.matching.view_search import search_views
from dgc_pose.runtime.load import load_engine
from dgc_pose.runtime.torch_engine import TorchEngine


@cache
def _engine() -> TorchEngine:
    return load_engine("dgcm-lite0", device="cpu", runtime="torch")


@cache
def _scene() -> np.ndarray:
    """Rectangles of all sizes: something to see at every scale, and upright edges."""
    rng = np.random.default_rng(3)
    pixels = np.full((480, 640, 3), 128, np.uint8)
    for side in np.geomspace(200, 6, 700):
        x, y = rng.uniform((-40, -40), (640, 480))
        w, h = side * rng.uniform(0.4, 1.6, 2)
        colour = tuple(int(c) for c in rng.integers(0, 256, 3))
        cv2.rectangle(pixels, (int(x), int(y)), (int(x + w), int(y + h)), colour, -1)
    return pixels


def _window(side: float) -> np.ndarray:
    """The middle of the scene, at 320x240."""
    view = View.window((round(640 * side), round(480 * side)), (319.5, 239.5), 0.0, 1.0)
    return resize(view.cut(_scene()), (320, 240))


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
def test_a_rotation_is_found(angle: float) -> None:
    image = Image(_scene())
    rotated = Image(View.whole(image.size, angle).cut(image.pixels))
    views = search_views(_engine(), image, rotated, ImageCache())
    assert views is not None
    assert views[0] == View.whole(image.size)
    assert abs((views[1].angle_deg + angle + 180) % 360 - 180) <= 20
    corners = views[1].to_view(np.array([[0, 0], rotated.size]))
    assert (corners > -2).all() and (corners < np.array(views[1].size) + 2).all()


@pytest.mark.parametrize("closer", [1, 2])
def test_a_part_is_found_in_the_whole(closer: int) -> None:
    """One image shows the middle third of the other."""
    images = [Image(resize(_scene(), (320, 240))), Image(_window(1 / 3))]
    first, second = images if closer == 2 else images[::-1]
    views = search_views(_engine(), first, second, ImageCache())
    assert views is not None
    wide, close = views if closer == 2 else views[::-1]
    assert close == View.whole((320, 240))
    assert wide.centre == pytest.approx((159.5, 119.5), abs=25)
    extent = np.array(wide.size) / wide.scale
    assert (extent > (320 / 3.5, 240 / 3.5)).all() and (extent < (320, 240)).all()
    assert views[1].angle_deg == 0
