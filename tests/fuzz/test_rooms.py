"""Disks that are full, and clocks that jump, while whole commands run."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time
from pathlib import Path

import dense_scene
import pytest
from batch_runs import view_folder
from click.testing import CliRunner
from fuzz.readers import make_batch
from multi_view import K_text

from dgc_pose.cli.main import main
from dgc_pose.files.outputs import require_room

FULL = """
import resource, sys
from dgc_pose.cli.main import main
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]),) * 2)
del sys.argv[1]
main()
"""
BATCH = ("batch", "views", "--out", "out", "--pairs", "exhaustive", "--weights", "sift")
QUICK = ("--workers", "1", "--runs", "1", "--iterations", "100")


def full(folder: Path, size: int, *words: str) -> subprocess.CompletedProcess[str]:
    """A command whose files cannot become larger than `size` bytes."""
    return subprocess.run(
        [sys.executable, "-c", FULL, str(size), *words],
        cwd=folder,
        capture_output=True,
        text=True,
    )


@pytest.mark.parametrize(
    ("size", "output", "words"),
    [
        (4000, "x.db", ("--database", "x.db")),
        (60_000, "x.db", ("--database", "x.db")),
        (500, "h/features.h5", ("--hloc", "h")),
    ],
)
def test_an_export_onto_a_full_disk_is_one_line(
    tmp_path: Path, size: int, output: str, words: tuple[str, ...]
) -> None:
    """SQLite's and HDF5's errors once ended the process, and left files."""
    (tmp_path / "batch").mkdir()
    make_batch(tmp_path / "batch")
    found = full(tmp_path, size, "export-colmap", "batch", "--sharing", "cells", *words)
    assert (found.returncode, found.stdout) == (2, "")
    assert found.stderr.startswith(f"error: {output}: ") and found.stderr.count("\n") == 1
    assert [
        path for path in tmp_path.rglob("*") if path.is_file() and "batch" not in str(path)
    ] == []


def test_a_batch_onto_a_full_disk_goes_on_when_there_is_room(tmp_path: Path) -> None:
    view_folder(tmp_path / "views", 2)
    words = (*BATCH, "--K", K_text(), *QUICK)
    found = full(tmp_path, 3000, *words)
    assert (found.returncode, found.stdout) == (2, "")
    assert found.stderr.startswith("error: out/parts/") and found.stderr.count("\n") == 1
    again = full(tmp_path, 10**8, *words, "--resume")
    assert again.returncode == 0, again.stderr
    names = {"plan.json", "pairs.jsonl", "matches.h5", "summary.json"}
    assert set(os.listdir(tmp_path / "out")) == names


def test_room_is_looked_for_without_a_trace(tmp_path: Path) -> None:
    require_room(tmp_path / "model", 2**20)
    assert os.listdir(tmp_path) == []
    with pytest.raises(OSError, match="no/model"):
        require_room(tmp_path / "no/model", 2**20)
    code = "import resource\nfrom pathlib import Path\n"
    code += "from dgc_pose.files.outputs import require_room\n"
    code += "resource.setrlimit(resource.RLIMIT_FSIZE, (9, 9))\nrequire_room(Path('model'), 10)"
    found = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True)
    assert b"File too large: 'model'" in found.stderr


def test_a_clock_that_jumps_changes_no_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Back and forth by days, at each look; the files of the run are of another century."""
    monkeypatch.chdir(tmp_path)
    dense_scene.write_pair_list(tmp_path, pairs=2)
    words = ["bench-pairs", "pairs.txt", "--methods", "dis,sift", "--runs", "1", "--out"]
    assert CliRunner().invoke(main, [*words, "whole"]).exit_code == 0
    chance, real = random.Random(0), time.time
    monkeypatch.setattr(time, "time", lambda: real() + chance.uniform(-(10**6), 10**6))
    assert CliRunner().invoke(main, [*words, "out", "--limit", "1"]).exit_code == 0
    rows = Path("out/results.csv").read_bytes()
    Path("out/results.csv").write_bytes(rows[: rows.rindex(b"sift")])
    for number, path in enumerate(sorted(Path("out").iterdir())):
        os.utime(path, (number * 10**9, 4 * 10**9 - number * 10**9))
    resumed = CliRunner().invoke(main, [*words, "out", "--limit", "1", "--resume"])
    assert resumed.exit_code == 0, resumed.output
    whole, found = (
        [line.split(",")[:-2] for line in Path(name, "results.csv").read_text().splitlines()]
        for name in ("whole", "out")
    )  # but for the seconds that a pair took, by a clock that does not jump
    assert found == whole[:3]
    ends = [line.split(",")[-2:] for line in Path("out/results.csv").read_text().splitlines()]
    assert all(0 < float(seconds) < 1000 for line in ends[1:] for seconds in line)


@pytest.mark.parametrize("kind", ["cameras", "database"])
def test_temporary_files_without_room_are_told_under_their_own_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """They once read as the fault of the input that they are a copy of."""
    view_folder(tmp_path / "views", 2)
    (tmp_path / "t").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "t"))
    (tmp_path / "cameras.txt").write_text("# a camera a line\n" * 1000)
    (tmp_path / "x.db").write_bytes(bytes(20_000))
    words = {
        "cameras": (*BATCH, "--K", "cameras.txt", *QUICK),
        "database": ("batch", "x.db", *BATCH[2:4], "--weights", "sift", *QUICK),
    }
    found = full(tmp_path, 10_000, *words[kind])
    assert (found.returncode, found.stdout) == (2, "")
    assert found.stderr.count("\n") == 1 and found.stderr.endswith(": File too large\n")
    assert f"{tmp_path / 't'}/dgc-pose." in found.stderr
    assert os.listdir(tmp_path / "t") == []
