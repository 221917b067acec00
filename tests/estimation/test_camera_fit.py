"""The fit of a pose and two cameras: its errors in the images against differences by pixels, its
cost, its slopes, and the rounds of a fit."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import camera_scene, pinhole
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation.camera_fit import JointFit, JointPose, focal_parameters, start_at
from dgc_pose.estimation.intrinsics_prior import pair_with_parameters
from dgc_pose.estimation.least_squares import cauchy_losses
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.geometry.epipolar import essential_from_pose, homogeneous, tangent_axes
from dgc_pose.metrics import rotation_error_deg

IMAGE = (1400, 1000)
LENSES = [
    *(None, Distortion("RADIAL", (-0.1, 0.03)), Distortion("CYLINDER")),
    *(Distortion("OPENCV_FISHEYE", (0.02, -0.01, 0, 0)), Distortion("SIMPLE_FISHEYE")),
]
LOOSE = {"focal_std": 0.3, "centre_std": 10.0, "aspect_std": 0.2}
STEP = 1e-3  # pixels


def _joint(camera: Camera, seed: int = 0, **changes: float):
    scene = camera_scene(camera, camera, seed=seed, **changes)
    loose = replace(camera, **LOOSE)
    problem = TwoViewProblem.of(scene.matches, loose, loose)
    return scene, JointFit(problem)


@pytest.mark.parametrize("deviates", [False, True])
@pytest.mark.parametrize("lens", LENSES)
def test_errors_in_the_image_are_of_the_first_order_by_pixels(lens, deviates) -> None:
    """The algebraic error over the length of its gradient by the four coordinates of a match."""
    camera = pinhole(800, IMAGE, lens)
    scene, joint = _joint(camera, count=60, outliers=0.0, sigma_px=1.0)
    z = 0.3 * np.random.default_rng(1).standard_normal(len(joint.prior)) * deviates
    pose = JointPose(scene.R, scene.t, z)
    cameras = pair_with_parameters(scene.cameras, joint.parameters(pose))
    E = essential_from_pose(pose.R, pose.t)

    def algebraic(shift: np.ndarray) -> np.ndarray:
        rays1 = homogeneous(cameras[0].normalise(scene.points1 + shift[:2]))
        rays2 = homogeneous(cameras[1].normalise(scene.points2 + shift[2:]))
        return ((rays1 @ E.T) * rays2).sum(1)

    slopes = [(algebraic(s) - algebraic(-s)) / (2 * STEP) for s in STEP * np.eye(4)]
    expected = np.abs(algebraic(np.zeros(4))) / np.linalg.norm(slopes, axis=0)
    errors = joint.errors_px(pose)
    np.testing.assert_allclose(errors, expected[joint.problem.index], rtol=2e-3)


def test_errors_do_not_tell_the_side_of_a_camera_and_the_cost_does() -> None:
    """Points far away lie on both sides, by noise."""
    scene, joint = _joint(pinhole(800, IMAGE), count=60, outliers=0.0)
    pose = JointPose(scene.R, scene.t, np.zeros(len(joint.prior)))
    behind = replace(pose, t=-scene.t)
    np.testing.assert_allclose(joint.errors_px(behind), joint.errors_px(pose))
    assert np.isfinite(joint.errors_px(pose)).all()
    assert joint.cost(behind) > 5 * joint.cost(pose)
    # A fit turns the translation round.
    np.testing.assert_allclose(joint.fitted(behind).t, joint.fitted(pose).t, atol=1e-3)
    # Without matches a deviation costs half of its square.
    empty = JointFit(joint.problem.subset(np.zeros(len(joint.problem), dtype=bool)))
    z = np.full(len(joint.prior), 0.5)
    assert empty.cost(replace(pose, z=z)) == pytest.approx(z @ z / 2)


def test_the_slopes_are_those_of_the_losses() -> None:
    """Against differences of the Cauchy loss, without the part of the prior."""
    scene, joint = _joint(pinhole(800, IMAGE), outliers=0.0, sigma_px=0.5)
    width = joint.problem.threshold
    pose = JointPose(scene.R, scene.t, 0.02 * np.ones(len(joint.prior)))
    _, information, gradient = JointFit(joint.problem, width).slopes(pose, joint.prior)
    tangent = tangent_axes(pose.t)
    assert information.shape == (len(gradient),) * 2 == (5 + len(joint.prior),) * 2
    np.testing.assert_allclose(tangent.T @ tangent, np.eye(2), atol=1e-9)
    np.testing.assert_allclose(tangent.T @ scene.t, 0, atol=1e-9)
    np.testing.assert_allclose(information, information.T, rtol=1e-9, atol=1e-6)
    values = np.linalg.eigvalsh(information)
    assert values.min() > -1e-9 * values.max()
    step = 1e-4
    for k in range(len(gradient)):
        losses = []
        for sign in (-1, 1):
            change = sign * step * np.eye(len(gradient))[k]
            t = pose.t + tangent @ change[3:5]
            R = Rotation.from_rotvec(change[:3]).as_matrix() @ pose.R
            moved = JointPose(R, t / np.linalg.norm(t), pose.z + change[5:])
            losses.append(cauchy_losses(joint._errors(moved), width).sum())
        slope = (losses[1] - losses[0]) / (2 * step)
        scale = np.sqrt(information[k, k])
        assert abs(gradient[k] - slope) < 0.02 * abs(slope) + 0.05 * scale, k


def test_a_run_at_another_focal_length_leaves_an_exact_camera_as_it_is() -> None:
    exact, zoomed = pinhole(1300, IMAGE), pinhole(1300 * np.exp(0.6), IMAGE)
    scene = camera_scene(exact, zoomed)
    unknown = replace(exact, focal_std=0.5)
    joint = JointFit(TwoViewProblem.of(scene.matches, exact, unknown))
    start = start_at(joint, focal_parameters(np.full(2, 0.6)), 0)
    assert rotation_error_deg(start.R, scene.R) < 0.5
    np.testing.assert_allclose(joint.parameters(start)[[0, 6]], [0.0, 0.6], atol=1e-9)
