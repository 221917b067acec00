"""Other poses that explain the matches: of a plane, of repeated structure, of mirrored depth."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.estimation.model import Model
from dgc_pose.estimation.rivals import DISTINCT_DEG, mirrored
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from two_view import normalised_problem, poster_scene, two_view_scene

# Of two poses that explain a plane equally well none has a probability above one half.
OPTIONS = EstimationOptions(runs=3, iterations=300, min_probability=None)


def _off(R: np.ndarray, t: np.ndarray, scene) -> float:
    return max(rotation_error_deg(R, scene.R), translation_error_deg(t, scene.t))


@pytest.mark.parametrize("seed", range(3))
def test_a_general_scene_has_no_alternative(seed: int) -> None:
    scene = two_view_scene("general", seed=seed, count=500)
    pose = estimate_pose(scene.matches, *scene.cameras, OPTIONS)
    assert pose.success and pose.alternatives == ()
    assert pose.evidence is not None and pose.evidence.rival_ratio < 0.75


@pytest.mark.parametrize("seed", [0, 2, 3, 4])
def test_a_plane_has_its_homography_s_other_pose(seed: int) -> None:
    scene = poster_scene(seed=seed)
    pose = estimate_pose(scene.matches, *scene.cameras, OPTIONS)
    assert pose.status == "planar" and len(pose.alternatives) in (1, 2)
    answers = [(answer.R, answer.t) for answer in (pose, *pose.alternatives)]
    errors = [_off(R, t, scene) for R, t in answers]
    assert min(errors) < 3 and max(errors) > DISTINCT_DEG
    assert pose.alternatives[0].num_inliers > 0.75 * pose.num_inliers
    for words in ("other pose", "nearly a plane"):
        assert any(words in warning for warning in pose.warnings)


def test_structure_one_period_off_gives_a_second_pose() -> None:
    """Four matches in ten agree on another motion: those of windows taken for their neighbours."""
    right = two_view_scene("general", seed=1, count=600, outliers=0.0, rotation_deg=10)
    wrong = two_view_scene("general", seed=5, count=450, outliers=0.0, rotation_deg=25)
    rng = np.random.default_rng(0)
    noise1, noise2 = rng.random((100, 2)) * (1600, 1200), rng.random((100, 2)) * (1280, 960)
    points1 = np.vstack([right.points1, wrong.points1, noise1])
    points2 = np.vstack([right.points2, wrong.points2, noise2])
    matches = Matches(points1, points2, np.ones(len(points1)), 0.5)
    pose = estimate_pose(matches, *right.cameras, OPTIONS)
    assert pose.success and _off(pose.R, pose.t, right) < 2
    (other, *_) = pose.alternatives
    assert _off(other.R, other.t, wrong) < 3 and other.num_inliers >= 430


@pytest.mark.parametrize("seed", range(4))
def test_a_relief_seen_from_afar_can_be_turned_inside_out(seed: int) -> None:
    """Perspective, which tells the two apart, is within the error that the matches expect."""
    rng = np.random.default_rng(seed)
    K = np.array([[20000.0, 0, 500], [0, 20000, 500], [0, 0, 1]])
    X = np.column_stack([rng.uniform(-1, 1, (400, 2)), rng.uniform(-0.4, 0.4, 400)])
    R = Rotation.from_rotvec(np.radians(12) * np.array([0.2, 0.97, 0.1])).as_matrix()
    middle = np.array([0, 0, 45.0])
    seen = []
    for rotation in (np.eye(3), R):
        local = X @ rotation.T + middle
        pixels = (local @ K.T)[:, :2] / local[:, 2:]
        seen.append(pixels + 0.3 * rng.standard_normal(pixels.shape))
    camera = Camera(K, (1001, 1001))
    pose = estimate_pose(Matches(*seen, np.ones(400), 1.5), camera, camera, OPTIONS)
    (other,) = pose.alternatives
    assert pose.success and other.num_inliers > 390
    assert rotation_error_deg(pose.R, R) < 1
    # The same rotation the other way round.
    assert rotation_error_deg(other.R, R.T) < 4 < 20 < rotation_error_deg(other.R, R)


@pytest.mark.parametrize("kind", ["rotation_only", "identical"])
def test_exact_motion_without_parallax_has_no_mirrored_pose(kind) -> None:
    problem = two_view_scene(kind, sigma_px=0.0, count=100, outliers=0.0).problem()
    model = Model.of_pose(problem, np.eye(3), np.array([1.0, 0, 0]))
    found = mirrored(problem, model)
    assert found is None or (np.isfinite(found.R).all() and np.isfinite(found.t).all())


def test_two_points_have_no_mirrored_pose() -> None:
    problem = normalised_problem(np.zeros((2, 2)), np.ones((2, 2)))
    assert mirrored(problem, Model.of_pose(problem, np.eye(3), np.array([1.0, 0, 0]))) is None
