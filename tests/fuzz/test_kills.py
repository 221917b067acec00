"""Commands that are killed while they work, and run again, end as if nothing had happened."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import dtu_layout
import pytest

LIMIT_S = 300.0  # for what takes seconds on an idle machine
QUICK = ("--workers", "2", "--runs", "2", "--iterations", "100", "--resume")


def _dtu(folder: Path) -> Sequence[str]:
    dtu_layout.write_raw(folder, dtu_layout.rendered_scan())
    words = ("--pairs", "10", "--methods", "dis,sift", "--protocol", "native")
    return ("bench-dtu", "--root", str(folder), *words, *QUICK)


def _rows(out: Path) -> int:
    path = out / "results.csv"
    return path.read_bytes().count(b"\n") - 1 if path.exists() else 0


@pytest.mark.parametrize(
    ("make", "done", "most", "results"),
    [
        (_dtu, _rows, 20, ("results.csv", "pairs.csv", "run.json")),
    ],
    ids=["bench-dtu"],
)
def test_kills_leave_no_trace(
    tmp_path: Path,
    make: Callable[[Path], Sequence[str]],
    done: Callable[[Path], int],
    most: int,
    results: Sequence[str],
) -> None:
    """One kill comes before there is a result, others among them; the processes of the pool end
    with their command."""
    words = make(tmp_path / "inputs")
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    _finish(_start(words, whole))
    for count in (0, 1, most // 2):
        process = _start(words, killed)
        _wait(lambda: killed.exists() and done(killed) >= count or process.poll() == 0)  # noqa: B023
        process.send_signal(signal.SIGKILL)
        process.communicate()
        _wait(lambda: not _is_there(process.pid))  # noqa: B023
    _finish(_start(words, killed))
    files = [sorted(path.relative_to(out) for path in out.rglob("*")) for out in (whole, killed)]
    assert files[0] == files[1]
    for name in results:
        assert (killed / name).read_bytes() == (whole / name).read_bytes()


def _start(words: Sequence[str], out: Path) -> subprocess.Popen[bytes]:
    """The command in a process group that it leads."""
    code = "from dgc_pose.cli.main import main; main()"
    return subprocess.Popen(
        [sys.executable, "-c", code, *words, "--out", str(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def _finish(process: subprocess.Popen[bytes]) -> None:
    _, errors = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, errors.decode()


def _wait(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def _is_there(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True
