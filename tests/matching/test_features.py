"""The encoder's features at native resolution: likely cells of stride 16, by belief propagation
written out; cells near epipolar lines; matches."""

import math

import cv2
import dense_scene
import numpy as np
import pytest

from dgc_pose.cameras.camera import Camera, TwoViews
from dgc_pose.geometry.epipolar import sampson_distance
from dgc_pose.geometry.pixels import rescale, within
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.image import Image
from dgc_pose.matchers import load_engine
from dgc_pose.matches import Matches
from dgc_pose.matching.cell_consensus import EpipolarBand, likely_cells, propagate
from dgc_pose.matching.features import (
    MOST_HYPOTHESES,
    common_views,
    equal_scales,
    feature_matches,
    mutual_neighbours,
)
from dgc_pose.matching.view import View
from dgc_pose.runtime.engine import NativeFeatures
from dgc_pose.runtime.torch_engine import TorchEngine


@pytest.fixture(scope="module")
def engine() -> TorchEngine:
    return load_engine("dgcm-lite0", device="cpu", runtime="torch")


def _unit(values: np.ndarray) -> np.ndarray:
    return values / np.linalg.norm(values, axis=-1, keepdims=True)


def _features(coarse: np.ndarray, middle: np.ndarray) -> NativeFeatures:
    rows, columns = coarse.shape[:2]
    fine = np.zeros((4 * rows, 4 * columns, 1), np.float32)
    return NativeFeatures(_unit(coarse), _unit(middle), fine)


def _random(seed: int, rows: int, columns: int) -> NativeFeatures:
    rng = np.random.default_rng(seed)
    return _features(
        *(rng.standard_normal((k * rows, k * columns, 12), np.float32) for k in (1, 2))
    )


