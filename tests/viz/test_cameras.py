import dense_scene
import numpy as np
import pytest

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.viz.cameras import draw_cameras
from dgc_pose.viz.figure import new_figure

CAMERA = Camera(dense_scene.K, dense_scene.SIZE)


@pytest.fixture
def axes():
    return new_figure(5, 5).add_subplot(projection="3d")


def drawn_points(axes):
    """The dots, back in camera 1's axes."""
    x, z, up = axes.collections[-1]._offsets3d
    return np.column_stack([x, -np.asarray(up), z])


def test_points_ahead_are_drawn_where_they_are(axes):
    rng = np.random.default_rng(0)
    points = rng.uniform((-1, -1, 4), (1, 1, 6), (200, 3))
    points[0] = np.nan
    points[1, 2] = -5
    points[2, 2] = 1000
    draw_cameras(axes, dense_scene.R, dense_scene.T, CAMERA, CAMERA, points)
    axes.figure.canvas.draw()
    shown = drawn_points(axes)
    assert 180 <= len(shown) <= 197
    assert all(np.nanmin(np.abs(points - point).max(1)) < 1e-9 for point in shown[::20])
    # The view is not stretched along any axis.
    spans = [np.ptp(limits) for limits in (axes.get_xlim(), axes.get_ylim(), axes.get_zlim())]
    assert np.asarray(axes._box_aspect) / spans == pytest.approx(axes._box_aspect[0] / spans[0])


def test_the_second_camera_stands_where_the_pose_says(axes):
    draw_cameras(axes, dense_scene.R, dense_scene.T, CAMERA, CAMERA, np.zeros((0, 3)))
    (baseline,) = axes.lines
    ends = np.array(baseline.get_data_3d()).T
    assert ends[0] == pytest.approx([0, 0, 0])
    x, y, z = -dense_scene.R.T @ dense_scene.T
    assert ends[1] == pytest.approx([x, z, -y])
    axes.figure.canvas.draw()


def test_flat_axes_are_refused():
    with pytest.raises(InputError, match="3d"):
        flat = new_figure(3, 3).subplots()
        draw_cameras(flat, np.eye(3), np.eye(3)[0], CAMERA, CAMERA, np.zeros((0, 3)))
