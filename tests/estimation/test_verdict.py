import dataclasses

import numpy as np
import pytest
from good_evidence import GOOD_EVIDENCE
from scipy.spatial.transform import Rotation

from dgc_pose.estimation.consensus import model_of_pose
from dgc_pose.estimation.options import VerdictOptions
from dgc_pose.estimation.verdict import gather, judge, robust_rotation
from dgc_pose.metrics.pose import rotation_error_deg
from two_view import two_view_scene

THRESHOLD = 2e-3
OPTIONS = VerdictOptions()
CELLS = (0.05, 0.05)  # a thirtieth of the synthetic images' width


def verdict(num_inliers=300, options=OPTIONS, **changes):
    return judge(dataclasses.replace(GOOD_EVIDENCE, **changes), num_inliers, options)


def test_good_evidence_is_a_pose_without_warnings():
    assert verdict() == ("ok", "a pose", ())


@pytest.mark.parametrize(
    ("status", "changes"),
    [
        ("chance_inliers", {"num_inliers": 14}),
        ("chance_inliers", {"inlier_ratio": 0.14}),
        ("chance_inliers", {"chance_ratio": 0.21}),
        ("chance_inliers", {"log10_false_alarms": -1.0}),
        ("chance_inliers", {"places": 19}),
        ("no_model", {"on_a_line": True}),
        ("no_model", {"rotation_error_90_deg": 31.0}),
        ("rotation_only", {"still_share": 0.92, "rotation_error_90_deg": 180.0}),
        ("rotation_only", {"rotation_share": 0.95, "parallax": 1.0}),
        ("rotation_only", {"still_share": 0.92}),
        ("behind_cameras", {"cheirality_ratio": 0.55}),
        ("planar", {"homography_ratio": 0.9}),
        # What comes first: chance before all, a rotation before cheirality and planes.
        ("chance_inliers", {"inlier_ratio": 0.1, "rotation_share": 1, "parallax": 1}),
        ("rotation_only", {"rotation_share": 1, "parallax": 1, "cheirality_ratio": 0.4}),
        ("rotation_only", {"rotation_share": 1, "parallax": 1, "homography_ratio": 1.0}),
        ("behind_cameras", {"cheirality_ratio": 0.4, "homography_ratio": 1.0}),
    ],
)
def test_each_gate_closes_by_itself(status, changes):
    found, reason, _ = verdict(**changes)
    assert found == status
    assert reason


@pytest.mark.parametrize(
    "changes",
    [
        {"num_inliers": 15},
        {"inlier_ratio": 0.151},
        {"chance_ratio": 0.19},
        {"places": 20},
        {"places": None},
        {"rotation_error_90_deg": 29.0},
        {"rotation_error_90_deg": None},
        {"rotation_share": 0.95, "parallax": 2.2},  # 1.5 x (1 + 4 / sqrt(100)) = 2.1
        {"rotation_share": 0.7, "parallax": 1.0},
        {"still_share": 0.88},
        {"cheirality_ratio": 0.65},
        {"homography_ratio": 0.8},
    ],
)
def test_each_gate_is_open_on_its_other_side(changes):
    assert verdict(**changes)[0] == "ok"


def test_few_matches_need_more_parallax():
    few, many = {"num_turned": 25}, {"num_turned": 10_000}
    assert verdict(rotation_share=0.95, parallax=2.0, **few)[0] == "rotation_only"
    assert verdict(rotation_share=0.95, parallax=2.0, **many)[0] == "ok"


def test_a_small_triangulation_angle_and_a_plane_are_warned_of():
    status, _, warnings = verdict(median_angle_deg=0.5, homography_ratio=0.9)
    assert status == "planar"
    assert len(warnings) == 2
    assert "0.50 deg" in warnings[0] and "90 %" in warnings[1]


def test_gates_can_be_set():
    options = VerdictOptions(min_inlier_ratio=0.7)
    assert verdict(options=options)[0] == "chance_inliers"


def normalised(kind, **settings):
    scene = two_view_scene(kind, **settings)
    camera1, camera2 = scene.cameras
    return scene, camera1.normalise(scene.points1), camera2.normalise(scene.points2)


@pytest.mark.parametrize("rotation_deg", [0.0, 3.0, 25.0])
def test_the_rotation_is_found_among_inliers_of_a_wrong_essential_matrix(rotation_deg):
    scene, points1, points2 = normalised(
        "rotation_only", count=300, outliers=0.2, rotation_deg=rotation_deg
    )
    R = robust_rotation(points1, points2, THRESHOLD)
    assert rotation_error_deg(R, scene.R) < 0.05


def test_of_one_match_the_rotation_is_the_identity():
    point = np.array([[0.1, 0.2]])
    assert np.array_equal(robust_rotation(point, point, THRESHOLD), np.eye(3))


