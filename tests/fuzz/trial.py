"""The trial: every reader, fed with damaged files until a number or a time is reached.

    PYTHONPATH=tests python -m fuzz.trial --inputs 100000
    PYTHONPATH=tests python -m fuzz.trial --minutes 30 --seed 7 --doors images,weights

A child process reads, so that a crash or a hang is found and the trial goes on behind it. An input
is a door, a seed and a number, so that every fault can be repeated:

    PYTHONPATH=tests python -m fuzz.trial --doors images --only 1234 --seed 7

A fault is: an exception that is none of ours, a message of several lines or without a file's name,
anything printed, more than `SECONDS` of a processor, more than `MEMORY`, a file that is left or
changed, and the death of the process.
"""

from __future__ import annotations

import argparse
import json
import logging
import math
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from fuzz.doors import Door

SECONDS = 10.0  # of processor time, for one input
WALL = 120.0  # seconds without an answer, on a busy machine
MEMORY = 1.5 * 2**30  # bytes resident, of the whole process
_STEP = 200  # inputs of a door in one go


@dataclass
class Result:
    """What a trial found."""

    inputs: Counter[str] = field(default_factory=Counter)  # by door
    refused: Counter[str] = field(default_factory=Counter)
    slowest: dict[str, float] = field(default_factory=dict)  # seconds of a processor, by door
    memory: dict[str, float] = field(default_factory=dict)  # bytes, the most resident, by door
    resident: list[float] = field(default_factory=list)  # bytes, after each go
    faults: list[dict[str, Any]] = field(default_factory=list)

    def add(self, door: str, answer: dict[str, Any]) -> None:
        """The answer of one input."""
        self.inputs[door] += 1
        self.refused[door] += answer["refused"]
        self.slowest[door] = max(self.slowest.get(door, 0.0), answer["seconds"])
        self.memory[door] = max(self.memory.get(door, 0.0), answer["memory"])
        if answer["fault"]:
            self.faults.append({"door": door, **answer})


class Reader:
    """The doors with their folders, in one process. Lives within `folder`."""

    def __init__(self, folder: Path, doors: Sequence[Door]) -> None:
        self.doors = {door.name: door for door in doors}
        self.folders: dict[str, Path] = {}
        self.good: dict[str, dict[Path, bytes]] = {}
        for name, door in self.doors.items():
            own = folder / name.replace(" ", "_")
            own.mkdir()
            door.make(own)
            self.folders[name] = own
            self.good[name] = {path: path.read_bytes() for path in door.files(own)}

    def read(self, name: str, seed: int, number: int) -> tuple[str, bool]:
        """The fault of one input, "" for none, and whether it was refused."""
        from fuzz.mutators import mutated

        from dgc_pose.errors import DgcPoseError

        door, folder, good = self.doors[name], self.folders[name], self.good[name]
        rng = np.random.default_rng([seed, sum(map(ord, name)), number])
        path = list(good)[rng.integers(len(good))]
        data = mutated(good[path], door.mutators[path.suffix], rng)
        path.write_bytes(data)
        before = {one.name for one in folder.iterdir()}
        try:
            door.read(folder, path)
            fault, refused = "", False
        except (DgcPoseError, OSError) as error:
            fault, refused = _wrong(error), True
        except BaseException:
            fault, refused = traceback.format_exc(limit=-4), True
        if not path.exists() or path.read_bytes() != data:
            fault = fault or "the input was changed"
        if {one.name for one in folder.iterdir()} != before:
            fault = fault or "a file was left"
        path.write_bytes(good[path])
        return fault, refused


def _wrong(error: Exception) -> str:
    """What is wrong with an error that a reader may raise."""
    text = str(error)
    if isinstance(error, OSError):
        return "" if error.filename is not None and error.strerror else f"no file in {error!r}"
    if "\n" in text:
        return f"several lines: {text!r}"
    return "" if text and len(text) < 5500 else f"no message, or an endless one: {text[:80]!r}"


def child(folder: Path, doors: Sequence[Door], seed: int) -> None:
    """Answers lines "door<TAB>first<TAB>count" on stdin with one line of JSON an input."""
    logging.disable()
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    printed = open(folder / "printed", "wb+", buffering=0)  # noqa: SIM115
    os.dup2(printed.fileno(), 1)
    os.dup2(printed.fileno(), 2)
    reader = Reader(folder, doors)
    printed.truncate(0)
    answers.write("ready\n")
    for line in sys.stdin:
        name, first, count = line.rstrip("\n").split("\t")
        for number in range(int(first), int(first) + int(count)):
            answers.write(json.dumps({"number": number}) + "\n")
            _forget_peak()
            start = time.process_time()
            fault, refused = reader.read(name, seed, number)
            seconds, memory = time.process_time() - start, _peak()
            if os.fstat(printed.fileno()).st_size:
                printed.seek(0)
                fault = fault or f"printed: {printed.read(300)!r}"
                printed.truncate(0)
                printed.seek(0)
            if seconds > SECONDS:
                fault = fault or f"{seconds:.1f} s"
            if memory > MEMORY:
                fault = fault or f"{memory / 2**20:.0f} MiB"
            answer = {"refused": refused, "seconds": seconds, "memory": memory, "fault": fault}
            answers.write(json.dumps(answer) + "\n")
        answers.write(json.dumps({"done": resident()}) + "\n")


