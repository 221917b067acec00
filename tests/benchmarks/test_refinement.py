"""The ablation of refinement: a line a variant and threshold, on one list."""

from __future__ import annotations

import dense_scene
import pytest
from click.testing import CliRunner

from dgc_pose.benchmarks import refinement


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    dense_scene.write_pair_list(tmp_path, pairs=2)
    scene = dense_scene.true_map(error_px=0.7)
    matcher = dense_scene.MapMatcher(scene)
    monkeypatch.setattr(refinement, "load_dense_matcher", lambda weights: matcher)
    return tmp_path


def run(*arguments):
    return CliRunner().invoke(refinement.main, arguments)


def test_a_line_for_each_variant_and_threshold(folder):
    variants = ("none", "map-only", "map", "flow")
    result = run("pairs.txt", "--variants", ",".join(variants), "--thresholds", "own,0.5")
    assert result.exit_code == 0, result.output
    rows = [line.split() for line in result.stdout.splitlines()[1:]]
    assert [tuple(row[:4]) for row in rows] == [
        (name, threshold, "2", "0")
        for name in variants
        for threshold in ("own", "0.5")
    ]
    error = {row[0]: float(row[5]) + float(row[6]) for row in rows if row[1] == "own"}
    assert error["map"] < 0.5 * error["none"] and error["flow"] < 0.5 * error["none"]


@pytest.mark.parametrize(
    "arguments, words",
    [
        ((), "LIST"),
        (("pairs.txt", "--photos", "."), "LIST"),
        (("pairs.txt", "--variants", "magic"), "magic"),
        (("pairs.txt", "--thresholds", "wide"), "wide"),
        (("nosuch.txt",), "nosuch.txt"),
    ],
)
def test_unusable_arguments_are_one_line(folder, arguments, words):
    result = run(*arguments)
    assert result.exit_code != 0
    assert words in result.stderr and result.stderr.count("Error") == 1
    assert isinstance(result.exception, SystemExit)
