"""A run on disk: what a kill leaves, and what is refused."""

import math

import pytest

from dgc_pose.benchmarks.store import open_run, read_run
from dgc_pose.errors import InputError

SETTINGS = {"protocol": "native", "sizes": (1, 2)}
PIECES = [{"pair": number, "error": math.inf, "name": "\u00fc\n"} for number in range(3)]


@pytest.fixture
def path(tmp_path):
    """A finished run. `resume` begins where there is nothing."""
    with open_run(tmp_path / "run/run.jsonl", SETTINGS, resume=True) as (_, add):
        for piece in PIECES:
            add(piece)
    return tmp_path / "run/run.jsonl"


def test_any_cut_of_a_run_is_mended(path) -> None:
    whole = path.read_bytes()
    assert read_run(path) == ({"protocol": "native", "sizes": [1, 2]}, PIECES)
    for cut in range(0, len(whole), 7):
        path.write_bytes(whole[:cut])
        with open_run(path, SETTINGS, resume=True) as (done, add):
            assert done == PIECES[: max(0, whole[:cut].count(b"\n") - 1)]
            for piece in PIECES[len(done) :]:
                add(piece)
        assert path.read_bytes() == whole


def test_a_run_that_another_one_writes_is_left_as_it_is(path) -> None:
    """It is neither begun anew nor read."""
    whole = path.read_bytes()
    with open_run(path, SETTINGS, resume=True):
        for resume in (True, False):
            with pytest.raises(InputError, match="another run is writing it"):
                open_run(path, SETTINGS, resume=resume).__enter__()
        assert path.read_bytes() == whole
    with open_run(path, SETTINGS) as (done, _):
        assert done == []


def test_other_settings_and_other_files_are_refused(path) -> None:
    whole = path.read_bytes()
    with pytest.raises(InputError, match=r'has protocol "native", not "paper"'):
        open_run(path, {**SETTINGS, "protocol": "paper"}, resume=True).__enter__()
    assert path.read_bytes() == whole
    for other in (whole.replace(b"{", b"", 1), b"[1]\n", b"\xff\n"):
        path.write_bytes(other)
        with pytest.raises(InputError, match=r"run\.jsonl cannot be read as a run"):
            open_run(path, SETTINGS, resume=True).__enter__()
