"""Planes with a relief, by OpenCV's decomposition of their homographies."""

import cv2
import numpy as np
import pytest
from photos import drawn_photos

from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.training.synthesis.draw import Draw, seeded
from dgc_pose.training.synthesis.render.plane_pairs import RELIEFS, plane_views, render_plane_pair

SIDE = 120
SEEDS = range(6)


@pytest.fixture(scope="module")
def bank():
    return drawn_photos(12, 64).textures


def rendered(bank, seed, relief):
    return render_plane_pair(bank, SIDE, seeded(seed), relief)


def matches(pair):
    """The pixels of view 2 that view 1 sees, (n, 2), and where, (n, 2)."""
    y, x = np.nonzero(pair.visible[0].numpy())
    return np.column_stack((x, y)).astype(np.float64), pair.map[0].numpy()[y, x].astype(np.float64)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_flat_plane_has_another_pose_before_both_cameras(bank, seed):
    pair = rendered(bank, seed, 0.0)
    pixels2, pixels1 = matches(pair)
    K1, K2 = (K[0].double().numpy() for K in (pair.K1, pair.K2))
    points1, points2 = (
        cv2.undistortPoints(pixels[:, None], K, None)
        for pixels, K in ((pixels1, K1), (pixels2, K2))
    )
    H, _ = cv2.findHomography(points1, points2, 0)
    count, rotations, translations, normals = cv2.decomposeHomographyMat(H, np.eye(3))
    # OpenCV keeps the solutions whose plane is ahead of camera 1 at all of these points
    single = points1.astype(np.float32), points2.astype(np.float32)
    kept = cv2.filterHomographyDecompByVisibleRefpoints(rotations, normals, *single)
    R, t = pair.cam2_from_cam1[0, :, :3].numpy(), pair.cam2_from_cam1[0, :, 3].numpy()
    errors = sorted(
        max(rotation_error_deg(rotations[k], R), translation_error_deg(translations[k][:, 0], t))
        for k in kept.ravel()
    )
    assert count == 4 and len(errors) == 2
    assert errors[0] < 0.1 and errors[1] > 10


@pytest.mark.parametrize("relief", RELIEFS)
def test_the_relief_is_as_high_as_it_is_told(bank, relief):
    seed = 3
    views = plane_views(Draw(seeded(seed)), SIDE, bank, relief)
    pair = rendered(bank, seed, relief)
    y, x = np.mgrid[:SIDE, :SIDE]
    rays = np.column_stack((x.ravel(), y.ravel(), np.ones(SIDE**2)))
    points = rays @ np.linalg.inv(pair.K1[0].double().numpy()).T
    points *= pair.depth1[0].double().numpy().reshape(-1, 1)
    points = points[np.isfinite(points).all(1)]
    pose = views.first.rotation[0].double().numpy(), views.first.translation[0].double().numpy()
    heights = -((points - pose[1]) @ pose[0]) @ views.scene.axes[0, 0, 2].double().numpy()
    assert heights.min() > -1e-4
    assert heights.max() == pytest.approx(relief, abs=1e-4 + 0.1 * relief)
    flat = np.abs(heights) < 1e-4
    assert flat.mean() > 0.3 and flat.all() == (relief == 0)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_plane_fills_views_of_a_usual_camera_that_overlap(bank, seed):
    pair = rendered(bank, seed, 0.02)
    for K, depth in ((pair.K1, pair.depth1), (pair.K2, pair.depth2)):
        assert 40 <= np.degrees(2 * np.arctan(SIDE / 2 / float(K[0, 0, 0]))) <= 70
        assert depth.isfinite().float().mean() > 0.85
    assert pair.visible.float().mean() > 0.3
    pose = pair.cam2_from_cam1[0, :, :3].numpy()
    assert 15 <= np.degrees(np.arccos(pose[2, 2])) <= 60
