"""Whole commands, stopped and killed at random moments, and run again.

    PYTHONPATH=tests python -m fuzz.kills --moments 20 --seed 1
    PYTHONPATH=tests python -m fuzz.kills --scenarios batch,train --minutes 10

A moment is a scenario, a signal and a time. A scenario goes through one to three of them, one after
the other, and is then run to its end. A fault is: a result that is not that of a run which nothing
disturbed; a file that is left, in the folder or among the temporary files; an output that is not
whole; a process that outlives its command; a traceback; more than one line of error after a signal.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import dense_scene
import dtu_layout
import h5py
import multi_view
import numpy as np
import verdict_folder

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
LIMIT_S = 600.0  # for a command, on a busy machine
ORPHAN_S = 30.0  # for the processes of a command that has ended
MAIN = "from dgc_pose.cli.main import main; main()"


@dataclass(frozen=True)
class Scenario:
    """A command. It runs in a folder of its own, and its inputs lie in another."""

    make: Callable[[Path], object]  # the inputs
    words: Callable[[Path], Sequence[str]]  # the command line, by the folder of the inputs
    again: Sequence[str] = ()  # further words of all but the first run
    first: Sequence[str] = ()  # further words of the first run
    disturbed: Sequence[str] = ()  # further words of runs that are stopped


def _photos(folder: Path) -> None:
    verdict_folder.write_photos(folder / "photos", 24)


def _pictures(folder: Path) -> None:
    dense_scene.write_pictures(folder)


def _views(count: int) -> Callable[[Path], object]:
    return lambda folder: multi_view.write_views(folder / "views", multi_view.render_views(count))


_QUICK = ("--runs", "1", "--iterations", "300")
_OUT = ("--overwrite", "--json", "o.json", "--matches", "o.npz", "--plot", "o.png")
_VIEWS = ("--K", multi_view.K_text(), "--weights", "sift", "--workers", "2", *_QUICK)
SCENARIOS: Mapping[str, Scenario] = {
    "estimate": Scenario(
        _pictures,
        lambda folder: [
            *("estimate", f"{folder}/one.png", f"{folder}/two.png", "--K", dense_scene.K_TEXT),
            *(*_QUICK, *_OUT),
        ],
    ),
    "estimate sift": Scenario(
        _pictures,
        lambda folder: [
            *("estimate", f"{folder}/one.png", f"{folder}/two.png", "--K", dense_scene.K_TEXT),
            *("--weights", "sift", *_QUICK, *_OUT),
        ],
    ),
    "batch": Scenario(
        _views(5),
        lambda folder: [
            *("batch", f"{folder}/views", "--out", "out", "--pairs", "exhaustive", *_VIEWS),
        ],
        again=("--resume",),
    ),
    "reconstruct": Scenario(
        _views(5),
        lambda folder: ["reconstruct", f"{folder}/views", "--out", "out", *_VIEWS],
        again=("--resume",),
    ),
    "bench-pairs": Scenario(
        lambda folder: dense_scene.write_pair_list(folder, pairs=6),
        lambda folder: [
            *("bench-pairs", f"{folder}/pairs.txt", "--methods", "dis,sift", "--out", "out"),
            *("--workers", "2", "--json", "o.json", "--overwrite", *_QUICK),
        ],
        again=("--resume",),
    ),
    "bench-dtu": Scenario(
        lambda folder: dtu_layout.write_raw(folder / "dtu", dtu_layout.rendered_scan()),
        lambda folder: [
            *("bench-dtu", "--root", f"{folder}/dtu", "--out", "out", "--pairs", "6"),
            *("--methods", "dis,sift", "--protocol", "native", "--workers", "2", *_QUICK),
        ],
        again=("--resume",),
    ),
    "train": Scenario(
        _photos,
        lambda folder: [
            *("train", "--photos", f"{folder}/photos", "--out", "out", "--steps", "6"),
            *("--preset", "dgcm-lite0", "--batch", "1", "--validation-pairs", "1"),
            *("--threads", "1"),
        ],
        again=("--resume",),
        disturbed=("--stop-after", "0.03"),  # so that checkpoints are written
    ),
}


@dataclass
class Result:
    """What was seen."""

    moments: Counter[str] = field(default_factory=Counter)  # by scenario and signal
    ended: Counter[str] = field(default_factory=Counter)  # runs that were done before the signal
    # From a signal other than SIGKILL to the end of the command, at most: of its processor, and by
    # the clock, which on a busy machine says little.
    slowest_cpu_s: float = 0.0
    slowest_s: float = 0.0
    faults: list[str] = field(default_factory=list)


class Bench:
    """One scenario in a folder: the inputs, the undisturbed run, and the disturbed ones."""

    def __init__(self, scenario: Scenario, folder: Path, stable: Sequence[str] = ()) -> None:
        """stable: files that are the same in each run; found by a second run unless given."""
        self.scenario = scenario
        self.folder = folder
        self.inputs = folder / "inputs"
        self.inputs.mkdir()
        scenario.make(self.inputs)
        start = time.monotonic()
        self.whole = self._finished("whole", scenario.first)
        self.seconds = time.monotonic() - start
        # Times are in some files; of those the name alone is compared.
        self.stable = set(stable)
        if not stable:
            second = self._finished("second", scenario.first)
            self.stable = {name for name, one in self.whole.items() if second.get(name) == one}

    def disturb(self, name: str, plan: Sequence[tuple[int, float]], result: Result) -> None:
        """Run the command, with each signal after its share of the undisturbed time; then to its
        end, and compare."""
        out = self.folder / name
        out.mkdir()
        faults: list[str] = []
        for number, share in plan:
            words = (*self._further(out), *self.scenario.disturbed)
            faults += self._signalled(out, words, number, share * self.seconds, result)
        found = self._finished(name, self._further(out), faults)
        if found.keys() != self.whole.keys():
            faults.append(f"files: {sorted(found.keys() ^ self.whole.keys())}")
        faults += [f"{one} differs" for one in self.stable if found.get(one) != self.whole[one]]
        if all(number != signal.SIGKILL for number, _ in plan):
            faults += [f"temporary: {left}" for left in _temporary(out)]
        result.faults += [f"{plan}: {fault}" for fault in faults]

    def _further(self, out: Path) -> Sequence[str]:
        return self.scenario.again if any(out.iterdir()) else self.scenario.first

    def _start(self, out: Path, further: Sequence[str]) -> subprocess.Popen[str]:
        temporary = out.with_name(f"{out.name}.tmp")
        temporary.mkdir(exist_ok=True)
        return subprocess.Popen(
            [sys.executable, "-c", MAIN, *self.scenario.words(self.inputs), *further],
            cwd=out,
            env=os.environ | {"TMPDIR": str(temporary), "OMP_NUM_THREADS": "1"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            # A shell's background job, as this one may be, ignores it, and so would the command.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )

    def _finished(
        self, name: str, further: Sequence[str], faults: list[str] | None = None
    ) -> dict[str, str]:
        """The files of a run to its end, as far as they can be compared."""
        out = self.folder / name
        out.mkdir(exist_ok=True)
        _, told = self._start(out, further).communicate(timeout=LIMIT_S)
        if faults is None:
            assert "error" not in told, told
        elif "error: " in told or "Traceback" in told:
            faults.append(f"the last run: {told[-400:]}")
        return {str(path.relative_to(out)): digest(path) for path in _files(out)}

    def _signalled(
        self, out: Path, further: Sequence[str], number: int, seconds: float, result: Result
    ) -> Iterator[str]:
        """The faults of a run that gets a signal after so many seconds."""
        process = self._start(out, further)
        try:
            process.communicate(timeout=seconds)
            result.ended[signal.Signals(number).name] += 1
            return
        except subprocess.TimeoutExpired:
            pass
        start, before = time.monotonic(), _processor_s(process.pid)
        spent = before
        if number == signal.SIGINT:  # a terminal sends it to all
            os.killpg(process.pid, number)
        else:
            process.send_signal(number)
        while True:
            try:
                _, told = process.communicate(timeout=0.05)
                break
            except subprocess.TimeoutExpired:
                spent = max(spent, _processor_s(process.pid))
            if time.monotonic() - start > LIMIT_S:
                os.killpg(process.pid, signal.SIGKILL)
                yield "the command does not end"
                return
        if number != signal.SIGKILL:
            result.slowest_cpu_s = max(result.slowest_cpu_s, spent - before)
            result.slowest_s = max(result.slowest_s, time.monotonic() - start)
            yield from _told_wrong(told, process.returncode, number)
            yield from (f"left: {path}" for path in _files(out) if ".partial" in str(path))
            yield from (f"left: {path}" for path in _temporary(out))
        while left := _session(process.pid):
            if time.monotonic() - start > ORPHAN_S:
                yield f"processes outlive the command: {left}"
                os.killpg(process.pid, signal.SIGKILL)
                return
            time.sleep(0.05)
        yield from (f"not whole: {path}" for path in _files(out) if not is_whole(path))


def _told_wrong(told: str, code: int, number: int) -> Iterator[str]:
    """What is wrong with the end of a command that was asked to stop."""
    errors = [line for line in told.splitlines() if line.startswith("error: ")]
    if code not in (0, -number, 128 + number):
        yield f"exit {code}: {told[-400:]}"
    if len(errors) > 1 or "Traceback" in told or "***" in told:
        yield f"printed: {told[-1500:]}"


def _files(folder: Path) -> list[Path]:
    """But for a training's logs: each stop adds a validation to them."""
    found = (path for path in folder.rglob("*") if not path.name.endswith("_log.csv"))
    return sorted(path for path in found if path.is_file())


