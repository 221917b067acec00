import dense_scene
import numpy as np
import pytest
from click.testing import CliRunner

import two_view
from dgc_pose.benchmarks.estimators import (
    CAMERA,
    SIZE,
    Compared,
    compare,
    comparison_table,
    false_poses,
    opencv_pose,
    synthetic_matches,
)
from dgc_pose.benchmarks.posed_pairs import Truth
from dgc_pose.cli.main import main
from dgc_pose.estimation import EstimationOptions
from dgc_pose.geometry.epipolar import essential_from_pose, sampson_distance
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

OPTIONS = EstimationOptions(refine=False)


def test_the_synthetic_matches_fit_their_pose_but_for_the_outliers():
    matches, R, t = synthetic_matches(3, 400, 1e-6, outliers=0.25)
    assert len(matches) == 400
    for points in (matches.points1, matches.points2):
        assert (points > -1).all() and (points < SIZE).all()
    E = essential_from_pose(R, t)
    distance = sampson_distance(
        CAMERA.normalise(matches.points1), CAMERA.normalise(matches.points2), E
    )
    assert distance[100:].max() < 1e-8
    assert np.median(distance[:100]) > 1e-3


@pytest.mark.parametrize("count", [5_000, 20_000])
def test_a_scene_shows_as_many_points_as_asked_for(count):
    assert len(synthetic_matches(0, count, 1.0, outliers=0.5)[0]) == count


def test_random_matches_have_no_pose():
    assert false_poses(3, 60, 10.0) == 0


def test_the_command_prints_a_row_for_every_threshold():
    answer = CliRunner().invoke(main, ["bench-estimators", "--study", "thresholds", "--seeds", "1"])
    assert answer.exit_code == 0
    rows = [line for line in answer.output.splitlines() if line.startswith("| ")]
    assert len(rows) == 1 + 2 * 5
    assert all(row.endswith("1 of 1 |") for row in rows[1:])


def test_the_pose_stage_stands_beside_the_bare_libraries():
    answer = CliRunner().invoke(main, ["bench-estimators", "--study", "speed", "--seeds", "1"])
    assert answer.exit_code == 0
    rows = [line.split(" | ") for line in answer.output.splitlines() if line.startswith("| ")]
    assert [row[0] for row in rows[1:]] == [
        "| pose stage, 5 x 1000 iterations",
        "| pycolmap, 1 x 1000",
        "| PoseLib, 1 x 1000",
    ]
    errors = np.array([[float(cell) for cell in row[1:3]] for row in rows[1:]])
    assert (errors < 0.1).all()
    assert float(rows[2][4].split()[0]) == 1.0


def _scene(**kwargs) -> tuple[Matches, Truth]:
    scene = two_view.two_view_scene("general", **kwargs)
    camera1, camera2 = scene.cameras
    return scene.matches, Truth({}, camera1, camera2, scene.R, 200 * scene.t)


def test_opencv_finds_the_pose_of_two_cameras() -> None:
    """Two sizes, two K: normalised points and one threshold serve both."""
    matches, truth = _scene(sigma_px=0.3)
    found = opencv_pose(matches, truth, OPTIONS)
    assert found is not None
    assert rotation_error_deg(found[0], truth.R) < 0.5
    assert translation_error_deg(found[1], truth.t) < 2


def test_both_are_measured_on_all_matches() -> None:
    matches, truth = _scene(sigma_px=0.3, count=800)
    compared = compare(matches, truth, OPTIONS)
    assert compared.matches == 800
    assert compared.seconds > 0 and compared.opencv_seconds > 0
    assert compared.errors[0] < 0.3 and compared.opencv_errors[0] < 0.5


def test_too_few_matches_are_no_pose_of_either() -> None:
    matches, truth = _scene()
    few = Matches(matches.points1[:4], matches.points2[:4], matches.confidence[:4], 0.5)
    compared = compare(few, truth, OPTIONS)
    assert np.isinf([compared.errors[0], compared.opencv_errors[0]]).all()


def test_the_table_has_the_ratio_of_the_means() -> None:
    rows = [
        Compared(100, 1.0, (2.0, 3.0), 8.0, (4.0, 5.0)),
        Compared(300, 3.0, (4.0, np.inf), 8.0, (6, 7)),
    ]
    _, ours, theirs = comparison_table([("net", rows)], "poselib").splitlines()
    assert ours.split() == ["net", "200", "poselib", "2.000", "3.00", "inf", "0.250"]
    assert theirs.split() == ["net", "200", "findEssentialMat", "8.000", "5.00", "6.00", "1"]


def test_the_command_compares_on_the_pairs_of_a_list(tmp_path):
    path = dense_scene.write_pair_list(tmp_path, pairs=2)
    arguments = ["bench-estimators", str(path), "--methods", "sift", "--limit", "1"]
    answer = CliRunner().invoke(main, arguments)
    assert answer.exit_code == 0, answer.output
    assert answer.output.startswith("1 pairs; 5 runs of 1000 iterations")
    rows = [line.split() for line in answer.output.splitlines()[2:]]
    assert [(row[0], row[2]) for row in rows] == [("sift", "poselib"), ("sift", "findEssentialMat")]
    # OpenCV's model is that of its best sample, not refined on the inliers.
    for row, bound in zip(rows, (1, 5), strict=True):
        assert float(row[4]) < bound and float(row[5]) < 5
