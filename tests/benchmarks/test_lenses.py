"""The lenses of rendered pairs, and what is seen through them, against pycolmap."""

import numpy as np
import pycolmap
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch.nn.functional import grid_sample, interpolate

from dgc_pose.benchmarks.lenses import LENSES, Lens
from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import estimate_pose
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.training.synthesis.options import SceneOptions
from dgc_pose.training.synthesis.render.bank import TextureBank
from dgc_pose.training.synthesis.render.rendered_pairs import render_pairs

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
    others = {"INVALID", "EQUIRECTANGULAR"}
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


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_the_pose_through_a_lens_is_the_pose(lens):
    """Points that pycolmap projects, with half a pixel of noise and a fifth of them wrong."""
    focal, side = lens.focal * 1024, 1024
    camera = Camera([[focal, 0, 500], [0, focal, 520], [0, 0, 1]], (side, side), lens.distortion)
    theirs = colmap_camera(lens, camera.K)
    random = np.random.default_rng(4)
    pixels1 = random.uniform(0, side - 1, (4000, 2))
    rays = np.column_stack([theirs.cam_from_img(pixels1 + 0.5), np.ones(len(pixels1))])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    R = Rotation.from_rotvec([0.1, 0.3, -0.1]).as_matrix()
    t = np.array([-0.8, 0.1, 0.6]) / np.linalg.norm([-0.8, 0.1, 0.6])
    points2 = rays * random.uniform(1, 4, (len(rays), 1)) @ R.T + 0.4 * t
    pixels2 = theirs.img_from_cam(points2) - 0.5
    rays2 = theirs.cam_from_img(pixels2 + 0.5)  # another where the model folds back from outside
    seen = (np.abs(rays2 - points2[:, :2] / points2[:, 2:]) < 1e-3).all(1) & (points2[:, 2] > 0)
    seen &= ((pixels2 > 0) & (pixels2 < side - 1)).all(1)
    pixels1, pixels2 = (
        pixels[seen][:1000] + random.normal(0, 0.5, (1000, 2)) for pixels in (pixels1, pixels2)
    )
    pixels2[:200] = random.uniform(0, side - 1, (200, 2))
    pose = estimate_pose(Matches(pixels1, pixels2, np.ones(1000), 0.5), camera, camera)
    assert pose.success, pose.reason
    assert rotation_error_deg(pose.R, R) < 0.1
    assert translation_error_deg(pose.t, t) < 0.15
