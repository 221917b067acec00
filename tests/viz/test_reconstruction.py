"""The figure of a reconstruction."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar
from multi_view import SIZE, K
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.camera import Camera
from dgc_pose.model import Model
from dgc_pose.viz.figure import save_figure
from dgc_pose.viz.reconstruction import frusta, plot_reconstruction


def a_model(views: int, points: int, name: str = "{}.jpg") -> Model:
    """Cameras on a quarter of a circle of radius 4 around the points."""
    poses = {}
    for i, angle in enumerate(np.linspace(-45, 45, views)):
        R = Rotation.from_euler("yx", (angle, 10), degrees=True).as_matrix()
        poses[name.format(i)] = np.c_[R, (0, 0, 4) - R @ (0, 0, 4)]
    cloud = np.random.default_rng(0).normal((0, 0, 4), 1, (points, 3))
    cameras = dict.fromkeys(poses, Camera(K, SIZE))
    return Model(Path(), cameras, poses, cloud, np.zeros((points, 3), np.uint8))


@pytest.mark.parametrize("count", [0, 500])
def test_cameras_and_points_from_above_and_from_the_front(count: int) -> None:
    """Each view has a frustum for each camera, the points are drawn, and all cameras lie within."""
    figure = plot_reconstruction(a_model(3, count, "folder/$a$ {}.jpg"))
    assert len(figure.axes) == 2
    figure.canvas.draw()
    for axes in figure.axes:
        (cameras,) = (part for part in axes.collections if isinstance(part, PolyCollection))
        places = np.concatenate([path.vertices for path in cameras.get_paths()])
        assert len(cameras.get_paths()) == len(np.unique(cameras.get_edgecolor(), axis=0)) == 3
        low, high = np.transpose([axes.get_xlim(), axes.get_ylim()])
        assert (low < places).all() and (places < high).all()
        assert axes.collections[0].get_offsets().shape == (count, 2)
        names = [text for text in axes.texts if text.get_visible()]
        assert {text.get_text() for text in names} <= {f"$a$ {i}.jpg" for i in range(3)}
        boxes = [text.get_window_extent() for text in names]
        assert 0 < len(boxes) and not any(
            box.count_overlaps(boxes[:i]) for i, box in enumerate(boxes)
        )


def test_a_frustum_has_the_centre_and_the_rays_of_the_corners() -> None:
    """Its corners are projected into the corners of the image, in whichever axes it is."""
    model = a_model(3, 0)
    cameras, axes = frusta([(model.cameras[name], pose) for name, pose in model.poses.items()])
    assert np.allclose(axes @ axes.T, np.eye(3)) and np.linalg.det(axes) == pytest.approx(-1)
    for camera, pose in zip(cameras @ axes, model.poses.values(), strict=True):
        assert np.allclose(pose[:, :3] @ camera[0] + pose[:, 3], 0, atol=1e-9)
        rays = camera[1:] @ pose[:, :3].T + pose[:, 3]
        assert np.allclose(np.linalg.norm(rays, axis=1), 1)
        pixels = rays @ K.T / rays[:, 2:]
        corners = np.multiply(SIZE, [(0, 0), (1, 0), (1, 1), (0, 1)]) - 0.5
        assert np.allclose(pixels[:, :2], corners)


def test_many_cameras_have_few_names() -> None:
    few = plot_reconstruction(a_model(3, 0)).axes[0].texts
    many = plot_reconstruction(a_model(40, 0)).axes[0].texts
    assert len(few) == 3 and 10 < len(many) <= 15


@pytest.mark.parametrize("size", [0.003, 1.0, 700.0])
def test_a_model_in_metres_has_a_scale_bar(size: float, tmp_path: Path) -> None:
    """Its length is 1, 2 or 5 times a power of ten, and an eighth to a quarter of the view."""
    model = a_model(3, 500)
    scaled = {name: np.c_[pose[:, :3], size * pose[:, 3]] for name, pose in model.poses.items()}
    model = replace(model, poses=scaled, points=size * model.points)
    metric = plot_reconstruction(model, "m")
    for axes in metric.axes:
        (bar,) = (part for part in axes.artists if isinstance(part, AnchoredSizeBar))
        (text,) = bar.txt_label.get_children()
        length, unit = text.get_text().split()
        assert unit == "m" and f"{float(length):e}"[:8] in ("1.000000", "2.000000", "5.000000")
        assert 0.1 < float(length) / np.ptp(axes.get_xlim()) <= 0.25
    save_figure(metric, tmp_path / "picture.png")
    assert not any(axes.artists for axes in plot_reconstruction(model).axes)
