"""A run's folder: what a kill leaves, and what is refused."""

import csv
from dataclasses import asdict

import numpy as np
import pytest
from evaluation_pairs import METHODS, evaluation, posed_pairs

from dgc_pose.benchmarks.scores import DtuScore
from dgc_pose.benchmarks.store import RunStore, keys_of
from dgc_pose.errors import InputError

SETTINGS = {"protocol": "native", "seed": 0}
PAIRS = 3
COLUMNS = {
    "results.csv": (
        "method scene view1 view2 image1 image2 protocol true_rotation_deg true_baseline_mm "
        "overlap status success num_matches num_inliers inlier_ratio rotation_error_deg "
        "translation_error_deg translation_folded_deg epipolar_all_px epipolar_confident_px "
        "epipolar_all_mean_px epipolar_confident_mean_px"
    ).split(),
    "timings.csv": "method scene view1 view2 match_seconds pose_seconds".split(),
    "matches.csv": "method scene view1 view2 sample".split(),
}


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    """The rows of three pairs by three methods."""
    return list(evaluation(posed_pairs(tmp_path_factory.mktemp("images"), PAIRS)).run())


@pytest.fixture
def open_store(rows, tmp_path):
    keys = [[score.key for score in scores] for scores in rows]

    def make(resume: bool = False, settings=SETTINGS) -> RunStore[DtuScore]:
        out = tmp_path / "run"
        return RunStore(out, DtuScore, keys, settings, resume=resume)

    return make


@pytest.fixture
def finished(rows, open_store, tmp_path):
    """The folder of the whole run, and its results.csv. `resume` begins where there is nothing."""
    with open_store(resume=True) as store:
        for scored in rows:
            store.add(scored)
    return tmp_path / "run", (tmp_path / "run/results.csv").read_bytes()


def test_the_files_hold_the_rows(rows, finished) -> None:
    folder, _ = finished
    flat = [score for scores in rows for score in scores]
    assert list(COLUMNS) == list(DtuScore.tables)
    for name, columns in COLUMNS.items():
        with (folder / name).open(newline="") as stream:
            table = list(csv.DictReader(stream))
        assert [list(line) for line in table] == [columns] * len(flat)
        for line, score in zip(table, flat, strict=True):
            values = asdict(score) | {"pose_seconds": score.estimate_seconds}
            assert line == {name: str(values[name]) for name in columns}


def test_the_keys_are_known_before_the_work(rows, tmp_path) -> None:
    keys = keys_of(posed_pairs(tmp_path, PAIRS), [method.name for method in METHODS])
    assert keys == [[score.key for score in scores] for scores in rows]


def test_records_are_kept_without_a_folder(rows) -> None:
    keys = [[score.key for score in scores] for scores in rows]
    with RunStore(None, DtuScore, keys, SETTINGS) as store:
        store.add(rows[0])
    assert store.done == 1 and store.scores == rows[0]


def test_any_cut_is_mended(rows, finished, open_store) -> None:
    """Cut anywhere, in either table, and resumed from the first pair that the cut leaves undone."""
    folder, whole = finished
    flat = [asdict(score) for scores in rows for score in scores]
    np.testing.assert_equal([asdict(row) for row in open_store(resume=True).scores], flat)
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
    with pytest.raises(InputError, match=": resume goes on"):
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


def test_tables_that_were_changed_are_refused(finished, open_store) -> None:
    folder, whole = finished
    lines = whole.splitlines(keepends=True)
    for changed, reason in (
        ([lines[0], *lines[2:]], "results.csv:2: not the row"),
        ([lines[0].replace(b"status", b"state"), *lines[1:]], "expected the columns"),
        ([lines[0], lines[1].replace(b"True", b"maybe"), *lines[2:]], "results.csv:2: not the row"),
        ([*lines, lines[-1]], "not the row"),
    ):
        (folder / "results.csv").write_bytes(b"".join(changed))
        with pytest.raises(InputError, match=reason):
            open_store(resume=True)
    (folder / "results.csv").write_bytes(whole)
    (folder / "run.json").write_text("{")
    with pytest.raises(InputError, match="not the settings"):
        open_store(resume=True)
