"""Every command with every option of a number or a path set to what it must refuse.

    PYTHONPATH=tests python -m fuzz.commands --commands 2000

The network is replaced by a map, so that a command which is not refused ends soon. A fault is: an
exit code other than 2, anything on stdout, more or less than one line on stderr, a traceback, a
file that is changed or left, or more than `SECONDS`.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import FrameType

import click
import cv2
import dense_scene
import numpy as np
from click.testing import CliRunner
from fuzz.readers import make_batch

from dgc_pose.cli.guard import OutputFile, OutputFolder
from dgc_pose.cli.main import SUBCOMMANDS, main

SECONDS = 10  # of a processor, for one command
WALL = 120  # seconds without an answer, on a busy machine
Case = tuple[str, ...]  # a command line
_NUMBERED = click.types.IntParamType | click.types.FloatParamType

NUMBERS = (
    "nan",
    "inf",
    "-inf",
    "1e400",
    "-1e3",
    "x",
    "",
    "9" * 30,
    "9" * 5000,
    "1;2",
    "٣x",
    "\udcff",
)
OUTPUTS = ("", "dir", "dir/", "one.png", "text.txt", "K.txt", "/dev/null", "fifo", "loop", "no/x/y")
OUTPUTS += ("x" * 5000, "-/", "link")
FOLDERS = ("", "one.png", "K.txt", "/dev/null", "fifo", "loop/x", "run", "x" * 5000)
INPUTS = (
    "",
    "nowhere",
    "dir",
    "/dev/zero",
    "/dev/null",
    "fifo",
    "loop",
    "empty",
    "junk",
    "/proc/kmsg",
)
INPUTS += ("x" * 5000, "\udcff.png", "huge.png", "claims.png", "junk.npy", "junk.pth")

K = ("--K", dense_scene.K_TEXT)
_BATCH = (*K, "--workers", "1", "--refine", "none", "--runs", "1")
# A command line that would succeed, but for what a case changes; None where that takes long.
BASE: dict[str, Sequence[str]] = {
    "estimate": ("one.png", "two.png", *K, "--refine", "none", "--runs", "1"),
    "match": ("one.png", "two.png", "--refine", "none", "--out", "new.npz"),
    "demo": ("--refine", "none", "--runs", "1"),
    "bench-pairs": ("pairs.txt", "--methods", "sift", "--limit", "1"),
    "bench-hpatches": ("--root", "dir"),
    "bench-synthetic": ("--photos", "dir", "--pairs", "1"),
    "bench-dtu": ("--root", "dir", "--out", "new", "--methods", "sift"),
    "bench-verdicts": ("--photos", "dir", "--pairs", "1"),
    "bench-speed": ("one.png", "two.png", "x"),
    "dtu-pairs": ("dir", "new.txt", "--scan", "1"),
    "train": ("--photos", "photos", "--out", "new", "--steps", "1", "--validation-pairs", "1"),
    "batch": ("photos", "--out", "new", "--pairs", "sequential:1", *_BATCH),
    "reconstruct": ("photos", "--out", "new", "--pairs", "sequential:1", *_BATCH),
    "export-colmap": ("batch", "--database", "new.db", "--sharing", "cells"),
    "bench-reconstruct": ("photos", "--truth", "pairs.txt", "--out", "new", "--methods", "sift"),
    "fit-probability": ("--data", "dir", "--out", "new", "--methods", "sift"),
}


def make(folder: Path) -> None:
    """The files of the cases, in `folder`."""
    dense_scene.write_pictures(folder)
    dense_scene.write_pair_list(folder, pairs=1)
    (folder / "K.txt").write_text("300 0 159.5\n0 300 119.5\n0 0 1\n")
    (folder / "text.txt").write_text("a letter to somebody\n")
    (folder / "empty").write_text("")
    for name in ("junk", "junk.npy", "junk.pth"):
        (folder / name).write_bytes(np.random.default_rng(0).bytes(2000))
    (folder / "huge.png").write_bytes(png_claiming(60_000, 50_000))
    (folder / "claims.png").write_bytes(png_claiming(4, 4, chunk=2**31 - 10))
    (folder / "dir").mkdir()
    (folder / "photos").mkdir()
    for number in range(24):
        small = np.random.default_rng(number).integers(0, 255, (6, 8, 3), np.uint8)
        cv2.imwrite(f"{folder}/photos/{number}.png", cv2.resize(small, (320, 240)))
    (folder / "batch").mkdir()
    make_batch(folder / "batch")
    (folder / "run").mkdir()
    for name in ("results.csv", "summary.json", "pairs.csv", "checkpoint.pt"):
        (folder / "run" / name).write_text("of another run\n")
    os.mkfifo(folder / "fifo")
    (folder / "loop").symlink_to("loop2")
    (folder / "loop2").symlink_to("loop")
    (folder / "link").symlink_to("one.png")


def png_claiming(width: int, height: int, chunk: int | None = None) -> bytes:
    """A PNG of a few bytes that claims a size, or a chunk of so many bytes."""
    import struct
    import zlib

    def one(kind: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    found = b"\x89PNG\r\n\x1a\n" + one(
        b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    )
    if chunk is not None:
        return found + struct.pack(">I", chunk) + b"tEXtComment\0"
    return found + one(b"IDAT", zlib.compress(b"\0" * 99)) + one(b"IEND", b"")


def cases() -> list[Case]:
    """All of them, in an order that does not change."""
    found: list[Case] = []
    for name in SUBCOMMANDS:
        command = main.get_command(click.Context(main), name)
        assert command is not None
        base = tuple(BASE.get(name, ()))
        for parameter in command.params:
            if name == "serve" and not isinstance(parameter.type, _NUMBERED):
                continue  # it runs until it is stopped, whatever its weights are
            if isinstance(parameter, click.Argument):
                found += [(name, *line) for line in _arguments(parameter, base)]
                continue
            flag = max(parameter.opts, key=len)
            found += [(name, *base, flag, value) for value in _values(parameter)]
    return list(dict.fromkeys(found))


def _arguments(parameter: click.Argument, base: Sequence[str]) -> Iterator[Sequence[str]]:
    """The base with each of its leading words exchanged; arguments come first there."""
    words = [word for word in base if not word.startswith("-")]
    for place in range(len(base)):
        if base[place].startswith("-") or base[place] not in words:
            return
        for value in INPUTS:
            if value:
                yield (*base[:place], value, *base[place + 1 :])


def _values(parameter: click.Parameter) -> Sequence[str]:
    kind = parameter.type
    if getattr(parameter, "is_flag", False):
        return ()
    if isinstance(kind, OutputFile):
        return OUTPUTS
    if isinstance(kind, OutputFolder):
        # What a run has left is in the way of a run alone.
        return [one for one in FOLDERS if one != "run" or "features.h5" not in kind.results]
    if isinstance(kind, _NUMBERED):
        return NUMBERS
    if isinstance(kind, click.Choice):
        return ("", "nosuch", "9" * 5000)
    return INPUTS


class Bench:
    """A folder with the files of the cases, in which commands are run within this process."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        make(folder)
        self.before = self._state()

    def run(self, case: Case) -> str:
        """The fault of a case, or ""."""
        start = time.process_time()
        before = signal.signal(signal.SIGALRM, _alarm)
        signal.alarm(WALL)
        try:
            result = CliRunner().invoke(main, list(case), catch_exceptions=True)
        finally:
            signal.alarm(0)
            signal.signal(signal.SIGALRM, before)
        fault = ""
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            fault = f"raised {result.exception!r}"
        elif result.exit_code != 2 or result.stdout or result.stderr.count("\n") != 1:
            fault = f"exit {result.exit_code}, {result.stdout[:80]!r}, {result.stderr[:300]!r}"
        if time.process_time() - start > SECONDS:
            fault = fault or "took too long"
        if self._state() != self.before:
            fault = fault or "a file was changed or left"
            self.restore()
        return fault

    def restore(self) -> None:
        """The files as they were."""
        for path in self.folder.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink()
        make(self.folder)

    def _state(self) -> dict[str, bytes]:
        return {
            str(path): path.read_bytes() if path.is_file() else b""
            for path in sorted(self.folder.rglob("*"))
        }


