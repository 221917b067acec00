"""No match without structure, whatever makes the matches; and what surrounds them, as drawn."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import dense_scene
import numpy as np
import pytest

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.geometry.pixels import pixel_grid
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.key_points import SiftMatcher
from dgc_pose.matching.texture import (
    LONG_SIDE,
    Texture,
    context_ratio,
    noise_level,
    structured,
    texture,
)
from dgc_pose.matching.view import View
from dgc_pose.runtime.engine import NativeFeatures

SIZE = (320, 240)
BLANKS = ("gradient", "noise", "stripes", "sky")


def _blank(kind: str) -> Image:
    """An image without structure for a pose, after JPEG compression like a camera's."""
    rng = np.random.default_rng([0, BLANKS.index(kind)])
    width, height = SIZE
    y, x = np.mgrid[:height, :width] / width
    angle = rng.uniform(0, np.pi)
    along = np.cos(angle) * x + np.sin(angle) * y
    if kind == "gradient":
        grey = rng.uniform(0, 128) + rng.uniform(10, 127) * (1 + along) / 2
    elif kind == "noise":
        grey = 128 + rng.uniform(5, 60) * rng.standard_normal((height, width))
    elif kind == "stripes":
        wave = np.sin(2 * np.pi * rng.uniform(8, 60) * along)
        grey = 128 + rng.uniform(20, 120) * (wave if rng.random() < 0.5 else np.sign(wave))
    else:  # a saturated sky over a smooth field
        horizon = height * rng.uniform(0.3, 0.7) + 0.05 * width * (x - 0.5)
        grey = np.where(y * width < horizon, 255.0, rng.uniform(20, 120) + 40 * y)
    tint = rng.uniform(0.8, 1.0, 3)
    pixels = (grey[..., None] * tint).clip(0, 255).round().astype(np.uint8)
    quality = int(rng.integers(60, 100))
    encoded = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return Image(np.ascontiguousarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR)))


@pytest.mark.parametrize("source", ["map", "sift"])
def test_no_source_gives_a_match_or_a_pose(source: str) -> None:
    """A map that is sure of every pixel of any two images, and key points."""
    dense = dense_scene.true_map()
    sure = replace(dense, matchability=np.ones_like(dense.matchability))
    matcher = SiftMatcher() if source == "sift" else dense_scene.MapMatcher(sure)
    camera = Camera(dense_scene.K, SIZE)
    for kind in BLANKS:
        matches = matcher.match(_blank(kind), dense_scene.images()[0]).matches
        assert len(matches) < 20, (kind, len(matches))
        pose = estimate_pose(matches, camera, camera, EstimationOptions(runs=1, iterations=50))
        assert pose.R is None and not pose.success, kind


def test_fine_and_coarse_texture_is_structure_at_any_contrast_above_the_noise() -> None:
    rng = np.random.default_rng(0)
    for blur, contrast in ((1.5, 60), (4, 60), (12, 60), (4, 8)):
        smooth = cv2.GaussianBlur(rng.standard_normal((240, 320)), (0, 0), blur)
        grey = 128 + contrast * smooth / smooth.std() + rng.standard_normal((240, 320))
        grey = np.rint(grey).clip(0, 255).astype(np.float32)
        assert structured(grey)[10:-10, 10:-10].mean() > 0.8


def test_an_edge_has_none_and_its_end_has() -> None:
    grey = np.full((120, 160), 60, np.float32)
    grey[40:, 50:110] = 180  # a bar whose top lies in the image
    frame = np.ones_like(grey, dtype=bool)
    frame[3:-3, 3:-3] = False
    grey[frame] = np.random.default_rng(0).integers(0, 256, frame.sum())  # so there is no bar
    mask = structured(grey)
    assert not mask[80:95, 25:135].any()  # along the bar's sides
    assert mask[38:43, 48:53].all() and mask[38:43, 108:113].all()  # its corners


@pytest.mark.parametrize("colour", [0, 255, 90])
def test_bars_at_the_border_are_no_scene(colour: int) -> None:
    """Not their edges, nor the corners of a frame, sharp or smeared by compression."""
    picture = dense_scene.pictures()[0]
    framed = np.full_like(picture, colour)
    framed[40:-40, 30:-30] = picture[40:-40, 30:-30]
    encoded = cv2.imencode(".jpg", framed, [cv2.IMWRITE_JPEG_QUALITY, 70])[1]
    for pixels in (framed, cv2.imdecode(encoded, cv2.IMREAD_COLOR)):
        mask = texture(Image(np.ascontiguousarray(pixels))).mask
        assert not mask[:40].any() and not mask[-40:].any()
        assert not mask[:, :30].any() and not mask[:, -30:].any()
        assert mask[60:-60, 50:-50].mean() > 0.6


