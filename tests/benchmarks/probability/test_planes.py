"""Planes with a relief, by OpenCV's decomposition of their homographies."""

import cv2
import numpy as np
import pytest
from textures import drawn_photos

from dgc_pose.benchmarks.probability.planes import RELIEFS, plane_pair
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.training.draw import Draw
from dgc_pose.training.views import pixel_grid

SIDE = 120
SEEDS = range(6)


@pytest.fixture(scope="module")
def photos():
    return drawn_photos(12, 64)


def rendered(photos, seed, relief):
    return plane_pair(photos, SIDE, Draw("cpu", seed), relief)


def K(cameras):
    fx, fy, cx, cy = cameras.K[0].double().tolist()
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def matches(pair):
    """The pixels of the plane in view 2 that view 1 sees, (n, 2), and where, (n, 2)."""
    y, x = np.nonzero((pair.maps.valid & (pair.depth2 < 10))[0].numpy())
    return np.column_stack((x, y)).astype(np.float64), pair.maps.map[0].numpy()[y, x].astype(float)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_flat_plane_has_another_pose_before_both_cameras(photos, seed):
    """And fills views of a usual camera, which overlap."""
    pair = rendered(photos, seed, 0.0)
    pixels2, pixels1 = matches(pair)
    K1, K2 = K(pair.source), K(pair.target)
    points1, points2 = (
        cv2.undistortPoints(pixels[:, None], matrix, None)
        for pixels, matrix in ((pixels1, K1), (pixels2, K2))
    )
    H, _ = cv2.findHomography(points1, points2, 0)
    count, rotations, translations, normals = cv2.decomposeHomographyMat(H, np.eye(3))
    # OpenCV keeps the solutions whose plane is ahead of camera 1 at all of these points
    single = points1.astype(np.float32), points2.astype(np.float32)
    kept = cv2.filterHomographyDecompByVisibleRefpoints(rotations, normals, *single)
    pose = pair.target.seen_by(pair.source).pose[0].numpy()
    R, t = pose[:, :3], pose[:, 3]
    errors = sorted(
        max(rotation_error_deg(rotations[k], R), translation_error_deg(translations[k][:, 0], t))
        for k in kept.ravel()
    )
    assert count == 4 and len(errors) == 2
    assert errors[0] < 0.1 and errors[1] > 10
    for camera, depth in ((pair.source, pair.depth1), (pair.target, pair.depth2)):
        assert 40 <= np.degrees(2 * np.arctan(SIDE / 2 / float(camera.K[0, 0]))) <= 70
        assert (depth < 10).float().mean() > 0.85
    assert pair.maps.valid.float().mean() > 0.3
    assert 15 <= np.degrees(np.arccos(float(pose[2, 2]))) <= 60


@pytest.mark.parametrize("relief", RELIEFS[::3])
def test_the_relief_is_as_high_as_it_is_told(photos, relief):
    """The plane is z = 0 of the world, seen from z < 0."""
    pair = rendered(photos, 3, relief)
    pixels = pixel_grid((SIDE, SIDE), pair.depth1.device)[None]
    points = pair.source.unproject(pixels, pair.depth1)[0].view(-1, 3).double().numpy()
    heights = -points[np.abs(points[:, :2]).max(1) < 0.9, 2]
    assert heights.min() > -1e-4
    assert heights.max() == pytest.approx(relief, abs=1e-4 + 0.1 * relief)
    flat = np.abs(heights) < 1e-4
    assert flat.mean() > 0.3 and flat.all() == (relief == 0)
