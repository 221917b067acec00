"""What the progress of a long command writes: lines into a file, a bar on a terminal."""

import io
from types import SimpleNamespace

import pytest

from dgc_pose.cli.progress import progress_bars


class Clock:
    """A clock that the test sets."""

    seconds = 0.0

    def monotonic(self) -> float:
        return self.seconds


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr("dgc_pose.cli.progress.time", SimpleNamespace(monotonic=clock.monotonic))
    return clock


def test_a_log_file_gets_a_line_a_minute(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    """Of 780 pairs 60 are of the run before; six take a second."""
    with progress_bars() as progress:
        for done in range(60, 781, 6):
            progress("pairs", done, 780)
            clock.seconds += 1
        progress("images", 0, 4)  # a stage of less than a minute
        clock.seconds += 59
        progress("images", 4, 4)
    assert capsys.readouterr() == (
        "",
        "pairs 420 of 780, 54 %, 1 min left\npairs 780 of 780, 100 %, 0 min left\n",
    )


def test_the_time_left_is_that_of_the_pairs_so_far(
    clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
    with progress_bars() as progress:
        for seconds, done in ((0, 0), (90, 10), (100, 11), (700, 80), (750, 100)):
            clock.seconds = seconds
            progress("pairs", done, 100)
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(", ")[-1] for line in lines] == ["14 min left", "3 min left", "0 min left"]


def test_a_terminal_gets_a_bar(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    with progress_bars() as progress:
        for done in range(4):
            progress("pairs", done, 3)
            clock.seconds += 100
    assert "\r" in terminal.getvalue() and "3/3" in terminal.getvalue()
    assert "min left" not in terminal.getvalue()
