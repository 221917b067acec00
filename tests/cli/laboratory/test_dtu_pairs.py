import csv
import os

import numpy as np
import pytest
from command_line import assert_refused, run
from dtu_layout import write_scan

from dgc_pose.cameras.pair_list import read_pairs
from dgc_pose.metrics import rotation_error_deg


def dtu_pairs(*arguments):
    return run("dtu-pairs", *arguments)


@pytest.fixture
def root(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_scan(tmp_path / "dtu", np.arange(0, 60, 6.0))
    (tmp_path / "dtu/Rectified/scan65/rect_003_3_r5000.png").unlink()
    return tmp_path


def test_a_list_is_written_that_reads_back(root):
    result = dtu_pairs("dtu", "list.txt", "--scan", "65", "--pairs", "9", "--max-rotation", "33")
    assert result.exit_code == 0
    assert "9 pairs" in result.stdout and "9 views, 40 left out" in result.stdout
    assert result.stderr == ""
    pairs = read_pairs("list.txt", root="dtu")
    assert len(pairs) == 9
    assert all(pair.path1.is_file() and pair.path2.is_file() for pair in pairs)
    rotations = [rotation_error_deg(pair.R, np.eye(3)) for pair in pairs]
    assert 5 <= min(rotations) and max(rotations) <= 33


def test_fewer_pairs_than_asked_for_are_told(root):
    result = dtu_pairs("dtu", "list.txt", "--pairs", "900")
    assert result.exit_code == 0
    assert "warning: 900 pairs were asked for" in result.stderr
    assert len(read_pairs("list.txt", root="dtu")) < 40


def test_the_benchmark_on_dtu_is_the_drawn_list_by_the_protocol_of_the_paper(root):
    drawn = ("--scan", "65", "--pairs", "3")
    scored = ("--methods", "sift", "--runs", "1", "--iterations", "50", "--out")
    assert run("bench-dtu", "dtu", *drawn, *scored, "run").exit_code == 0
    other = ("--scan", "65", "--pairs", "2", "--resume")
    assert run("bench-dtu", "dtu", *other, *scored, "run").exit_code == 2  # pairs.txt stays
    assert dtu_pairs("dtu", "list.txt", *drawn).exit_code == 0
    assert (root / "run/pairs.txt").read_bytes() == (root / "list.txt").read_bytes()
    words = ("list.txt", "--root", "dtu", "--protocol", "paper", *scored, "again")
    assert run("bench-pairs", *words).exit_code == 0
    first, second = (list(csv.DictReader(open(f"{name}/results.csv"))) for name in ("run", "again"))
    assert len(first) == 3
    for row, other in zip(first, second, strict=True):
        for name in ("image1", "image2", "status", "num_inliers", "rotation_error_deg"):
            assert row[name] == other[name]


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("dtu", "list.txt", "--scan", "9"), "scan9"),
        (("dtu", "list.txt", "--scan", "65", "--light", "1"), "light 1"),
        (
            ("dtu", "list.txt", "--scan", "65", "--min-rotation", "6.5", "--max-rotation", "7"),
            "no two",
        ),
    ],
)
def test_unusable_input_is_one_line_and_writes_nothing(root, arguments, words):
    assert_refused(dtu_pairs(*arguments), words)
    assert os.listdir(root) == ["dtu"]
