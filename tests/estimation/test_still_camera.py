"""A camera that only turned, with a K or a lens that is a little wrong: it is found, with the right
rotation, and told from scenes with a translation."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import SceneKind, TwoViewScene, camera_scene, pinhole, poster_scene, two_view_scene

from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation import RelativePose
from dgc_pose.estimation.camera_changes import turning
from dgc_pose.estimation.intrinsics_prior import IntrinsicsPrior
from dgc_pose.estimation.probability import shipped_models
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.still_camera import _Turn, _TurnFit, turned_camera
from dgc_pose.metrics import rotation_error_deg

SIZE = (1600, 1200)
CAMERA = pinhole(1500, SIZE)
NETWORK = min(shipped_models().weights)  # of which a probability is known


def _turned(degrees: float, seed: int, k1: float = 0.0, outliers: float = 0.2) -> TwoViewScene:
    lens = Distortion("RADIAL", (k1, 0.0)) if k1 else None
    camera = replace(CAMERA, distortion=lens)
    turn = (0.2 * degrees, degrees, 0.3 * degrees)
    nowhere = {"turn_deg": turn, "centre": (0.0, 0.0, 0.0), "outliers": outliers}
    return camera_scene(camera, camera, seed=seed, weights=NETWORK, **nowhere)


def _assert_turn(pose: RelativePose, scene: TwoViewScene) -> None:
    assert pose.status == "rotation_only" and pose.t is None and not pose.success
    error = rotation_error_deg(pose.R, scene.R)
    assert error < max(2 * pose.rotation_error_90_deg, 0.1) and error < 1.0
    assert pose.translation_error_90_deg is None
    np.testing.assert_array_equal(pose.covariance[3:], 0)


@pytest.mark.parametrize("lens", [None, Distortion("OPENCV", (-0.1, 0.02, 0.001, -0.001))])
def test_the_slopes_are_the_differences_of_the_errors(lens) -> None:
    scene = two_view_scene("skew", count=50, outliers=0.0)
    cameras = [replace(camera, distortion=lens) for camera in scene.cameras]
    problem = TwoViewProblem.of(scene.matches, *cameras)
    basis = np.random.default_rng(1).standard_normal((12, 4)) * 0.05
    if lens is not None:
        basis[[3, 4, 9, 10]] = 0  # its coefficients are known
    fit = _TurnFit(problem, IntrinsicsPrior(basis))
    turn = _Turn(scene.R, np.array([0.4, -0.3, 0.2, 0.5]))
    _, slopes = fit.errors_and_slopes(turn)
    for column, step in enumerate(1e-6 * np.eye(7)):
        ahead, _ = fit.errors_and_slopes(fit.moved(turn, step))
        behind, _ = fit.errors_and_slopes(fit.moved(turn, -step))
        np.testing.assert_allclose(slopes[:, :, column], (ahead - behind) / 2e-6, atol=2e-4)


@pytest.mark.parametrize(
    ("degrees", "factor", "k1", "outliers"),
    [
        *((6, factor, 0.0, 0.2) for factor in (0.8, 1.0, 3.0)),
        *((14, factor, 0.0, 0.2) for factor in (0.9, 1.04, 1.2)),
        *((25, factor, 0.0, 0.2) for factor in (0.96, 1.1, 2.0, 10.0)),
        # A lens that K leaves out.
        *((8, 1.0, k1, 0.2) for k1 in (-0.05, -0.3)),
        (20, 1.0, -0.15, 0.2),
        (20, 0.85, -0.3, 0.4),
        (20, 1.2, -0.15, 0.4),
    ],
)
def test_a_turn_is_found_with_a_wrong_camera(
    degrees: float, factor: float, k1: float, outliers: float
) -> None:
    seed = int(degrees)
    scene = _turned(degrees, seed, k1, outliers)
    stated = CAMERA.with_focal(factor * 1500)
    _assert_turn(scene.estimate(stated, stated, seed=seed), scene)


@pytest.mark.parametrize(("degrees", "k1"), [(8, -0.15), (20, -0.05)])
def test_a_turn_is_found_without_a_K(degrees: float, k1: float) -> None:
    assert _turned(degrees, 0, k1).estimate().status == "rotation_only"


@pytest.mark.parametrize("kind", ["general", "skew", "orbit", "planar"])
@pytest.mark.parametrize(("factor", "seed"), [(0.85, 0), (1.0, 1), (1.15, 2)])
def test_a_translation_is_no_turn(kind: SceneKind, factor: float, seed: int) -> None:
    scene = two_view_scene(kind, seed=seed, same_camera=True, outliers=0.2, count=400)
    stated = scene.cameras[0].with_focal(factor * scene.cameras[0].focal)
    assert scene.estimate(stated, stated, seed=seed).status != "rotation_only"


@pytest.mark.parametrize("centre", [(1.0, 0.2, 0.0), (0.0, 0.0, 1.5), None])
def test_a_frontal_plane_that_shifts_is_no_turn(centre: tuple[float, float, float] | None) -> None:
    """A shift or zoom of the image is a turn only of a camera that sees at a point."""
    plane = {"turn_deg": (0, 0, 0), "centre": centre, "depths": (6.0, 6.01)}
    scene = camera_scene(CAMERA, CAMERA, **plane) if centre else poster_scene()
    assert scene.estimate(*scene.cameras).status != "rotation_only"


def test_what_a_turn_explains_is_counted_over_all_matches() -> None:
    scene = _turned(12, 3, outliers=0.3)
    stated = (CAMERA.with_focal(1350),) * 2
    problem = TwoViewProblem.of(scene.matches, *stated)
    free = turned_camera(problem.with_cameras(turning(stated)))
    assert 0.65 * len(problem) < free.count < 0.75 * len(problem)
    assert rotation_error_deg(free.R, scene.R) < 0.3
    assert turned_camera(problem).count < 0.6 * free.count
    few = problem.subset(np.arange(len(problem)) < 12)
    assert turned_camera(few).count <= 12


@pytest.mark.parametrize("size", [(4000, 3000), None])
def test_a_small_shift_in_a_large_image_is_no_turn(size) -> None:
    """A turn may have another lens, and explains no larger errors for that."""
    large = pinhole(3500, (4000, 3000))
    shift = {"turn_deg": (1.0, 6.0, 0.5), "centre": (0.035, 0.0, 0.005), "depths": (5.0, 10.0)}
    scene = camera_scene(large, large, sigma_px=0.3, weights=NETWORK, **shift)
    stated = replace(large, size=size)
    pose = scene.estimate(stated, stated)
    rotation, translation = scene.errors_deg(pose)
    assert pose.status == "ok" and rotation < 0.05 and translation < 2.0
