"""What the page is told of a pose, against the scene that the images are of."""

import base64
import io

import cv2
import dense_scene
import numpy as np
import pytest
from PIL import Image

from dgc_pose.cameras.camera import Camera
from dgc_pose.metrics import epipolar_residuals_px, rotation_error_deg, translation_error_deg
from dgc_pose.serve.estimator import Estimator, StoredImage


@pytest.fixture(scope="module")
def result(pictures, map_matcher):
    stored = [StoredImage(path, path) for path in pictures]
    request = {"kind": "k", "k1": dense_scene.K_TEXT}
    return Estimator(map_matcher, None).estimate(lambda text: None, *stored, request)


def decoded(url):
    return Image.open(io.BytesIO(base64.b64decode(url.split(",")[1])))


def test_a_pair_gives_its_pose_and_what_the_page_draws(result):
    assert result["pose"]["success"] is True
    assert rotation_error_deg(np.array(result["pose"]["R"]), dense_scene.R) < 0.1
    assert translation_error_deg(np.array(result["pose"]["t"]), dense_scene.T) < 0.5
    assert result["sizes"] == [[320, 240], [320, 240]]
    matches, F = result["matches"], np.array(result["F"])
    points, inlier = np.array(matches["points"]), np.array(matches["inlier"])
    assert len(points) <= 3000 and inlier.sum() > 100
    assert (np.diff(inlier.astype(int)) <= 0).all()  # inliers come first
    # The first few are spread over image 2.
    assert (np.ptp(points[:100, 2:], axis=0) > 0.6 * np.array(dense_scene.SIZE)).all()
    camera = Camera(dense_scene.K)
    E = dense_scene.K.T @ F @ dense_scene.K
    expected = epipolar_residuals_px(*np.split(points, 2, 1), camera, camera, E)
    np.testing.assert_allclose(matches["residual"], expected, atol=0.02)  # points are rounded
    assert decoded(result["map"]["matchability"]).size == (320, 240)


def test_the_map_is_sent_at_a_grid(result):
    sent = result["correspondences"]
    columns, rows = sent["columns"], sent["rows"]
    assert len(sent["points"]) == len(sent["matchability"]) == columns * rows <= 96**2
    x, y = (
        np.linspace(sent["first"][n], sent["last"][n], count)
        for n, count in enumerate((columns, rows))
    )
    expected = dense_scene.points_in_image1(np.stack(np.meshgrid(x, y), -1)).reshape(-1, 2)
    assert np.abs(np.array(sent["points"]) - expected).mean() < 0.3  # the map's error is 0.2


def test_the_warp_shows_image_2_where_it_is_opaque(result):
    warp = np.asarray(decoded(result["map"]["warp"]).convert("RGBA")).astype(float)
    opaque = cv2.erode((warp[..., 3] > 200).astype(np.uint8), np.ones((9, 9))) > 0
    assert opaque.mean() > 0.3
    image1, image2 = dense_scene.pictures()
    assert np.abs(warp[..., :3] - image2)[opaque].mean() < 12
    assert np.abs(warp[..., :3] - image1)[opaque].mean() > 20
