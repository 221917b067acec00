from __future__ import annotations

import os

import numpy as np
import pytest
from click.testing import CliRunner
from dtu_layout import grey_scan, write_neus, write_raw

from dgc_pose.cameras.pair_list import read_pairs
from dgc_pose.cli.main import main
from dgc_pose.metrics import rotation_error_deg


def dtu_pairs(*arguments):
    return CliRunner().invoke(main, ["dtu-pairs", *arguments])


@pytest.fixture
def root(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_raw(tmp_path / "dtu", grey_scan(np.arange(0, 60, 6.0)), extension="jpg")
    (tmp_path / "dtu/Rectified/scan65/rect_003_3_r5000.jpg").unlink()
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
    result = dtu_pairs("dtu", "list.txt", "--scan", "65", "--pairs", "900")
    assert result.exit_code == 0
    assert "warning: 900 pairs were asked for" in result.stderr
    assert len(read_pairs("list.txt", root="dtu")) < 40


def test_the_layout_makes_no_difference_but_in_the_names(root):
    write_neus(root / "neus", grey_scan(np.arange(0, 60, 6.0)))
    assert dtu_pairs("dtu", "a", "--scan", "65", "--pairs", "900").exit_code == 0
    assert dtu_pairs("neus", "b", "--scan", "65", "--pairs", "900").exit_code == 0
    lists = []
    for name, folder in (("a", "dtu"), ("b", "neus")):
        read = read_pairs(name, root=folder)
        assert all(pair.path1.is_file() and pair.path2.is_file() for pair in read)
        lists.append({line.split(" ", 2)[2] for line in (root / name).read_text().splitlines()})
    assert lists[0] < lists[1]  # the first layout lacks the third image


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("nowhere", "list.txt", "--scan", "65"), "nowhere"),
        (("dtu", "list.txt", "--scan", "9"), "scan9"),
        (("dtu", "list.txt", "--scan", "65", "--light", "1"), "rect_001_1_r5000"),
        (("dtu", "list.txt", "--scan", "65", "--layout", "neus"), "neus"),
        (("dtu", "list.txt", "--scan", "65", "--min-rotation", "50"), "rotation"),
        (
            ("dtu", "list.txt", "--scan", "65", "--min-rotation", "6.5", "--max-rotation", "7"),
            "no two",
        ),
        (("dtu", "list.txt", "--scan", "65", "--pairs", "0"), "pairs"),
        (("dtu", "none/list.txt", "--scan", "65"), "none/list.txt"),
    ],
)
def test_unusable_input_is_one_line_and_writes_nothing(root, arguments, words):
    result = dtu_pairs(*arguments)
    assert result.exit_code == 2
    assert result.stderr.startswith("error: ") and result.stderr.count("\n") == 1
    assert words in result.stderr
    assert os.listdir(root) == ["dtu"]