def _forget_peak() -> None:
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        pass


def _peak() -> float:
    """Bytes: the most that was resident since `_forget_peak`."""
    return _status("VmHWM")


def resident() -> float:
    """Bytes."""
    return _status("VmRSS")


def _status(name: str) -> float:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(name):
            return int(line.split()[1]) * 1024.0
    return 0.0


class Child:
    """A reading process, watched."""

    def __init__(self, command: Sequence[str]) -> None:
        """command: arguments of Python; the folder to work in is added."""
        self.folder = Path(tempfile.mkdtemp(prefix="dgc-pose-fuzz-"))
        self.process = subprocess.Popen(
            [sys.executable, *command, str(self.folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self._rest = b""
        self.resident = 0.0  # bytes, after the last inputs
        if self.line(300) != b"ready":
            raise RuntimeError("the reading process does not start")

    def line(self, seconds: float) -> bytes:
        """The next line; b"" if the process died, or gave none for so long and was killed."""
        assert self.process.stdout is not None
        pipe = self.process.stdout.fileno()
        while b"\n" not in self._rest:
            if not select.select([pipe], [], [], seconds)[0]:
                self.process.kill()
                return b""
            part = os.read(pipe, 2**16)
            if not part:
                return b""
            self._rest += part
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def read(self, name: str, first: int, count: int) -> Iterator[dict[str, Any]]:
        """The answers of inputs of a door; the last has a fault if the process dies."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{name}\t{first}\t{count}\n".encode())
        self.process.stdin.flush()
        number = first
        while line := self.line(WALL):
            answer = json.loads(line)
            if "done" in answer:
                self.resident = float(answer["done"])
                return
            number = answer.get("number", number)
            if "refused" in answer:
                yield {"number": number, **answer}
        code = self.process.wait()
        fault = f"the process died by {code}, or had no answer in {WALL:.0f} s"
        yield {"number": number, "refused": True, "seconds": 0, "memory": 0, "fault": fault}

    @property
    def alive(self) -> bool:
        return self.process.poll() is None

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)


def run(
    goes: Mapping[str, int],
    command: Sequence[str],
    inputs: int | None = None,
    minutes: float | None = None,
    tell: bool = True,
) -> Result:
    """The trial, door by door in turn, until so many inputs or minutes are over.

    goes: inputs of each door before the next one's turn. command: of a reading process.
    """
    end = math.inf if minutes is None else time.monotonic() + 60 * minutes
    most = math.inf if inputs is None else inputs
    result, reader = Result(), Child(command)
    try:
        while True:
            for door, go in goes.items():
                count = int(min(go, most - result.inputs.total()))
                if count <= 0 or time.monotonic() > end:
                    return result
                first = result.inputs[door]
                for answer in reader.read(door, first, count):
                    result.add(door, answer)
                    if tell and answer["fault"]:
                        print(f"FAULT {door} {answer['number']}: {answer['fault']}", flush=True)
                if not reader.alive:
                    reader.close()
                    reader = Child(command)
                result.resident.append(reader.resident)
            if tell:
                print(f"{result.inputs.total()} inputs, {len(result.faults)} faults", flush=True)
    finally:
        reader.close()


def summary(result: Result) -> str:
    """The table of a trial, and its faults."""
    lines = [f"{'door':16} {'inputs':>8} {'refused':>8} {'slowest s':>10} {'peak MiB':>9}"]
    for name, count in result.inputs.items():
        refused = f"{100 * result.refused[name] / count:.0f} %"
        peak = result.memory[name] / 2**20
        lines.append(f"{name:16} {count:8} {refused:>8} {result.slowest[name]:10.2f} {peak:9.0f}")
    lines.append(f"{'in all':16} {result.inputs.total():8}; {len(result.faults)} faults")
    first, last = (result.resident or [0.0])[0], (result.resident or [0.0])[-1]
    lines.append(
        f"resident after the first round {first / 2**20:.0f} MiB, after the last "
        f"{last / 2**20:.0f} MiB"
    )
    lines += [f"FAULT {one['door']} {one['number']}: {one['fault']}" for one in result.faults[:50]]
    return "\n".join(lines)


def main() -> int:
    from fuzz.doors import DOORS

    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--inputs", type=int)
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--doors", default="", help="comma-separated; default: all")
    parser.add_argument("--only", type=int, help="one input of one door, in this process")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    given = parser.parse_args()
    names = [name for name in given.doors.split(",") if name]
    doors = [door for door in DOORS if not names or door.name in names]
    if given.child:
        child(Path(given.child), doors, given.seed)
        return 0
    if given.only is not None:
        with tempfile.TemporaryDirectory() as folder:
            fault, refused = Reader(Path(folder), doors).read(doors[0].name, given.seed, given.only)
        print("refused" if refused else "accepted", fault or "no fault")
        return bool(fault)
    command = ["-m", "fuzz.trial", "--doors", given.doors, "--seed", str(given.seed), "--child"]
    goes = {door.name: int(_STEP * door.weight) for door in doors}
    result = run(goes, command, given.inputs, given.minutes)
    print(summary(result))
    return bool(result.faults)


if __name__ == "__main__":
    sys.exit(main())