def _temporary(out: Path) -> list[str]:
    """What is left among temporary files; torch keeps a cache there on purpose."""
    found = os.listdir(out.with_name(f"{out.name}.tmp"))
    return [name for name in found if not name.startswith("torchinductor_")]


def _processor_s(process: int) -> float:
    """Seconds of a processor that a process has taken; 0 if it has ended."""
    try:
        words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def _session(number: int) -> list[str]:
    """The processes of a session that are not ended."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, session = path.read_text().rpartition(")")[2].split()[:4]
            if int(session) == number and state != "Z":
                found.append((path.parent / "cmdline").read_text().replace("\0", " ")[:200])
        except OSError:  # it has ended
            continue
    return found


def digest(path: Path) -> str:
    """Of what a file holds: archives have times beside it."""
    total = hashlib.sha256()
    if path.suffix == ".h5":
        with h5py.File(path) as file:
            file.visititems(
                lambda name, item: (
                    total.update(name.encode() + np.asarray(item).tobytes())
                    if isinstance(item, h5py.Dataset)
                    else None
                )
            )
    elif path.suffix == ".npz":
        with np.load(path) as archive:
            for name in sorted(archive):
                total.update(name.encode() + archive[name].tobytes())
    else:
        total.update(path.read_bytes())
    return total.hexdigest()


def is_whole(path: Path) -> bool:
    """Whether an output under its own name can be read. Tables grow by rows, and logs too."""
    if path.name.startswith(".") or path.parent.name.endswith(".partial"):
        return True
    try:
        if path.suffix == ".json":
            json.loads(path.read_text())
        elif path.suffix in (".npz", ".h5"):
            digest(path)
        elif path.suffix in (".png", ".jpg"):
            return cv2.imread(str(path)) is not None
        elif path.suffix == ".html":
            return path.read_text().rstrip().endswith("</html>")
        elif path.suffix == ".jsonl":
            return all(json.loads(line) for line in path.read_text().splitlines())
    except (ValueError, OSError, EOFError, zipfile.BadZipFile):
        return False
    return True


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--moments", type=int, default=20, help="of each scenario")
    parser.add_argument("--minutes", type=float, default=1e9, help="at most, of each scenario")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scenarios", default=",".join(SCENARIOS), help="comma-separated")
    given = parser.parse_args()
    faults = 0
    for name in given.scenarios.split(","):
        rng = np.random.default_rng([given.seed, sum(map(ord, name))])
        result, end = Result(), time.monotonic() + 60 * given.minutes
        with tempfile.TemporaryDirectory(prefix="dgc-pose-kills-") as folder:
            bench = Bench(SCENARIOS[name], Path(folder))
            for run in range(given.moments):
                if result.moments.total() >= given.moments or time.monotonic() > end:
                    break
                plan = [
                    (int(SIGNALS[rng.integers(3)]), float(rng.uniform(0.05, 1.1)))
                    for _ in range(rng.integers(1, 4))
                ]
                bench.disturb(f"run{run}", plan, result)
                result.moments.update(signal.Signals(number).name for number, _ in plan)
        moments = ", ".join(f"{count} {one}" for one, count in sorted(result.moments.items()))
        print(
            f"{name}: {moments}; {result.ended.total()} runs had ended before; {bench.seconds:.1f} "
            f"s undisturbed; from a signal to the end at most {result.slowest_cpu_s:.1f} s of a "
            f"processor, {result.slowest_s:.1f} s by the clock; {len(result.faults)} faults",
            flush=True,
        )
        for fault in result.faults:
            print(f"FAULT {name}: {fault}", flush=True)
        faults += len(result.faults)
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
