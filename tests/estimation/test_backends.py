"""Each library alone: a run finds the pose, repeats to the bit, and differs by its seed."""

import numpy as np
import poselib
import pycolmap
import pytest

from dgc_pose.estimation.backend import VIRTUAL_FOCAL
from dgc_pose.estimation.poselib_backend import refine_pose
from dgc_pose.estimation.ransac import get_backend
from dgc_pose.geometry.epipolar import essential_from_pose, sampson_distance
from dgc_pose.metrics.pose import rotation_error_deg, translation_error_deg
from two_view import two_view_scene

ESTIMATORS = ("poselib", "pycolmap", "opencv")
THRESHOLD = 2e-3


def normalised(**settings):
    scene = two_view_scene(**settings)
    camera1, camera2 = scene.cameras
    return scene, camera1.normalise(scene.points1), camera2.normalise(scene.points2)


def run(name, points1, points2, *, seed=1, iterations=200):
    return get_backend(name)(
        points1, points2, threshold=THRESHOLD, iterations=iterations, seed=seed
    )


def unit(E):
    """E up to its scale and sign."""
    E = E / np.linalg.norm(E)
    return E * np.sign(E.flat[np.abs(E).argmax()])


@pytest.mark.parametrize("name", ESTIMATORS)
def test_one_run_finds_the_essential_matrix_of_a_noisy_scene(name):
    scene, points1, points2 = normalised(seed=2, count=500, sigma_px=0.5, outliers=0.4)
    (E,) = run(name, points1, points2, iterations=1000)
    inliers = sampson_distance(points1, points2, E) < THRESHOLD
    assert inliers[scene.true].mean() > 0.97
    truth = unit(essential_from_pose(scene.R, scene.t))
    assert np.abs(unit(E) - truth).max() < 0.02


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_seed_repeats_to_the_bit_and_every_other_seed_differs(name):
    # So few iterations that no two runs can end at the same model but by the same samples.
    _, points1, points2 = normalised(seed=5, count=400, sigma_px=3.0, outliers=0.5)
    first = [run(name, points1, points2, seed=seed, iterations=30) for seed in range(6)]
    again = [run(name, points1, points2, seed=seed, iterations=30) for seed in range(6)]
    for one, other in zip(first, again, strict=True):
        assert len(one) == len(other) > 0
        assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
    distinct = {unit(stack[0]).round(9).tobytes() for stack in first}
    assert len(distinct) == 6


@pytest.mark.parametrize("name", ESTIMATORS)
def test_more_iterations_are_really_run(name):
    # One iteration of five samples in a tenth of good matches finds nothing; thousands do.
    scene, points1, points2 = normalised(seed=8, count=300, sigma_px=0.5, outliers=0.6)

    def right(E):
        return (sampson_distance(points1, points2, E) < THRESHOLD)[scene.true].mean() > 0.9

    few = [any(right(E) for E in run(name, points1, points2, seed=s, iterations=1)) for s in (1, 2)]
    many = [right(run(name, points1, points2, seed=s, iterations=3000)[0]) for s in (1, 2)]
    assert not all(few)
    assert all(many)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_five_matches_are_enough_and_every_matrix_fits_them(name):
    _, points1, points2 = normalised(seed=3, count=5, sigma_px=0.0, outliers=0.0)
    found = run(name, points1, points2)
    assert found
    assert all(E.shape == (3, 3) and np.isfinite(E).all() for E in found)
    best = min(sampson_distance(points1, points2, E).max() for E in found)
    assert best < 1e-6


@pytest.mark.parametrize("name", ESTIMATORS)
def test_points_all_alike_have_no_essential_matrix(name):
    points = np.tile([[0.1, 0.2]], (50, 1))
    assert run(name, points, points) == []


def test_an_unrefined_run_is_the_librarys_own_answer():
    _, points1, points2 = normalised(seed=4, count=300, sigma_px=1.0, outliers=0.3)
    pixels1, pixels2 = VIRTUAL_FOCAL * points1, VIRTUAL_FOCAL * points2
    camera = pycolmap.Camera(
        model="PINHOLE", width=2, height=2, params=[VIRTUAL_FOCAL, VIRTUAL_FOCAL, 0, 0]
    )
    options = pycolmap.RANSACOptions(
        max_error=THRESHOLD * VIRTUAL_FOCAL,
        min_num_trials=200,
        max_num_trials=200,
        random_seed=1,
    )
    theirs = pycolmap.estimate_essential_matrix(pixels1, pixels2, camera, camera, options)
    np.testing.assert_allclose(
        unit(run("pycolmap", points1, points2)[0]), unit(theirs["E"]), atol=1e-9
    )
    simple = {"model": "PINHOLE", "width": 2, "height": 2, "params": [VIRTUAL_FOCAL] * 2 + [0, 0]}
    ransac = {
        "max_iterations": 200,
        "min_iterations": 200,
        "max_epipolar_error": THRESHOLD * VIRTUAL_FOCAL,
        "seed": 1,
    }
    pose, _ = poselib.estimate_relative_pose(pixels1, pixels2, simple, simple, ransac, {})
    E = essential_from_pose(pose.R, pose.t)
    assert np.abs(unit(run("poselib", points1, points2)[0]) - unit(E)).max() < 1e-2


def test_refinement_lowers_the_error_of_a_pose_that_is_a_little_off():
    scene, points1, points2 = normalised(seed=6, count=500, sigma_px=1.0, outliers=0.0)
    t = scene.t + (0.02, -0.03, 0.02)
    t /= np.linalg.norm(t)
    off = scene.R @ np.array([[1, -0.01, 0], [0.01, 1, 0], [0, 0, 1]])
    U, _, Vt = np.linalg.svd(off)
    R, refined = refine_pose(points1, points2, U @ Vt, t, THRESHOLD)
    assert np.linalg.norm(refined) == pytest.approx(1)
    assert translation_error_deg(refined, scene.t) < 0.25 * translation_error_deg(t, scene.t)
    assert rotation_error_deg(R, scene.R) < 0.25 * rotation_error_deg(U @ Vt, scene.R)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_run_of_good_matches_does_not_end_early(name):
    _, points1, points2 = normalised(seed=7, count=300, sigma_px=1.0, outliers=0.02)

    def found(iterations):
        return get_backend(name)(
            points1, points2, threshold=1 / 1400, iterations=iterations, seed=1
        )[0]

    assert not np.array_equal(found(50), found(3000))
