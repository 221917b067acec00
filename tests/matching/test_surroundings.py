"""What surrounds the matches, on features that are drawn."""

from dataclasses import replace

import numpy as np

from dgc_pose.geometry.pixels import pixel_grid
from dgc_pose.images.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.surroundings import surroundings
from dgc_pose.matching.texture import Texture
from dgc_pose.matching.view import View
from dgc_pose.runtime.engine import NativeFeatures

SIDES, CELL, SHIFT = (60, 40), 8, 3  # columns and rows of stride 8, pixels of one, columns moved
SIZE = (SIDES[0] * CELL, SIDES[1] * CELL)


def _features(middle: np.ndarray) -> tuple[View, NativeFeatures]:
    unit = middle / np.linalg.norm(middle, axis=-1, keepdims=True)
    empty = np.zeros((1, 1, 1), np.float32)
    return View.whole(SIZE), NativeFeatures(empty, unit.astype(np.float32), empty, SIZE)


def _views(seed: int, inside: np.ndarray | None = None):
    """Features of two images, the second of which shows all `SHIFT` cells further to the left;
    outside of `inside` (rows, columns) bool it shows something else."""
    rng = np.random.default_rng(seed)
    first = rng.standard_normal((*SIDES[::-1], 32))
    second = np.roll(first, -SHIFT, 1)
    if inside is not None:
        second[~inside] = rng.standard_normal(second[~inside].shape)
    return _features(first), _features(second)


def _matches(inside: np.ndarray) -> Matches:
    """Matches at the middle of the cells of image 2 within `inside`."""
    cells = pixel_grid(SIDES)[inside]
    points2 = (cells + 0.5) * CELL - 0.5
    return Matches(points2 + (SHIFT * CELL, 0), points2, np.ones(len(cells)), error_px=1.0)


IMAGES = (Image(np.zeros((*SIZE[::-1], 3), np.uint8)),) * 2
WITH_TEXTURE = Texture(np.ones(SIZE[::-1], bool), SIZE)
INSIDE = np.zeros(SIDES[::-1], bool)
INSIDE[12:28, 20:40] = True


def test_what_goes_on_around_the_matches_is_as_alike_as_they_are():
    share = surroundings(IMAGES, _views(0), [WITH_TEXTURE] * 2, _matches(INSIDE))
    assert share is not None and 0.95 < share < 1.05


def test_of_two_places_that_have_a_part_alike_the_rest_is_not():
    views = _views(0, np.pad(INSIDE[1:-1, 1:-1], 1))
    share = surroundings(IMAGES, views, [WITH_TEXTURE] * 2, _matches(INSIDE))
    assert share is not None and share < 0.25
    swapped = _matches(INSIDE)
    swapped = Matches(swapped.points2, swapped.points1, swapped.confidence, error_px=1.0)
    assert abs(surroundings(IMAGES, views[::-1], [WITH_TEXTURE] * 2, swapped) - share) < 0.1


def test_what_has_no_texture_does_not_count():
    """The same two places, of which all but the part is smooth in image 2, or in both."""
    smooth = [
        Texture(np.kron(np.roll(INSIDE, shift, 1), np.ones((CELL, CELL), bool)), SIZE)
        for shift in (SHIFT, 0)
    ]
    assert surroundings(IMAGES, _views(0, INSIDE), smooth, _matches(INSIDE)) is None
    share = surroundings(IMAGES, _views(0, INSIDE), [WITH_TEXTURE, smooth[1]], _matches(INSIDE))
    assert share is not None and share < 0.25


def test_what_is_masked_does_not_count():
    """The same two places, of which a mask leaves the part alone in image 2, or in both."""
    black = IMAGES[0].pixels
    masked = [
        Image(black, mask=np.kron(np.roll(INSIDE, shift, 1), np.ones((CELL, CELL), bool)))
        for shift in (SHIFT, 0)
    ]
    views, textures = _views(0, INSIDE), [WITH_TEXTURE] * 2
    for images in ((IMAGES[0], masked[1]), (masked[0], masked[1])):
        assert surroundings(images, views, textures, _matches(INSIDE)) is None


def test_what_a_turned_view_pads_an_image_with_does_not_count():
    """Views that show a margin around both images, in which features are alike."""
    rng = np.random.default_rng(2)
    middle = rng.standard_normal((*SIDES[::-1], 32))
    inner = (SIZE[0] - 16 * CELL, SIZE[1] - 16 * CELL)
    view = replace(View.whole(inner), size=SIZE)
    _, features = _features(middle)
    image = Image(np.zeros((*inner[::-1], 3), np.uint8))
    points = pixel_grid((SIDES[0] - 16, SIDES[1] - 16)).reshape(-1, 2) * CELL + (CELL - 1) / 2
    matches = Matches(points, points, np.ones(len(points)), error_px=1.0)
    texture = Texture(np.ones(inner[::-1], bool), inner)
    ends = (image, image), [(view, features)] * 2, [texture] * 2
    assert surroundings(*ends, matches) is None


def test_matches_everywhere_and_no_matches_have_no_surroundings():
    assert (
        surroundings(IMAGES, _views(0), [WITH_TEXTURE] * 2, _matches(np.ones_like(INSIDE))) is None
    )
    assert (
        surroundings(IMAGES, _views(0), [WITH_TEXTURE] * 2, _matches(np.zeros_like(INSIDE))) is None
    )


def test_it_repeats():
    views, matches = _views(1, INSIDE), _matches(INSIDE)
    values = [surroundings(IMAGES, views, [WITH_TEXTURE] * 2, matches) for _ in range(2)]
    assert values[0] == values[1]
