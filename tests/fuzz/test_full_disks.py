"""Disks that are full while whole commands run: the system's words, and nothing that is half."""

import os
import subprocess
import sys
from pathlib import Path

import dense_scene
import pytest
from batch_runs import view_folder
from fuzz.readers import make_batch
from multi_view import K_text

FULL = """
import resource, sys
from dgc_pose.cli.main import main
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv.pop(1)),) * 2)
main()
"""
BATCH = ("batch", "views", "--out", "out", "--pairs", "exhaustive", "--weights", "sift")
BATCH += ("--workers", "1", "--runs", "1", "--iterations", "100")


def full(folder: Path, size: int, *words: str) -> subprocess.CompletedProcess[str]:
    """A command whose files cannot become larger than `size` bytes."""
    command = [sys.executable, "-c", FULL, str(size), *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


@pytest.mark.parametrize(
    ("size", "line", "words"),
    [
        (0, "x.db: File too large\n", ("--database", "x.db")),
        (60_000, "x.db: File too large\n", ("--database", "x.db")),
        (200_000, "x.db: File too large\n", ("--database", "x.db")),
        (500, "h/features.h5: ", ("--hloc", "h")),
    ],
)
def test_an_export_onto_a_full_disk_is_one_line(
    tmp_path: Path, size: int, line: str, words: tuple[str, ...]
) -> None:
    """The system's words. SQLite's and HDF5's errors once ended the process, and left files."""
    (tmp_path / "batch").mkdir()
    make_batch(tmp_path / "batch")
    ended = full(tmp_path, size, "export-colmap", "batch", "--sharing", "cells", *words)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.startswith(f"error: {line}") and ended.stderr.count("\n") == 1
    assert not list(tmp_path.glob("h/*")) and not list(tmp_path.glob("x.db*"))


def test_a_batch_onto_a_full_disk_goes_on_when_there_is_room(tmp_path: Path) -> None:
    view_folder(tmp_path / "views", 2)
    words = (*BATCH, "--K", K_text())
    ended = full(tmp_path, 3000, *words)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.startswith("error: out/matched.bin: ") and ended.stderr.count("\n") == 1
    again = full(tmp_path, 10**8, *words, "--resume")
    assert again.returncode == 0, again.stderr
    names = {"plan.json", "pairs.jsonl", "matches.h5", "summary.json"}
    assert set(os.listdir(tmp_path / "out")) == names


def test_points_onto_a_full_disk_are_one_line(tmp_path: Path) -> None:
    dense_scene.write_pictures(tmp_path)
    words = ("--K", dense_scene.K_TEXT, "--weights", "sift", "--ply", "points.ply")
    ended = full(tmp_path, 500, "estimate", "one.png", "two.png", *words)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.startswith("error: points.ply: ") and ended.stderr.count("\n") == 1
    assert sorted(os.listdir(tmp_path)) == ["one.png", "two.png"]
