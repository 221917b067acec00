import numpy as np
import pytest
from click.testing import CliRunner

from dgc_pose.benchmarks.estimators import CAMERA, SIZE, false_poses, main, synthetic_matches
from dgc_pose.geometry.epipolar import essential_from_pose, sampson_distance


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
    answer = CliRunner().invoke(main, ["--study", "thresholds", "--seeds", "1"])
    assert answer.exit_code == 0
    rows = [line for line in answer.output.splitlines() if line.startswith("| ")]
    assert len(rows) == 1 + 2 * 5
    assert all(row.endswith("1 of 1 |") for row in rows[1:])


def test_the_pose_stage_stands_beside_the_bare_libraries():
    answer = CliRunner().invoke(main, ["--study", "speed", "--seeds", "1"])
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
