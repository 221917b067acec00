"""Likely cells of stride 16, by belief propagation written out, and cells near epipolar lines."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.camera import Camera, TwoViews
from dgc_pose.geometry.epipolar import sampson_distance, skew
from dgc_pose.images.image import Image
from dgc_pose.matching.cell_consensus import EpipolarBand, likely_cells, propagate
from dgc_pose.matching.view import View
from dgc_pose.runtime.engine import NativeFeatures


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


def test_it_is_belief_propagation_over_the_candidates() -> None:
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


def test_cells_that_are_not_allowed_are_never_likely_while_there_are_others() -> None:
    source, target = _random(0, 5, 6), _random(1, 4, 7)
    scales = np.array([8.0, 10.0], np.float32)
    allowed = np.random.default_rng(2).random((28, 30)) < 0.3
    allowed[:, [3, 11, 20]] = True
    guided = (~allowed).argmax(1)[:, None]  # the first that is not allowed

    def likely(among: np.ndarray | None) -> np.ndarray:
        return likely_cells(source, target, guided, scales, similar=5, likely=3, allowed=among)

    assert np.take_along_axis(allowed, likely(allowed), 1).all()
    assert not np.take_along_axis(allowed, likely(None), 1).all()
    np.testing.assert_array_equal(likely(np.ones_like(allowed)), likely(None))


CAMERA1 = Camera(np.array([[500.0, 0, 318], [0, 500, 242], [0, 0, 1]]))
CAMERA2 = Camera(np.array([[350.0, 0, 205], [0, 350, 148], [0, 0, 1]]))
HYPOTHESIS = TwoViews(
    CAMERA1,
    CAMERA2,
    Rotation.from_euler("yx", [20, -8], degrees=True).as_matrix(),
    np.array([-0.8, 0.0, 0.6]),
)
IMAGE1, IMAGE2 = (Image(np.zeros((*size[::-1], 3), np.uint8)) for size in ((640, 480), (400, 300)))
VIEWS = [
    (View.whole(IMAGE1), View.whole(IMAGE2)),
    # A window, and a whole image that is rotated and half as large.
    (View.window(IMAGE1, (300, 220), (280.5, 190.5), 0.0, 1.0), View.whole(IMAGE2, 30.0, 0.5)),
]


def _distances(views: tuple[View, View], stride: int) -> np.ndarray:
    """Sampson distances (n, m) of the centres of the target's and the source's cells, in cells."""
    centres, sides = [], []
    cells = [(10 * 16 // stride, 7 * 16 // stride), (8 * 16 // stride, 6 * 16 // stride)]
    for view, camera, (columns, rows) in zip(views, (CAMERA1, CAMERA2), cells, strict=True):
        step = np.divide(view.size, (columns, rows))
        grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 2)
        seen = (grid + 0.5) * step - 0.5 - view.matrix[:, 2]
        pixels = np.linalg.solve(view.matrix[:, :2], seen.T).T
        centres.append((pixels - camera.K[:2, 2]) / camera.K[0, 0])
        sides.append(math.sqrt(step.prod()) / view.scale / camera.K[0, 0])
    E = skew(HYPOTHESIS.t) @ HYPOTHESIS.R
    table = [
        sampson_distance(centres[0], np.tile(point, (len(centres[0]), 1)), E)
        for point in centres[1]
    ]
    return np.array(table) / np.mean(sides)


@pytest.mark.parametrize("views", VIEWS, ids=["whole", "window"])
@pytest.mark.parametrize("stride", [16, 8])
def test_cells_may_match_within_a_cell_of_their_lines(
    views: tuple[View, View], stride: int
) -> None:
    features = _random(0, 7, 10), _random(0, 6, 8)
    band = EpipolarBand(HYPOTHESIS, *zip(views, features, strict=True), children=stride == 8)
    allowed, distances = band.all(), _distances(views, stride)
    assert allowed.shape == distances.shape and 0.02 < allowed.mean() < 0.6
    told = np.abs(distances - 1) > 1e-3
    assert np.array_equal(allowed[told], distances[told] < 1)
