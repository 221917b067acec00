"""bench-speed: every effort and SIFT, each with its steps; one-line errors."""

from pathlib import Path

import dense_scene
import pytest
from command_line import assert_refused, run


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    dense_scene.write_pictures(tmp_path)


def test_the_steps_of_every_effort_add_up() -> None:
    result = run("bench-speed", "one.png", "two.png", "--K", dense_scene.K_TEXT, "--repetitions", 1)
    assert result.exit_code == 0, result.output
    heading, *lines = (line.split(maxsplit=2) for line in result.stdout.splitlines())
    assert heading == ["effort", "step", "ms"]
    efforts = dict.fromkeys(line[0] for line in lines)
    assert list(efforts) == ["fast", "auto", "thorough", "sift"]
    for effort in efforts:
        own = [line[1:] for line in lines if line[0] == effort]
        steps = {name: float(ms) for name, ms in own[:-1]}
        assert {"load", "estimate"} < set(steps)
        name, total = " ".join(own[-1]).rsplit(maxsplit=1)
        assert name == "in all" and float(total) == pytest.approx(sum(steps.values()), abs=0.5)


def test_what_cannot_be_used_is_refused() -> None:
    assert_refused(run("bench-speed", "one.png", "nowhere.png"), "nowhere.png")
    assert_refused(run("bench-speed", "one.png", "two.png", "--K", "x"), "--K")
    assert_refused(run("bench-speed", "one.png", "two.png", "--weights", "none"), "none")
