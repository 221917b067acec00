"""Focal lengths of many pairs as one number: against Gaussian arithmetic, and drawn errors."""

from dataclasses import replace

import numpy as np
import pytest

from dgc_pose.batch.pooling import (
    CameraFit,
    by_image,
    pool,
    pooled_fit,
    write_cameras,
)
from dgc_pose.batch.rows import PairRow
from dgc_pose.cameras.calibration import read_calibration
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation import RelativePose

PRIOR, CENTRE, LENS = 0.4, 5.0, 0.1
SIZE = (100, 80)
K = np.array([[110.0, 0, 49.5], [0, 110, 39.5], [0, 0, 1]])


def _fit(value, std, weight=1.0):
    return CameraFit(np.array([value]), np.array([[std**2]]), weight)


def _pooled(fits, images):
    (value,), (std,) = pooled_fit(fits, np.array([PRIOR]), images)
    return float(value), float(std)


def test_parameters_that_are_correlated():
    """Equal fits of four pairs: four times the information of the matches, and that of the prior.
    In the first axis the matches say nothing."""
    prior = np.array([PRIOR, 8.0, 8.0])
    sines = np.array([[1, 0.2, 0], [-0.2, 1, 0.5], [0.1, -0.5, 1]])
    axes = np.linalg.qr(sines)[0]
    of_matches = (axes * [0.0, 40, 900]) @ axes.T / np.outer(prior, prior)
    covariance = np.linalg.inv(of_matches + np.diag(prior**-2))
    true = np.array([0.01, 0.3, -0.2])
    value = covariance @ of_matches @ true
    pooled, std = pooled_fit([CameraFit(value, covariance)] * 4, prior, 8)
    together = np.linalg.inv(4 * of_matches + np.diag(prior**-2))
    np.testing.assert_allclose(pooled, together @ (4 * of_matches @ true), rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(std, np.sqrt(np.diag(together)), rtol=1e-3)


@pytest.mark.parametrize("outlier", [0.5, -1.2])
def test_outliers_do_not_move_it(outlier):
    right = [_fit(0.1 + offset, 0.01) for offset in np.linspace(-0.01, 0.01, 9)]
    wrong = [_fit(outlier, 0.005), _fit(outlier, 0.005), _fit(outlier - 0.2, 0.001, weight=0.01)]
    value, std = _pooled(right + wrong, 24)
    assert abs(value - 0.1) < 0.004 and std < 0.02


def test_errors_of_an_image_are_shared_by_its_pairs():
    """Ten pairs of five images count as two and a half."""
    fits = [_fit(0.0, 0.01)] * 10
    assert _pooled(fits, 20)[1] == pytest.approx(0.01 / 10**0.5, rel=1e-3)
    assert _pooled(fits, 5)[1] == pytest.approx(0.01 / 2.5**0.5, rel=1e-3)
    assert _pooled(fits, 1)[1] == pytest.approx(0.01, rel=1e-3)


def test_scatter_widens():
    """Eight fits two deviations away: each of the weight w = 1 / (1 + 4 / 2.385^2), and 4 times
    the variance that they state."""
    fits = [_fit(0.02 * sign, 0.01) for sign in (-1, 1) * 4]
    value, std = _pooled(fits, 16)
    weight = 1 / (1 + 4 / 2.385**2)
    assert abs(value) < 1e-4
    assert std == pytest.approx(0.02 / (8 * weight) ** 0.5, rel=0.01)


def _camera(identity):
    return Camera(
        K,
        SIZE,
        focal_std=PRIOR,
        centre_std=CENTRE,
        lens_std=LENS,
        focal_source="exif",
        identity=identity,
    )


def _pair(name1, name2, focal1, focal2, std=0.01):
    """A pair that tells focal lengths, the principal point (51.5, 39.5), and the lens."""
    lens = Distortion("RADIAL", (0.05, -0.1))
    first, second = (
        Camera(np.array([focal, focal, 51.5, 39.5]), SIZE, lens) for focal in (focal1, focal2)
    )
    covariance = np.diag([std**2, 0.25, 0.25, 1e-4, 1e-4, 1e-4] * 2)
    pose = RelativePose(
        *("ok", "a pose", np.ones(9, bool), 9),
        camera1=first,
        camera2=second,
        camera_covariance=covariance,
        probability=1.0,
    )
    return PairRow(name1, name2, "ok", "a pose", pose)


def test_each_camera_has_its_pairs():
    """One of two images, one of an image alone, one that no pair tells, and one that is exact."""
    cameras = {"a": _camera("x"), "b": _camera("x"), "c": _camera(None), "d": _camera(None)}
    exact = {"focal_std": 0.0, "centre_std": 0.0, "lens_std": 0.0, "focal_source": "given"}
    cameras["e"] = replace(_camera("y"), **exact)
    pairs = [
        _pair("a", "b", 121, 121),
        _pair("a", "c", 121, 99),
        _pair("c", "b", 99, 121),
        _pair("a", "d", 121, 300, std=0.39),
        replace(_pair("a", "c", 500, 500), pose=None),
    ]
    listed = pool(cameras, pairs)
    pooled = by_image(listed)
    assert [tuple(one.cameras) for one in listed] == [("a", "b"), ("c",), ("d",)]
    assert [one.pairs for one in listed] == [3, 2, 0]
    assert pooled["a"].focal == pooled["b"].focal == pytest.approx(121, rel=1e-3)
    assert pooled["c"].focal == pytest.approx(99, rel=1e-3)
    assert pooled["a"].focal_std < 0.011 and pooled["a"].focal_source == "matches"
    np.testing.assert_allclose(pooled["a"].K[:2, 2], (51.5, 39.5), atol=0.05)
    assert pooled["a"].centre_std < 0.6
    lens = pooled["a"].distortion
    assert lens is not None and lens.model == "RADIAL" and pooled["a"].lens_std < 0.011
    np.testing.assert_allclose(lens.coefficients, (0.05, -0.1), rtol=0.01)
    assert pooled["d"].distortion is None and pooled["d"].lens_std == LENS
    assert (pooled["d"].focal, pooled["d"].focal_std) == (110, PRIOR)
    assert pooled["d"].focal_source == "exif" and pooled["d"].centre_std == CENTRE
    backwards = by_image(pool(cameras, pairs[::-1]))
    for name, camera in pooled.items():
        np.testing.assert_array_equal(backwards[name].K, camera.K)


def test_images_of_two_sizes_share_no_principal_point():
    cameras = {"a": _camera("x"), "b": replace(_camera("x"), size=SIZE[::-1])}
    pooled = by_image(pool(cameras, [_pair("a", "b", 121, 121)]))
    for name in "ab":
        assert pooled[name].focal == pytest.approx(121, rel=1e-3)
        np.testing.assert_array_equal(pooled[name].K[:2, 2], K[:2, 2])
        assert pooled[name].centre_std == CENTRE


def test_the_cameras_are_read_back(tmp_path):
    lens = Distortion("OPENCV", (-0.3, 0.1, 1e-3, 0.0))
    cameras = {
        'a "1", 2.png': _camera("x"),
        "b/c.png": replace(_camera(None), focal_std=1 / 3),
        "d.png": replace(_camera("y"), distortion=lens, lens_std=0.0),
    }
    write_cameras(tmp_path, cameras)
    again = read_calibration(str(tmp_path / "cameras.csv")).by_name
    assert list(again) == list(cameras)
    for name, camera in cameras.items():
        np.testing.assert_array_equal(again[name].K, camera.K)
        assert again[name].distortion == camera.distortion
        assert again[name].size == SIZE and again[name].identity == camera.identity
        assert again[name].focal_std == camera.focal_std
        assert (again[name].centre_std, again[name].lens_std) == (CENTRE, camera.lens_std)