def without_network() -> None:
    """Replace the network by a map, in this process for good."""
    import dgc_pose.matchers as matchers

    real = matchers.load_dense_matcher

    def load(weights, *, options, **others):  # type: ignore[no-untyped-def]
        if weights != "dgcm-lite0":
            return real(weights, options=options, **others)
        return dense_scene.MapMatcher(dense_scene.true_map(), options)

    matchers.load_dense_matcher = load  # type: ignore[assignment]


def _alarm(number: int, frame: FrameType | None) -> None:
    raise TimeoutError(f"no answer in {WALL} s")


def main_trial() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--commands", type=int, default=None, help="at most; default: all")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    without_network()
    found = cases()
    order = np.random.default_rng(given.seed).permutation(len(found))[: given.commands]
    faults = 0
    with tempfile.TemporaryDirectory(prefix="dgc-pose-commands-") as folder:
        os.chdir(folder)
        bench = Bench(Path(folder))
        for done, number in enumerate(order):
            if done % 250 == 0:
                print(f"{done} commands, {faults} faults", flush=True)
            fault = bench.run(found[number])
            if fault:
                faults += 1
                shown = " ".join(
                    word if len(word) < 60 else word[:20] + "..." for word in found[number]
                )
                print(f"FAULT {shown!a}: {fault}", flush=True)
        os.chdir("/")
    print(f"{len(order)} of {len(found)} commands, {faults} faults")
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main_trial())
