"""A share of the trial that fits the suite, and the trial's own eyes."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from fuzz import trial
from fuzz.doors import DOORS, Door
from fuzz.mutators import BYTES, JSON, PNG, TEXT, ZIP, mutated

INPUTS = 25  # of each door


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> trial.Reader:
    return trial.Reader(tmp_path_factory.mktemp("doors"), DOORS)


@pytest.mark.parametrize("door", [door.name for door in DOORS])
def test_damaged_files_are_read_or_refused_in_one_line(
    reader: trial.Reader, door: str, capfd: pytest.CaptureFixture[str]
) -> None:
    results = [reader.read(door, 11, number) for number in range(INPUTS)]
    assert [fault for fault, _ in results if fault] == []
    assert any(refused for _, refused in results)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("door", DOORS, ids=lambda door: door.name)
def test_the_good_files_are_accepted(door: Door, tmp_path: Path) -> None:
    """But for weights, which are those of a part of a network."""
    door.make(tmp_path)
    files = door.files(tmp_path)
    assert files
    for path in files:
        if path.suffix != ".pth":
            door.read(tmp_path, path)


@pytest.mark.parametrize("mutators", [BYTES, TEXT, JSON, PNG, ZIP])
def test_damage_is_drawn_by_the_seed(mutators: list) -> None:
    data = b"one, two\n3 4 5\n" * 9
    made = [[mutated(data, mutators, np.random.default_rng(k)) for k in range(40)] for _ in "ab"]
    assert made[0] == made[1]
    assert len(set(made[0])) > 20


BAD = """
import os, sys
from pathlib import Path
import fuzz.trial
from fuzz.doors import Door
from fuzz.mutators import BYTES
from dgc_pose.errors import InputError

def wrong(name, folder):
    if name == "raises": raise KeyError("x")
    if name == "lines": raise InputError("two\\nlines")
    if name == "prints": os.write(2, b"libpng error")
    if name == "leaves": (folder / ".left").write_text("")
    if name == "changes": (folder / "a.txt").write_text("")
    if name == "keeps": bytearray(2 * 2**30)[::4096]
    if name == "dies": os.abort()

def door(name):
    make = lambda folder: (folder / "a.txt").write_text("good" * 99)
    return Door(name, make, lambda folder, path: wrong(name, folder), {".txt": BYTES})

DOORS = [door(name) for name in sys.argv[1].split(",")]
fuzz.trial.child(Path(sys.argv[2]), DOORS, 0)
"""


def test_the_trial_sees_every_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same trial over doors that do wrong, each in its own way; the last one kills."""
    names = ["fine", "raises", "lines", "prints", "leaves", "changes", "keeps", "dies"]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    script = tmp_path / "child.py"
    script.write_text(BAD)
    command = [str(script), ",".join(names)]
    result = trial.run({name: 2 for name in names}, command, inputs=2 * len(names), tell=False)
    assert {fault["door"] for fault in result.faults} == {*names} - {"fine"}
    assert result.inputs["fine"] >= 2
    assert "FAULT prints 0: printed: b'libpng error'" in trial.summary(result)
