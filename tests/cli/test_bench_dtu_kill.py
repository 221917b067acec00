"""A run killed again and again, and gone on with, ends as if nothing had happened."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import dtu_layout

KILLS = 5
ROWS = 20  # of the whole table: ten pairs by two methods
LIMIT_S = 300.0  # for a step that takes seconds on an idle machine


def _start(root: Path, out: Path, workers: int) -> subprocess.Popen[bytes]:
    """The command in a process group of its own."""
    arguments = [
        *("bench-dtu", "--root", str(root), "--out", str(out), "--pairs", "10", "--resume"),
        *("--methods", "dis,sift", "--protocol", "native", "--workers", str(workers)),
        *("--runs", "2", "--iterations", "100"),
    ]
    return subprocess.Popen(
        [sys.executable, "-c", "from dgc_pose.cli.main import main; main()", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def _finish(process: subprocess.Popen[bytes]) -> None:
    _, errors = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, errors.decode()


def _rows(out: Path) -> int:
    path = out / "results.csv"
    return max(path.read_bytes().count(b"\n") - 1, 0) if path.exists() else 0


def _kill_after(process: subprocess.Popen[bytes], out: Path, rows: int, delay: float) -> None:
    """Kill the command so many seconds after its table has so many rows, and see its pool end."""
    end = time.monotonic() + LIMIT_S
    while _rows(out) < rows and process.poll() is None:
        assert time.monotonic() < end
        time.sleep(0.005)
    time.sleep(delay)
    assert process.poll() is None, "the run ended before it could be killed"
    process.send_signal(signal.SIGKILL)
    process.communicate()
    while _group_is_there(process.pid):
        assert time.monotonic() < end, "a process of the pool has outlived the command"
        time.sleep(0.005)


def _group_is_there(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def test_five_kills_leave_no_trace(tmp_path) -> None:
    """Each kill comes at a random moment after a random number of further rows, the first before
    there is any; the processes of the pool end with their owner."""
    root = tmp_path / "dtu"
    dtu_layout.write_raw(root, dtu_layout.rendered_scan())
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    _finish(_start(root, whole, workers=1))
    chance = random.Random(0)
    seen = []
    for kill in range(KILLS):
        # A machine may have made every row by now: the report is killed then.
        rows = min(_rows(killed) + chance.randint(1, 3), ROWS) if kill else 0
        _kill_after(_start(root, killed, workers=2), killed, rows, chance.uniform(0, 0.1))
        seen.append(_rows(killed))
    assert seen == sorted(seen) and any(0 < rows < ROWS for rows in seen)
    _finish(_start(root, killed, workers=2))
    for name in ("results.csv", "pairs.csv", "run.json"):
        assert (killed / name).read_bytes() == (whole / name).read_bytes()
    assert (killed / "timings.csv").read_bytes().count(b"\n") == ROWS + 1
    assert sorted(os.listdir(killed / "matches")) == sorted(os.listdir(whole / "matches"))
