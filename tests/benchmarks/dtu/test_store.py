"""A run's folder: what a kill leaves, and what is refused."""

from __future__ import annotations

import csv
from dataclasses import asdict, fields, replace

import dtu_entries
import numpy as np
import pytest
from dtu_entries import FAST, METHODS

from dgc_pose.benchmarks.dtu.records import DtuResult, DtuTiming
from dgc_pose.benchmarks.dtu.run import run
from dgc_pose.benchmarks.dtu.samples import read_sample
from dgc_pose.benchmarks.dtu.store import RunStore
from dgc_pose.benchmarks.dtu.summary import dtu_table, summarise_methods
from dgc_pose.errors import InputError

SETTINGS = {"protocol": "native", "seed": 0}
PAIRS = 3


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    """The rows of three pairs by three methods."""
    entries = dtu_entries.entries(tmp_path_factory.mktemp("images"), PAIRS)
    return list(run(entries, METHODS, dtu_entries.engines(), FAST))


@pytest.fixture
def open_store(rows, tmp_path):
    keys = [[one.result.key for one in scored] for scored in rows]

    def make(resume: bool = False, settings=SETTINGS) -> RunStore:
        return RunStore(tmp_path / "run", settings, keys, resume=resume)

    return make


@pytest.fixture
def finished(rows, open_store, tmp_path):
    """The folder of the whole run, and its results.csv."""
    with open_store() as store:
        for scored in rows:
            store.add(scored)
    return tmp_path / "run", (tmp_path / "run/results.csv").read_bytes()


def test_the_files_hold_the_rows(rows, finished) -> None:
    folder, _ = finished
    flat = [one for scored in rows for one in scored]
    for name, kind, own in (
        ("results.csv", DtuResult, [one.result for one in flat]),
        ("timings.csv", DtuTiming, [one.timing for one in flat]),
    ):
        with (folder / name).open(newline="") as stream:
            table = list(csv.DictReader(stream))
        columns = [field.name for field in fields(kind)]
        assert [list(line) for line in table] == [columns] * len(own)
        for line, row in zip(table, own, strict=True):
            assert line == {name: str(getattr(row, name)) for name in columns}
    sample = read_sample(folder, flat[0].result.key)
    assert np.allclose(sample.points1, flat[0].sample.points1, atol=0.01)


def test_rows_read_back_are_the_rows_written(rows, finished, open_store) -> None:
    store = open_store(resume=True)
    assert store.done == PAIRS
    np.testing.assert_equal(
        [asdict(row) for row in store.results],
        [asdict(one.result) for scored in rows for one in scored],
    )
    assert store.timings == [one.timing for scored in rows for one in scored]


def test_any_cut_is_mended(rows, finished, open_store) -> None:
    """Cut anywhere, in either table, and gone on with from the pair that the cut leaves undone."""
    folder, whole = finished
    timings = (folder / "timings.csv").read_bytes()
    for cut in range(0, len(whole), 97):
        for cut_timings in (len(timings), len(timings) * cut // len(whole)):
            (folder / "results.csv").write_bytes(whole[:cut])
            (folder / "timings.csv").write_bytes(timings[:cut_timings])
            with open_store(resume=True) as store:
                lines = whole[:cut].count(b"\n") - 1
                timed = timings[:cut_timings].count(b"\n") - 1
                assert store.done == max(0, min(lines, timed)) // len(METHODS)
                for scored in rows[store.done :]:
                    store.add(scored)
            assert (folder / "results.csv").read_bytes() == whole
            assert (folder / "timings.csv").read_bytes() == timings


def test_a_run_that_is_there_is_not_begun_again(finished, open_store) -> None:
    folder, whole = finished
    with pytest.raises(InputError, match="--resume goes on"):
        open_store()
    with pytest.raises(InputError, match=r'had protocol "native", not "paper"'):
        open_store(resume=True, settings={**SETTINGS, "protocol": "paper"})
    assert (folder / "results.csv").read_bytes() == whole


def test_results_of_another_command_are_kept(open_store, tmp_path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run/results.csv").write_text("method,pairs\n")
    for resume in (False, True):
        with pytest.raises(InputError, match="of no run of this command"):
            open_store(resume=resume)
    assert (tmp_path / "run/results.csv").read_text() == "method,pairs\n"


def test_resume_begins_where_there_is_nothing(open_store) -> None:
    assert open_store(resume=True).done == 0


def test_tables_that_were_changed_are_refused(finished, open_store) -> None:
    folder, whole = finished
    lines = whole.splitlines(keepends=True)
    for changed, reason in (
        ([lines[0], *lines[2:]], "results.csv:2: expected the row of"),
        ([lines[0].replace(b"status", b"state"), *lines[1:]], "expected the columns"),
        ([lines[0], lines[1].replace(b"True", b"maybe"), *lines[2:]], "not a row"),
        ([*lines, lines[-1]], "more rows"),
    ):
        (folder / "results.csv").write_bytes(b"".join(changed))
        with pytest.raises(InputError, match=reason):
            open_store(resume=True)
    (folder / "results.csv").write_bytes(whole)
    (folder / "run.json").write_text("{")
    with pytest.raises(InputError, match="not the settings"):
        open_store(resume=True)


def test_the_summary_is_that_of_the_rows(rows) -> None:
    results = [one.result for scored in rows for one in scored]
    timings = [one.timing for scored in rows for one in scored]
    results[0] = replace(
        results[0],
        success=False,
        rotation_error_deg=np.inf,
        translation_error_deg=np.inf,
        translation_folded_deg=np.inf,
    )
    net, everywhere, some = summarise_methods(results, timings)
    assert [s.method for s in (net, everywhere, some)] == [m.name for m in METHODS]
    own = results[::3]
    assert (net.pairs, net.failures) == (3, 1)
    assert net.median_rotation_deg == sorted(r.rotation_error_deg for r in own)[1]
    assert net.median_epipolar_px == sorted(r.epipolar_all_px for r in own)[1]
    assert net.median_epipolar_confident_px == sorted(r.epipolar_confident_px for r in own)[1]
    assert np.isnan(some.median_epipolar_px)
    pose, match = ([getattr(t, f"{x}_seconds") for t in timings[1::3]] for x in ("pose", "match"))
    assert everywhere.pose_seconds_per_pair == pytest.approx(sum(pose) / 3)
    assert everywhere.seconds_per_pair == pytest.approx((sum(pose) + sum(match)) / 3)
    head, *lines = dtu_table([net, everywhere, some]).splitlines()
    assert head.split()[-7:] == ["D_e", "all", "D_e", "conf", "matches", "pose", "s"]
    assert lines[0].split()[-4] == f"{net.median_epipolar_px:.2f}"
    assert lines[2].split()[-4:-1] == ["-", "0.00", "60"]
