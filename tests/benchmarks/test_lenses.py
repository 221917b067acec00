"""The lenses of rendered pairs, and what is seen through them, against pycolmap."""

import numpy as np
import pycolmap
import pytest
import torch
from torch.nn.functional import grid_sample, interpolate

from dgc_pose.benchmarks.lenses import LENSES, Lens
from dgc_pose.cameras.camera import Camera
from dgc_pose.synthesis.options import SceneOptions
from dgc_pose.synthesis.render.bank import TextureBank
from dgc_pose.synthesis.render.rendered_pairs import render_pairs

SIDE = 64


@pytest.fixture(scope="module")
def smooth() -> TextureBank:
    noise = torch.rand(6, 3, 5, 5, generator=torch.Generator().manual_seed(1))
    return TextureBank.from_photos(interpolate(noise, (96, 96), mode="bicubic").clamp(0, 1))


def colmap_camera(lens: Lens, K: np.ndarray) -> pycolmap.Camera:
    """An independent camera, in COLMAP's own pixels."""
    camera = pycolmap.Camera.create_from_model_name(0, lens.model, K[0, 0], SIDE, SIDE)
    parameters = np.array(camera.params)
    parameters[camera.principal_point_idxs()] = K[:2, 2] + 0.5
    parameters[camera.extra_params_idxs()] = lens.coefficients
    camera.params = parameters.tolist()
    return camera


def test_there_is_a_lens_of_every_model():
    others = {"INVALID", "SIMPLE_PINHOLE", "EQUIRECTANGULAR"}
    assert set(LENSES) | others == set(pycolmap.CameraModelId.__members__)


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_a_lens_can_be_undone_in_the_whole_image(lens):
    focal = lens.focal * 1000
    camera = Camera([[focal, 0, 499.5], [0, focal, 499.5], [0, 0, 1]], None, lens.distortion)
    # The principal point of rendered cameras is up to 5 % of the side off the middle.
    edge = np.stack(np.meshgrid(*[np.linspace(-50, 1050, 45)] * 2), axis=-1).reshape(-1, 2)
    rays = camera.normalise(edge)
    assert np.isfinite(rays).all()
    np.testing.assert_allclose(camera.project(rays), edge, atol=0.01)


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_views_are_what_colmap_projects(smooth, lens):
    """Points along pycolmap's rays, moved by the pose and projected by pycolmap, lie where the map
    says; and they look alike there."""
    scenes = SceneOptions(min_overlap=0.4, shading=0.0, log_scale=0.1)
    views = render_pairs(smooth, 1, SIDE, torch.Generator().manual_seed(3), scenes, lens.before)
    depth = views.depth2[0].double().numpy()
    assert views.depth1.isfinite().all() and np.isfinite(depth).all()

    pixels = np.stack(np.mgrid[:SIDE, :SIDE][::-1], axis=-1).reshape(-1, 2)
    camera1, camera2 = (colmap_camera(lens, K[0].double().numpy()) for K in (views.K1, views.K2))
    rays = camera2.cam_from_img(pixels + 0.5)
    points2 = np.column_stack([rays, np.ones(len(rays))]) * depth.reshape(-1, 1)
    pose = views.cam2_from_cam1[0].double().numpy()
    points1 = (points2 - pose[:, 3]) @ pose[:, :3]
    visible = views.visible[0].reshape(-1).numpy()
    assert visible.mean() > 0.3
    expected = camera1.img_from_cam(points1[visible]) - 0.5
    assert np.abs(views.map[0].reshape(-1, 2).numpy()[visible] - expected).max() < 2e-3

    warped = grid_sample(views.image1, views.map / (SIDE - 1) * 2 - 1, align_corners=True)
    difference = (warped - views.image2).abs().mean(1)
    assert difference[views.visible].median() < 0.01
