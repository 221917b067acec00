import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgc_pose.estimation.evidence import gather, robust_rotation
from dgc_pose.estimation.model import Model
from dgc_pose.estimation.verdict import judge
from dgc_pose.metrics import rotation_error_deg
from two_view import CELLS, normalised_problem, two_view_scene

THRESHOLD = 2e-3
LEAST = 0.5  # probability of a success


@pytest.mark.parametrize("rotation_deg", [0.0, 3.0, 25.0])
def test_the_rotation_is_found_among_inliers_of_a_wrong_essential_matrix(rotation_deg):
    scene = two_view_scene("rotation_only", count=300, outliers=0.2, rotation_deg=rotation_deg)
    R = robust_rotation(scene.problem(THRESHOLD / 2))
    assert rotation_error_deg(R, scene.R) < 0.05


def test_the_evidence_of_the_true_pose():
    scene = two_view_scene("general", seed=1, count=800, sigma_px=0.5)
    problem = scene.problem(THRESHOLD, CELLS)
    model = Model.of_pose(problem, scene.R, scene.t)
    evidence = gather(problem, model, homography_ratio=0.1)
    assert evidence.num_inliers == model.count
    assert evidence.inlier_ratio == pytest.approx(model.inliers.mean())
    assert evidence.inlier_ratio > 0.69
    assert 0 < evidence.chance_ratio < 0.05
    assert evidence.cheirality_ratio > 0.98
    assert evidence.homography_ratio == 0.1
    assert not evidence.collinear
    assert judge(evidence, LEAST).status == "ok"


@pytest.mark.parametrize("sigma_px", [0.0, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_after_a_pure_rotation_the_parallax_is_one_whatever_translation_is_claimed(seed, sigma_px):
    scene = two_view_scene("rotation_only", seed=seed, count=600, sigma_px=sigma_px, outliers=0.2)
    problem = scene.problem(THRESHOLD, CELLS)
    t = Rotation.random(random_state=seed).as_matrix()[0]
    evidence = gather(problem, Model.of_pose(problem, scene.R, t), homography_ratio=1.0)
    low, high = (0.0, 1e-3) if sigma_px == 0 else (0.75, 1.3)
    assert low <= evidence.parallax <= high
    assert evidence.rotation_share > 0.8
    assert judge(evidence, LEAST).status == "rotation_only"


def test_the_parallax_grows_with_the_baseline():
    found = []
    for baseline in (0.02, 0.06, 0.18):
        rng = np.random.default_rng(0)
        X = rng.uniform(-1, 1, (500, 3)) * (3, 2, 2) + (0, 0, 6)
        moved = X + (baseline, 0, 0)
        points1 = X[:, :2] / X[:, 2:] + 3e-4 * rng.standard_normal((500, 2))
        points2 = moved[:, :2] / moved[:, 2:] + 3e-4 * rng.standard_normal((500, 2))
        problem = normalised_problem(points1, points2, 4e-3, CELLS)
        model = Model.of_pose(problem, np.eye(3), np.array([1.0, 0, 0]))
        found.append(gather(problem, model, homography_ratio=0.0).parallax)
    assert 1.3 < found[0] < found[1] / 2 < found[2] / 4


def test_inliers_on_one_line_are_collinear():
    scene = two_view_scene("general", count=100, sigma_px=0.0, outliers=0.0)
    X = np.linspace(-1, 1, 100)[:, None] * (1.0, 0.5, 0.3) + (0, 0, 5)
    local = X @ scene.R.T + scene.t
    points1, points2 = X[:, :2] / X[:, 2:], local[:, :2] / local[:, 2:]
    problem = normalised_problem(points1, points2, THRESHOLD, CELLS)
    model = Model.of_pose(problem, scene.R, scene.t)
    assert model.inliers.all()
    assert gather(problem, model, homography_ratio=0.0).collinear


def test_inliers_crowded_in_a_few_spots_occupy_few_cells():
    scene = two_view_scene("general", count=400, sigma_px=0.0, outliers=0.0)
    whole = scene.problem(THRESHOLD, CELLS)
    points1, points2 = whole.points1, whole.points2

    def evidence_of(problem):
        return gather(problem, Model.of_pose(problem, scene.R, scene.t), homography_ratio=0.0)

    counted = (
        {tuple(cell) for cell in np.floor(points1 / 0.05)},
        {tuple(cell) for cell in np.floor(points2 / 0.05)},
    )
    assert evidence_of(whole).occupied_cells == min(map(len, counted)) > 100
    uneven = evidence_of(scene.problem(THRESHOLD, (0.2, 0.05)))
    assert uneven.occupied_cells == len({tuple(cell) for cell in np.floor(points1 / 0.2)})
    # Eight of the points, each a hundred times within a hair: as many inliers, few cells.
    rng = np.random.default_rng(0)
    few = np.repeat(np.arange(8), 100)
    near1 = points1[few] + 1e-5 * rng.standard_normal((800, 2))
    near2 = points2[few] + 1e-5 * rng.standard_normal((800, 2))
    crowded = evidence_of(normalised_problem(near1, near2, THRESHOLD, CELLS))
    assert crowded.num_inliers > 700
    assert crowded.occupied_cells <= 12
    assert judge(crowded, LEAST).status == "chance_inliers"
    # Key points are independent.
    independent = evidence_of(normalised_problem(near1, near2, THRESHOLD, CELLS, key_points=True))
    assert independent.key_points and independent.occupied_cells == crowded.occupied_cells
    assert judge(independent, LEAST).status == "ok"


def test_evidence_without_inliers_is_a_failure():
    points = np.random.default_rng(0).uniform(-1, 1, (2, 30, 2))
    problem = normalised_problem(*points, 1e-12, CELLS)
    model = Model.of_pose(problem, np.eye(3), np.array([1.0, 0, 0]))
    assert model.count == 0
    evidence = gather(problem, model, homography_ratio=0.0)
    assert judge(evidence, LEAST).status == "chance_inliers"