def test_the_evidence_of_the_true_pose():
    scene, points1, points2 = normalised("general", seed=1, count=800, sigma_px=0.5)
    model = model_of_pose(points1, points2, scene.R, scene.t, THRESHOLD)
    evidence = gather(points1, points2, model, THRESHOLD, 0.1, seed=0, cells=CELLS)
    assert evidence.inlier_ratio == pytest.approx(model.inliers.mean())
    assert evidence.inlier_ratio > 0.69
    assert 0 < evidence.chance_ratio < 0.05
    assert evidence.cheirality_ratio > 0.98
    assert evidence.homography_ratio == 0.1
    assert not evidence.on_a_line
    assert verdict_of(evidence, model)[0] == "ok"


def verdict_of(evidence, model):
    return judge(evidence, model.count, OPTIONS)


@pytest.mark.parametrize("sigma_px", [0.0, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_after_a_pure_rotation_the_parallax_is_one_whatever_translation_is_claimed(seed, sigma_px):
    scene, points1, points2 = normalised(
        "rotation_only", seed=seed, count=600, sigma_px=sigma_px, outliers=0.2
    )
    t = Rotation.random(random_state=seed).as_matrix()[0]
    model = model_of_pose(points1, points2, scene.R, t, THRESHOLD)
    evidence = gather(points1, points2, model, THRESHOLD, 1.0, seed=0, cells=CELLS)
    low, high = (0.0, 1e-3) if sigma_px == 0 else (0.75, 1.3)
    assert low <= evidence.parallax <= high
    assert evidence.rotation_share > 0.8
    assert verdict_of(evidence, model)[0] == "rotation_only"


def test_the_parallax_grows_with_the_baseline():
    found = []
    for baseline in (0.02, 0.06, 0.18):
        rng = np.random.default_rng(0)
        X = rng.uniform(-1, 1, (500, 3)) * (3, 2, 2) + (0, 0, 6)
        moved = X + (baseline, 0, 0)
        points1 = X[:, :2] / X[:, 2:] + 3e-4 * rng.standard_normal((500, 2))
        points2 = moved[:, :2] / moved[:, 2:] + 3e-4 * rng.standard_normal((500, 2))
        model = model_of_pose(points1, points2, np.eye(3), np.array([1.0, 0, 0]), 4e-3)
        found.append(gather(points1, points2, model, 4e-3, 0.0, seed=0, cells=CELLS).parallax)
    assert 1.3 < found[0] < found[1] / 2 < found[2] / 4


def test_inliers_on_one_line_are_told():
    scene, points1, points2 = normalised("general", count=100, sigma_px=0.0, outliers=0.0)
    X = np.linspace(-1, 1, 100)[:, None] * (1.0, 0.5, 0.3) + (0, 0, 5)
    local = X @ scene.R.T + scene.t
    points1, points2 = X[:, :2] / X[:, 2:], local[:, :2] / local[:, 2:]
    model = model_of_pose(points1, points2, scene.R, scene.t, THRESHOLD)
    assert model.inliers.all()
    assert gather(points1, points2, model, THRESHOLD, 0.0, seed=0, cells=CELLS).on_a_line


def test_inliers_crowded_in_a_few_spots_are_few_places():
    scene, points1, points2 = normalised("general", count=400, sigma_px=0.0, outliers=0.0)
    whole = model_of_pose(points1, points2, scene.R, scene.t, THRESHOLD)
    counted = (
        {tuple(cell) for cell in np.floor(points1 / 0.05)},
        {tuple(cell) for cell in np.floor(points2 / 0.05)},
    )
    evidence = gather(points1, points2, whole, THRESHOLD, 0.0, seed=0, cells=CELLS)
    assert evidence.places == min(map(len, counted)) > 100
    # Eight of the points, each a hundred times within a hair: as many inliers, as few places.
    uneven = gather(points1, points2, whole, THRESHOLD, 0.0, seed=0, cells=(0.2, 0.05))
    assert uneven.places == len({tuple(cell) for cell in np.floor(points1 / 0.2)})
    rng = np.random.default_rng(0)
    few = np.repeat(np.arange(8), 100)
    near1 = points1[few] + 1e-5 * rng.standard_normal((800, 2))
    near2 = points2[few] + 1e-5 * rng.standard_normal((800, 2))
    model = model_of_pose(near1, near2, scene.R, scene.t, THRESHOLD)
    assert model.count > 700
    crowded = gather(near1, near2, model, THRESHOLD, 0.0, seed=0, cells=CELLS)
    assert crowded.places <= 12
    assert verdict_of(crowded, model)[0] == "chance_inliers"
    # Of key points each is evidence by itself.
    by_itself = gather(near1, near2, model, THRESHOLD, 0.0, seed=0, cells=None)
    assert by_itself.places is None
    assert verdict_of(by_itself, model)[0] == "ok"


def test_evidence_without_inliers_is_a_plain_no():
    points = np.random.default_rng(0).uniform(-1, 1, (2, 30, 2))
    model = model_of_pose(*points, np.eye(3), np.array([1.0, 0, 0]), 1e-12)
    assert model.count == 0
    evidence = gather(*points, model, 1e-12, 0.0, seed=0, cells=CELLS)
    assert verdict_of(evidence, model)[0] == "chance_inliers"
