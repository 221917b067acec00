"""A run's folder: what a kill leaves, and what is refused."""

import csv
from dataclasses import asdict

import numpy as np
import pytest
from evaluation_pairs import METHODS, posed_pairs, scored

from dgc_pose.benchmarks.store import open_run
from dgc_pose.errors import InputError

SETTINGS = {"protocol": "native", "seed": 0}


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    """The rows of three pairs by three methods."""
    return scored(posed_pairs(tmp_path_factory.mktemp("images"), 3))


@pytest.fixture
def open_store(tmp_path):
    def make(settings=SETTINGS, **options):
        return open_run(tmp_path / "run", len(METHODS), settings, **options)

    return make


@pytest.fixture
def finished(rows, open_store, tmp_path):
    """The table of the whole run, and its bytes. `resume` begins where there is nothing."""
    with open_store(resume=True) as (_, add):
        for of_pair in rows:
            add(of_pair)
    table = tmp_path / "run/results.csv"
    return table, table.read_bytes()


def test_the_table_holds_the_rows_and_any_cut_of_it_is_mended(rows, finished, open_store) -> None:
    table, whole = finished
    flat = [asdict(score) for of_pair in rows for score in of_pair]
    with table.open(newline="") as stream:
        lines = list(csv.DictReader(stream))
    assert lines == [{name: str(value) for name, value in row.items()} for row in flat]
    with open_store(resume=True) as (records, _):
        np.testing.assert_equal([asdict(row) for row in records], flat)
    for cut in range(0, len(whole), 197):
        table.write_bytes(whole[:cut])
        with open_store(resume=True) as (records, add):
            done = max(0, whole[:cut].count(b"\n") - 1) // len(METHODS)
            assert len(records) == done * len(METHODS)
            for of_pair in rows[done:]:
                add(of_pair)
        assert table.read_bytes() == whole


def test_a_run_that_another_one_writes_is_left_as_it_is(finished, open_store) -> None:
    """It is neither overwritten nor read."""
    table, whole = finished
    with open_store(resume=True):
        for options in ({"overwrite": True}, {"resume": True}):
            with pytest.raises(InputError, match="another run is writing there"):
                open_store(**options).__enter__()
        assert table.read_bytes() == whole
    with open_store(overwrite=True) as (records, _):
        assert records == []


def test_what_is_there_is_not_replaced(finished, open_store) -> None:
    table, whole = finished
    with pytest.raises(InputError, match=": resume goes on"):
        open_store().__enter__()
    with pytest.raises(InputError, match=r'had protocol "native", not "paper"'):
        open_store({**SETTINGS, "protocol": "paper"}, resume=True).__enter__()
    assert table.read_bytes() == whole
    table.write_bytes(whole.replace(b"True", b"maybe", 1))
    with pytest.raises(InputError, match=r"results\.csv is not a table"):
        open_store(resume=True).__enter__()
    table.with_name("run.json").unlink()
    with pytest.raises(InputError, match="of no run of this command"):
        open_store(resume=True).__enter__()