def _picture(width: int, height: int) -> np.ndarray:
    noise = np.random.default_rng(0).integers(0, 256, (height // 8, width // 8, 3), np.uint8)
    return cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)


@pytest.mark.parametrize(
    "size1, size2, scale, expected",
    [
        ((1600, 1200), (1200, 1600), 1.0, (0.5, 0.5)),
        ((450, 300), (320, 240), 1.0, (16 / 9, 16 / 9)),  # to the long side at most
        ((1600, 1200), (320, 240), 5.0, (0.4, 2.0)),  # small at the common scale
    ],
)
def test_factors_make_the_scales_equal(
    size1: tuple[int, int], size2: tuple[int, int], scale: float, expected: tuple[float, float]
) -> None:
    found = equal_scales(size1, size2, scale, 800)
    assert found == pytest.approx(expected)
    assert found[0] * scale == pytest.approx(found[1])


def test_with_all_cells_as_candidates_it_is_the_full_mutual_search() -> None:
    """Among the cells near the epipolar lines of a hypothesis."""
    source, target = _random(0, 3, 4), _random(1, 5, 3)
    every = np.tile(np.arange(12), (15, 1))
    full = source.middle.reshape(-1, 12).astype(float) @ target.middle.reshape(-1, 12).T
    sizes = (48, 64, 3), (80, 48, 3)
    views = (View.whole(Image(np.zeros(size, np.uint8))) for size in sizes)
    seen = zip(views, (source, target), strict=True)
    camera = Camera(np.array([[60.0, 0, 30], [0, 60, 30], [0, 0, 1]]))
    turned = TwoViews(camera, camera, dense_scene.R, dense_scene.T)
    band = EpipolarBand(turned, *seen, children=True)
    full[~band.all().T] = -np.inf
    cells1, cells2, cosine = mutual_neighbours(source, target, every, band)
    expected = {
        (int(full[:, j].argmax()), j)
        for j in range(full.shape[1])
        if int(full[int(full[:, j].argmax())].argmax()) == j and full[:, j].max() > -np.inf
    }
    assert len(expected) > 5
    index1, index2 = cells1 @ (1, 8), cells2 @ (1, 6)
    found = list(zip(index1.tolist(), index2.tolist(), strict=True))
    assert set(found) == expected and len(found) == len(expected)
    np.testing.assert_allclose(cosine, full[index1, index2], atol=1e-5)


@pytest.mark.parametrize("angle", [0.0, 270.0, 150.0])
def test_a_rotated_picture_matches_itself(engine: TorchEngine, angle: float) -> None:
    """Image 2 is image 1 rotated; the map shows the rotation, with an error of 10 pixels."""
    pixels = _picture(192, 160)
    rotated = View.whole(Image(pixels), angle)
    second = rotated.pixels()
    grid = dense_scene.grid(60, 60, rotated.size)
    sizes = (192, 160), rotated.size
    guide = dense_scene.make_map(rotated.to_image(grid) + 10, grid, sizes, 0.9)
    cache = ImageCache()
    views = common_views(engine, cache, Image(pixels), Image(second), guide, 192)
    (found,) = feature_matches(engine, cache, guide, views)
    off = found.points1 - rotated.to_image(found.points2)
    if angle % 90 == 0:
        assert len(found) > 200
        assert np.median(np.abs(off)) < 0.5 and (np.abs(off).max(1) < 3).mean() > 0.9
        # The error is that of a quarter of a cell of stride 4, at the original's own size.
        assert found.error_px == pytest.approx(1.0, rel=1e-6)
    else:  # resampled, and with cells of the border
        assert (np.abs(off).max(1) < 3).sum() > 30
        assert within(found.points2, rotated.size).all()


def test_matches_near_the_lines_of_a_hypothesis_are_near_them(engine: TorchEngine) -> None:
    """Whatever the map says, and of a wrong hypothesis near wrong lines."""
    first, second = dense_scene.images()
    guide = dense_scene.noise_map()
    guide.matchability[:] = 0.0
    camera = Camera(dense_scene.K, dense_scene.SIZE)
    true, wrong = (
        TwoViews(camera, camera, dense_scene.R, t) for t in (dense_scene.T, np.array([0.0, 1, 0]))
    )

    cache = ImageCache()

    def guided(hypotheses: list[TwoViews]) -> list[Matches]:
        views = common_views(engine, cache, first, second, guide)
        return feature_matches(engine, cache, guide, views, hypotheses)

    near = guided([true, wrong])[4:]
    for matches, views in zip(near, (true, wrong), strict=True):
        points = camera.normalise(matches.points1), camera.normalise(matches.points2)
        off = dense_scene.K[0, 0] * sampson_distance(*points, views.E)
        # A cell of stride 8 is 4 pixels, as features are of the pictures twice as large.
        assert len(matches) > 100 and np.median(off) < 4 and np.percentile(off, 95) < 8
    errors = [
        np.abs(dense_scene.points_in_image1(matches.points2) - matches.points1).max(1)
        for matches in near
    ]
    assert (errors[0] < 3).mean() > 2 * (errors[1] < 3).mean()
    (alone,) = guided([true])[4:]
    np.testing.assert_array_equal(alone.points1, near[0].points1)
    assert len(guided([])) == 4
    assert len(guided(9 * [true])) == 4 + MOST_HYPOTHESES


@pytest.mark.parametrize(("narrowed", "axis"), [(0, 1), (1, 0)])
def test_a_squeezed_picture_matches_itself_once_the_other_is_squeezed(
    engine: TorchEngine, narrowed: int, axis: int
) -> None:
    """A picture and one of half its width or height: of the search's pairs of pictures that with
    the other one squeezed likewise has most matches, and they are true."""
    whole = _picture(384, 320)
    size = (192, 320) if axis == 0 else (384, 160)
    pictures = [whole, whole]
    pictures[narrowed] = cv2.resize(whole, size, interpolation=cv2.INTER_AREA)
    sizes = tuple((pixels.shape[1], pixels.shape[0]) for pixels in pictures)
    grid = dense_scene.grid(60, 60, sizes[1])
    guide = dense_scene.make_map(rescale(grid, sizes[1], sizes[0]), grid, sizes, 0.0)
    images = [Image(pixels) for pixels in pictures]
    cache = ImageCache()
    views = common_views(engine, cache, *images, guide)
    every = feature_matches(engine, cache, guide, views, [])
    assert len(every) == 4
    counts = []
    for matches in every:
        true = rescale(matches.points2, sizes[1], sizes[0])
        counts.append((np.abs(matches.points1 - true).max(1) < 4).sum())
    # The axes, of each the pictures. The pictures become alike, too, if the squeezed one is
    # squeezed along its other axis.
    alike = [2 * along + number for along, number in ((axis, 1 - narrowed), (1 - axis, narrowed))]
    assert int(np.argmax(counts)) in alike and max(counts) > 200


def test_likely_cells_are_found_by_belief_propagation() -> None:
    rng = np.random.default_rng(0)
    rows, columns, count, width = 3, 4, 5, 6  # width: columns of the source
    candidates = rng.integers(0, 30, (rows * columns, count))
    candidates[0] += 600  # so far that it agrees with no other
    scores = rng.normal(0, 2, (rows * columns, count))
    beliefs = scores - np.log(np.exp(scores).sum(1, keepdims=True))
    for _ in range(4):
        total = scores.copy()
        for y, x in np.ndindex(rows, columns):
            for v, u in np.ndindex(rows, columns):
                if (dy := v - y, dx := u - x) == (0, 0) or max(abs(dy), abs(dx)) > 1:
                    continue
                for k in range(count):
                    cy, cx = divmod(int(candidates[y * columns + x, k]), width)
                    message = 0.01
                    for j in range(count):
                        oy, ox = divmod(int(candidates[v * columns + u, j]), width)
                        squared = (cy + dy - oy) ** 2 + (cx + dx - ox) ** 2
                        gauss = math.exp(-squared / (2 * 1.4**2)) / (2 * math.pi * 1.4**2)
                        message += gauss * math.exp(beliefs[v * columns + u, j])
                    total[y * columns + x, k] += 0.4 * math.log(message)
        beliefs = total - np.log(np.exp(total).sum(1, keepdims=True))
    found = propagate(candidates, scores, width, (rows, columns))
    np.testing.assert_allclose(found, beliefs, atol=1e-4)


@pytest.mark.parametrize("levels", [1, 2])
def test_a_cell_is_found_by_its_neighbours(levels: int) -> None:
    """Image 2 is image 1 moved by a cell, but one cell of it looks like another one far away."""
    source = _random(0, 8, 10)
    middle = np.roll(source.middle, -2, 1)
    coarse = np.roll(source.coarse, -1, 1)
    coarse[4, 4] = 0.6 * source.coarse[4, 5] + 0.8 * source.coarse[0, 0]
    middle[8:10, 8:10] = 0.6 * source.middle[8:10, 10:12] + 0.8 * source.middle[:2, :2]
    target = _features(coarse, middle)
    scales = np.array([8.0, 10.0], np.float32)[:levels]
    nothing = np.zeros((80, 0), np.int64)
    found = likely_cells(source, target, nothing, scales, similar=6, likely=1).reshape(8, 10)
    index = np.arange(80).reshape(8, 10)
    assert np.array_equal(found[:, :9], index[:, 1:])
    alone = (source.coarse.reshape(80, 12) @ target.coarse[4, 4]).argmax()
    assert alone == 0 and found[4, 4] == 45
