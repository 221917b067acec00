"""SIFT where the map says, and tiles matched again."""

from __future__ import annotations

from collections.abc import Sequence

import dense_scene
import numpy as np

from dgc_pose.image import Image
from dgc_pose.matching import CorrespondenceMap, MatchingOptions
from dgc_pose.matching.sift import SiftMatcher
from dgc_pose.refinement.guide import places_in_image1
from dgc_pose.refinement.sift import match_sift
from dgc_pose.refinement.zoom import match_zoom


def test_sift_matches_lie_in_the_window_and_on_the_surface() -> None:
    first, second = (Image(pixels) for pixels in dense_scene.pictures())
    scene = dense_scene.true_map(error_px=1.0)
    found = match_sift(SiftMatcher(), first, second, scene, window_cells=4.0, ratio=0.85)
    cell = np.sqrt(320 * 240) / dense_scene.CELLS
    far = np.linalg.norm(found.points1 - places_in_image1(scene, found.points2), axis=1)
    assert len(found) > 100 and far.max() <= 4 * cell + 1e-6
    off = np.linalg.norm(found.points1 - dense_scene.places_in_image1(found.points2), axis=1)
    assert np.median(off) < 0.5 and (off < 2).mean() > 0.95
    # One match a key point of either image.
    assert len(np.unique(found.points2, axis=0)) == len(np.unique(found.points1, axis=0))


def test_sift_finds_more_where_it_is_led_than_where_it_is_not() -> None:
    """A texture of four equal quarters: every key point is there four times."""
    quarter = dense_scene.pictures()[0][:120, :160]
    tiled = Image(np.ascontiguousarray(np.tile(quarter, (2, 2, 1))))
    grid = dense_scene.grid(160, 160)
    same = dense_scene.make_map(grid, grid)
    led = match_sift(SiftMatcher(), tiled, tiled, same, window_cells=4.0, ratio=0.85)
    alone = SiftMatcher().match(tiled, tiled)
    assert len(led) > 4 * len(alone) and len(led) > 100
    assert np.abs(led.points1 - led.points2).max() < 1e-3


def test_sift_of_pictures_without_key_points() -> None:
    flat = Image(np.full((240, 320, 3), 90, np.uint8))
    textured = Image(dense_scene.pictures()[0])
    for pair in ((flat, textured), (textured, flat), (flat, flat)):
        found = match_sift(
            SiftMatcher(), *pair, dense_scene.true_map(), window_cells=4.0, ratio=0.85
        )
        assert len(found) == 0


class _Cropper(dense_scene.MapMatcher):
    """Maps each crop to its place in the other, which the pixels of both pictures name."""

    def __init__(self, scene: CorrespondenceMap, options: MatchingOptions) -> None:
        super().__init__(scene, options)
        self.crops: list[tuple[Image, Image]] = []

    def correspond_batch(self, pairs: Sequence[tuple[Image, Image]]) -> list[CorrespondenceMap]:
        self.crops += pairs
        return [self._true(*pair) for pair in pairs]

    def _true(self, first: Image, second: Image) -> CorrespondenceMap:
        left1, top1 = first.pixels[0, 0, :2].astype(float)
        left2, top2 = second.pixels[0, 0, :2].astype(float)
        axes = [(np.arange(20) + 0.5) * side / 20 - 0.5 for side in second.size]
        grid = np.stack(np.meshgrid(*axes), -1)
        places = 0.5 * (grid + (left2, top2)) + (20, 10) - (left1, top1)
        return CorrespondenceMap(
            places.astype(np.float32),
            grid.astype(np.float32),
            np.full((20, 20), 0.9, np.float32),
            first.size,
            second.size,
        )


def _coordinates(width: int, height: int) -> Image:
    """A picture whose red and green are x and y."""
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    return Image(np.stack([x, y, 0 * x], -1).astype(np.uint8))


def test_tiles_land_where_they_were_cut_from() -> None:
    """Image 1 shows image 2 at half its size, moved by (20, 10)."""
    size1, size2 = (180, 150), (250, 200)
    axes = [(np.arange(30) + 0.5) * side / 30 - 0.5 for side in size2]
    grid = np.stack(np.meshgrid(*axes), -1)
    matchability = np.full((30, 30), 0.9, np.float32)
    matchability[:10, 10:20] = 0.0  # one tile of nine that the map is not sure of
    scene = CorrespondenceMap(
        (0.5 * grid + (20, 10)).astype(np.float32), grid.astype(np.float32), matchability,
        size1, size2,
    )
    matcher = _Cropper(scene, MatchingOptions(matchability=0.5))
    found = match_zoom(matcher, _coordinates(*size1), _coordinates(*size2), scene, tiles=3)
    assert len(matcher.crops) == 8
    np.testing.assert_allclose(found.points1, 0.5 * found.points2 + (20, 10), atol=1e-3)
    # All of image 2 but the tile left out, which spans a third of it either way.
    inside = (found.points2 > (84, 0)).all(1) & (found.points2 < (166, 65)).all(1)
    assert not inside.any() and found.points2.min() < 10 and found.points2.max() > 240
    # A cell is some 83 by 66 pixels over 20 in image 2, and less than that in image 1.
    assert 0 < found.error_px < 2


def test_a_map_that_is_sure_of_nothing_has_no_tiles() -> None:
    scene = dense_scene.true_map()
    unsure = CorrespondenceMap(
        scene.map, scene.grid, np.zeros_like(scene.matchability), scene.size1, scene.size2
    )
    matcher = _Cropper(unsure, MatchingOptions())
    picture = _coordinates(256, 240)
    assert len(match_zoom(matcher, picture, picture, unsure, tiles=3)) == 0
    assert matcher.crops == []
