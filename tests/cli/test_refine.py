"""--refine on the commands that match."""

from __future__ import annotations

import dense_scene
import numpy as np
import pytest
from command_line import run


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Pictures and a list of them; every network's map is off by 0.7 px."""
    monkeypatch.chdir(tmp_path)
    dense_scene.write_pair_list(tmp_path)

    def load_dense_matcher(weights, *, options, **others):
        return dense_scene.MapMatcher(dense_scene.true_map(error_px=0.7), options)

    monkeypatch.setattr("dgc_pose.matchers.load_dense_matcher", load_dense_matcher)
    return tmp_path


@pytest.mark.parametrize("refine, error", [("none", (0.5, 1.5)), ("map", (0.0, 0.1))])
def test_matches_written_are_refined_and_the_map_is_not(folder, refine, error):
    result = run("match", "one.png", "two.png", "--out", "m.npz", "--refine", refine)
    assert result.exit_code == 0, result.stderr
    with np.load("m.npz", allow_pickle=False) as file:
        assert np.array_equal(file["map"], dense_scene.true_map(error_px=0.7).map)
        off = dense_scene.points_in_image1(file["points2"]) - file["points1"]
    assert error[0] < np.median(np.linalg.norm(off, axis=1)) < error[1]


def test_most_matches_hold_for_refined_ones_too(folder):
    options = ("--refine", "map", "--max-matches", "200")
    assert run("match", "one.png", "two.png", "--out", "m.npz", *options).exit_code == 0
    with np.load("m.npz", allow_pickle=False) as file:
        assert 50 <= len(file["points1"]) <= 200


def test_the_benchmark_refines_as_it_is_told(folder):
    errors = []
    for refine in ("none", "map"):
        result = run("bench-pairs", "pairs.txt", "--methods", "net", "--refine", refine)
        assert result.exit_code == 0, result.stderr
        row = result.stdout.splitlines()[-1].split()
        errors.append(float(row[6]))
    assert errors[1] < errors[0]
