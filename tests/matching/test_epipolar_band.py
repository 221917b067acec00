"""The cells near epipolar lines, against a loop over pairs of cells in double precision."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.camera import Camera, TwoViews
from dgc_pose.geometry.epipolar import sampson_distance, skew
from dgc_pose.matching.epipolar_band import EpipolarBand
from dgc_pose.matching.view import View
from dgc_pose.runtime.engine import NativeFeatures

CAMERA1 = Camera(np.array([[500.0, 0, 318], [0, 500, 242], [0, 0, 1]]))
CAMERA2 = Camera(np.array([[350.0, 0, 205], [0, 350, 148], [0, 0, 1]]))
HYPOTHESIS = TwoViews(
    CAMERA1,
    CAMERA2,
    Rotation.from_euler("yx", [20, -8], degrees=True).as_matrix(),
    np.array([-0.8, 0.0, 0.6]),
)
VIEWS = [
    (View.whole((640, 480)), View.whole((400, 300))),
    # A window, and a whole image that is rotated and half as large.
    (View.window((300, 220), (280.5, 190.5), 0.0, 1.0), View.whole((400, 300), 30.0, 0.5)),
]


def _features(view: View, columns: int, rows: int) -> NativeFeatures:
    shapes = [(k * rows, k * columns, 1) for k in (1, 2, 4)]
    return NativeFeatures(*(np.zeros(shape, np.float32) for shape in shapes), view.size)


def _distances(views: tuple[View, View], stride: int) -> np.ndarray:
    """Sampson distances (n, m) of the centres of the target's and the source's cells, in cells."""
    centres, sides = [], []
    cells = [(10 * 16 // stride, 7 * 16 // stride), (8 * 16 // stride, 6 * 16 // stride)]
    for view, camera, (columns, rows) in zip(views, (CAMERA1, CAMERA2), cells, strict=True):
        width, height = view.size
        image = []
        for row in range(rows):
            for column in range(columns):
                x, y = (column + 0.5) * width / columns - 0.5, (row + 0.5) * height / rows - 0.5
                pixel = np.linalg.solve(view.matrix[:, :2], (x, y) - view.matrix[:, 2])
                image.append(np.linalg.solve(camera.K, [*pixel, 1])[:2])
        centres.append(np.array(image))
        side = math.sqrt(width / columns * height / rows) / view.scale
        sides.append(side / camera.K[0, 0])
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
    source, target = _features(views[0], 10, 7), _features(views[1], 8, 6)
    seen = (source, views[0]), (target, views[1])
    band = EpipolarBand(HYPOTHESIS, *seen, children=stride == 8)
    allowed, distances = band.all(), _distances(views, stride)
    assert allowed.shape == distances.shape and 0.02 < allowed.mean() < 0.6
    told = np.abs(distances - 1) > 1e-3
    assert np.array_equal(allowed[told], distances[told] < 1)
