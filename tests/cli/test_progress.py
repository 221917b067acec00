"""What the progress of a long command writes into a file: lines."""

from types import SimpleNamespace

import pytest

from dgc_pose.cli.progress import progress_bars


def test_a_log_file_gets_a_line_a_minute(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of 780 pairs 60 are of the run before; six take a second."""
    clock = SimpleNamespace(seconds=0.0, monotonic=lambda: clock.seconds)
    monkeypatch.setattr("dgc_pose.cli.progress.time", clock)
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