def test_points_are_looked_up_on_images_of_any_size() -> None:
    small = dense_scene.pictures()[0]
    image = Image(cv2.resize(small, (4 * SIZE[0], 4 * SIZE[1])))
    found = texture(image)
    assert max(found.mask.shape) == LONG_SIDE
    points = np.array([[640.0, 480], [-3, 5], [np.nan, 3], [np.inf, 1], [1e12, 0], [0, 0]])
    assert found.at(points).tolist() == [True, False, False, False, False, False]
    for size in ((1, 1), (3, 200), (8, 8)):  # too small for any
        assert not texture(Image(np.ascontiguousarray(small[: size[0], : size[1]]))).mask.any()


SIDES, CELL, SHIFT = (60, 40), 8, 3  # columns and rows of stride 8, pixels of one, columns moved
EXTENT = (SIDES[0] * CELL, SIDES[1] * CELL)
BLACK = Image(np.zeros((*EXTENT[::-1], 3), np.uint8))


def _features(middle: np.ndarray) -> NativeFeatures:
    unit = middle / np.linalg.norm(middle, axis=-1, keepdims=True)
    empty = np.zeros((1, 1, 1), np.float32)
    return NativeFeatures(empty, unit.astype(np.float32), empty)


def _views(seed: int, inside: np.ndarray | None = None, images: Sequence[Image] = (BLACK, BLACK)):
    """Features of two images, the second of which shows all `SHIFT` cells further to the left;
    outside of `inside` (rows, columns) bool it shows something else."""
    rng = np.random.default_rng(seed)
    first = rng.standard_normal((*SIDES[::-1], 32))
    second = np.roll(first, -SHIFT, 1)
    if inside is not None:
        second[~inside] = rng.standard_normal(second[~inside].shape)
    return [(View.whole(of), _features(k)) for of, k in zip(images, (first, second), strict=True)]


def _matches(inside: np.ndarray) -> Matches:
    """Matches at the middle of the cells of image 2 within `inside`."""
    cells = pixel_grid(SIDES)[inside]
    points2 = (cells + 0.5) * CELL - 0.5
    return Matches(points2 + (SHIFT * CELL, 0), points2, np.ones(len(cells)), error_px=1.0)


WITH_TEXTURE = Texture(np.ones(EXTENT[::-1], bool), EXTENT)
INSIDE = np.zeros(SIDES[::-1], bool)
INSIDE[12:28, 20:40] = True


def test_surroundings_are_as_alike_as_the_matches_unless_only_a_part_is_shared():
    share = context_ratio(_views(0), [WITH_TEXTURE] * 2, _matches(INSIDE))
    assert share is not None and 0.95 < share < 1.05
    views = _views(0, np.pad(INSIDE[1:-1, 1:-1], 1))
    share = context_ratio(views, [WITH_TEXTURE] * 2, _matches(INSIDE))
    assert share is not None and share < 0.25
    swapped = context_ratio(views[::-1], [WITH_TEXTURE] * 2, _matches(INSIDE).swapped())
    assert swapped == pytest.approx(share, abs=0.1)
    for inside in (np.ones_like(INSIDE), np.zeros_like(INSIDE)):  # nothing is around
        assert context_ratio(_views(0), [WITH_TEXTURE] * 2, _matches(inside)) is None


def test_what_has_no_texture_or_is_masked_does_not_count():
    """The same two places, of which all but the part is smooth in image 2, or masked."""
    shown = [np.kron(np.roll(INSIDE, n, 1), np.ones((CELL, CELL), bool)) for n in (SHIFT, 0)]
    smooth, masked = [Texture(of, EXTENT) for of in shown], Image(BLACK.pixels, mask=shown[1])
    assert context_ratio(_views(0, INSIDE), smooth, _matches(INSIDE)) is None
    share = context_ratio(_views(0, INSIDE), [WITH_TEXTURE, smooth[1]], _matches(INSIDE))
    assert share is not None and share < 0.25
    views = _views(0, INSIDE, (BLACK, masked))
    assert context_ratio(views, [WITH_TEXTURE] * 2, _matches(INSIDE)) is None


def test_what_a_turned_view_pads_an_image_with_does_not_count():
    """Views that show a margin around both images, in which features are alike."""
    rng = np.random.default_rng(2)
    middle = rng.standard_normal((*SIDES[::-1], 32))
    inner = (EXTENT[0] - 16 * CELL, EXTENT[1] - 16 * CELL)
    view = replace(View.whole(Image(np.zeros((*inner[::-1], 3), np.uint8))), size=EXTENT)
    points = pixel_grid((SIDES[0] - 16, SIDES[1] - 16)).reshape(-1, 2) * CELL + (CELL - 1) / 2
    matches = Matches(points, points, np.ones(len(points)), error_px=1.0)
    texture = Texture(np.ones(inner[::-1], bool), inner)
    assert context_ratio([(view, _features(middle))] * 2, [texture] * 2, matches) is None


def test_the_noise_level_is_that_of_the_noise() -> None:
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:200, :300]
    for sigma in (1.0, 4.0, 15.0):
        ramp = 100 + 0.3 * x - 0.2 * y + sigma * rng.standard_normal((200, 300))
        grey = np.rint(ramp).astype(np.float32)
        assert noise_level(grey) == pytest.approx(sigma, rel=0.05)
