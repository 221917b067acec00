"""Planes, and a camera that did not move where its focal lengths are not known."""

import numpy as np
import pytest
from scenes import two_view_scene
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import estimate_pose
from dgc_pose.estimation.problem import Hypothesis
from dgc_pose.estimation.robust_fit import best_planar, fit_plane, still_camera
from dgc_pose.geometry.homography import fit_homography
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg

SIZE = (1600, 1200)
K = np.array([[1500.0, 0, 799.5], [0, 1500, 599.5], [0, 0, 1]])
TURN = Rotation.from_rotvec([0.05, 0.15, 0.1]).as_matrix()
ROLL = Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix()


def _zoomed(factor: float) -> np.ndarray:
    return K * [[factor, factor, 1]] * np.array([[1], [1], [1]])


def _unknown(identity: str | None) -> Camera:
    f = 1760.0  # by the size
    prior = np.array([[f, 0, 799.5], [0, f, 599.5], [0, 0, 1]])
    return Camera(prior, SIZE, focal_std=0.45, centre_std=8.0, identity=identity)


def test_one_homography_explains_a_plane_and_not_a_solid() -> None:
    for kind, low, high in (("planar", 0.9, 1.0), ("general", 0.0, 0.5)):
        scene = two_view_scene(kind, count=500, sigma_px=0.5, outliers=0.4)
        problem = scene.problem()
        share, H = fit_plane(problem, Hypothesis.of_pose(problem, scene.R, scene.t))
        assert low <= share <= high and H is not None


@pytest.mark.parametrize("refined", [False, True])
def test_a_plane_brings_a_wrong_pose_back_to_a_right_one(refined: bool) -> None:
    scene = two_view_scene("planar", count=500, sigma_px=0.2, outliers=0.3)
    problem = scene.problem()
    right = problem.subset(scene.true)
    H = fit_homography(right.points1, right.points2, problem.threshold)
    wrong = Hypothesis.of_pose(problem, np.eye(3), np.array([0.0, 0, 1]))
    assert best_planar(problem, wrong, H, refined).angle_to(scene.R, scene.t) < 2


@pytest.mark.parametrize("identity", ["shared", None])
@pytest.mark.parametrize(
    ("H", "R"),
    [
        (np.array([[1, 0, -150], [0, 1, 80], [0, 0, 1.0]]), np.eye(3)),  # a crop
        (np.array([[1.4, 0, -420], [0, 1.4, -10], [0, 0, 1.0]]), np.eye(3)),  # a crop, enlarged
        (_zoomed(1.3) @ np.linalg.inv(K), np.eye(3)),
        (K @ ROLL @ np.linalg.inv(K), ROLL),
        (K @ TURN @ np.linalg.inv(K), TURN),
        (_zoomed(1.3) @ TURN @ np.linalg.inv(K), TURN),
    ],
    ids=["crop", "enlarged", "zoom", "roll", "turn", "turn and zoom"],
)
def test_a_camera_that_did_not_move_has_no_pose(
    H: np.ndarray, R: np.ndarray, identity: str | None
) -> None:
    rng = np.random.default_rng(4)
    points1 = rng.random((2400, 2)) * SIZE
    moved = np.column_stack([points1, np.ones(2400)]) @ H.T
    points2 = moved[:, :2] / moved[:, 2:] + 0.2 * rng.standard_normal((2400, 2))
    seen = ((points2 > 0) & (points2 < SIZE)).all(1)  # in both images
    points1, points2 = points1[seen], points2[seen]
    wrong = rng.random(len(points2)) < 0.1
    points2[wrong] = rng.random((wrong.sum(), 2)) * SIZE
    matches = Matches(points1, points2, np.ones(len(points2)), error_px=0.5)
    pose = estimate_pose(matches, _unknown(identity), _unknown(identity))
    assert pose.status == "rotation_only" and pose.t is None and pose.probability == 0
    assert rotation_error_deg(pose.R, R) < 2


@pytest.mark.parametrize("kind", ["planar", "forward", "general"])
def test_a_camera_that_moved_is_no_still_one(kind: str) -> None:
    problem = two_view_scene(kind, outliers=0.0).problem()
    assert still_camera(problem)[0] < 0.5
