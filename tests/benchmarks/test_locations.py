"""Photographs left out of a model, and their scores."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import assert_refused, run
from worlds import K, View, render_views, write_views

from dgc_pose.benchmarks.locations import LocationScore, report, thinned, true_model


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[View]]:
    """A folder of posed RGB-D images whose depths are unknown."""
    folder = tmp_path_factory.mktemp("rgbd")
    views = render_views(5, step=0.5)
    write_views(folder / "images", views)
    (folder / "depth").mkdir()
    for i in range(len(views)):
        cv2.imwrite(str(folder / f"depth/view{i}.png"), np.zeros((48, 64), np.uint16))
    np.savetxt(folder / "K.txt", K)
    square = [np.vstack([np.column_stack([v.R, v.t]), [0, 0, 0, 1]]) for v in views]
    np.savetxt(folder / "poses.txt", np.stack([np.linalg.inv(s).ravel() for s in square]))
    return folder, views


def test_posed_images_are_a_model(scene: tuple[Path, list[View]]) -> None:
    folder, views = scene
    model = true_model(folder, None)
    for i, view in enumerate(views):
        np.testing.assert_allclose(model.centre(f"view{i}.png"), view.centre, atol=1e-9)
        np.testing.assert_allclose(model.poses[f"view{i}.png"][:, :3], view.R, atol=1e-9)


def test_a_report_counts_what_is_within_bounds() -> None:
    right = LocationScore("a", "located", 0.99, 3, 2.0, 1.0, 0.1, 0.02, 0.1, 0.2, 0.01, 0.0)
    wrong = LocationScore("b", "located", 0.95, 3, 4.0, 2.0, 30.0, 2.0, 20.0, 1.0, 0.1, 0.0)
    none = LocationScore("c", "nowhere", 0.0, 5, 1.0, 1.0)
    lines = dict(report([right, wrong, none]))
    assert lines["located"] == "2 of 3"
    assert lines["right: within 5 deg and 5 % of the extent"] == "1 of 3"
    assert thinned("abcdefg", 3) == ["a", "d", "g"] and thinned(["b", "c"], None) == ["b", "c"]
    assert lines["within 2 deg and 0.05 of the unit"] == "1 of 3"
    assert lines["R within its expected error"] == "1 of 2"
    assert lines["position within its expected error"] == "0 of 2"
    assert lines["right of those at 0.9 or more"] == "1 of 2"
    assert lines["right of those at 0.99 or more"] == "1 of 1"
    assert lines["seconds, median"] == lines["seconds over those of the pairs, median"] == "2"


def test_the_command_scores_views(scene: tuple[Path, list[View]], tmp_path: Path) -> None:
    fast = ("--effort", "fast", "--runs", "2", "--iterations", "200", "--count", "2")
    result = run("bench-locate", scene[0], *fast, "--json", tmp_path / "scores.json")
    assert result.exit_code == 0, result.output
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert [score["name"] for score in scores] == ["view0.png", "view4.png"]
    assert "located" in result.stdout and "right of those at 0.5 or more" in result.stdout
    other = tmp_path / "other"
    other.mkdir()
    assert_refused(run("bench-locate", scene[0], "--other", other), "--other", "holds no images")
    noise = np.random.default_rng(0).integers(0, 255, (24, 32, 3), dtype=np.uint8)
    picture = cv2.resize(noise, (240, 180), interpolation=cv2.INTER_CUBIC)
    cv2.imwrite(str(other / "a.png"), picture)
    placed = run("bench-locate", scene[0], "--other", other, *fast)
    assert "0 of 1 placed above 0.5" in placed.stdout
