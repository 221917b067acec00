"""A run's folder: what a kill leaves, and what is refused."""

import csv
from dataclasses import asdict

import numpy as np
import pytest
from evaluation_pairs import METHODS, evaluation, posed_pairs

from dgc_pose.benchmarks.scores import DtuScore
from dgc_pose.benchmarks.store import RunStore
from dgc_pose.errors import InputError

SETTINGS = {"protocol": "native", "seed": 0}
COLUMNS = {
    "results.csv": (
        "method scene view1 view2 image1 image2 protocol true_rotation_deg true_baseline_mm "
        "overlap status success num_matches num_inliers inlier_ratio rotation_error_deg "
        "translation_error_deg translation_folded_deg epipolar_all_px epipolar_confident_px "
        "epipolar_all_mean_px epipolar_confident_mean_px"
    ).split(),
    "timings.csv": "method scene view1 view2 match_seconds pose_seconds".split(),
}


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    """The rows of three pairs by three methods."""
    return list(evaluation(posed_pairs(tmp_path_factory.mktemp("images"), 3)).run())


@pytest.fixture
def open_store(tmp_path):
    def make(resume: bool = False, settings=SETTINGS) -> RunStore[DtuScore]:
        return RunStore(tmp_path / "run", DtuScore, len(METHODS), settings, resume=resume)

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
    for name, columns in COLUMNS.items():
        with (folder / name).open(newline="") as stream:
            table = list(csv.DictReader(stream))
        assert [list(line) for line in table] == [columns] * len(flat)
        for line, score in zip(table, flat, strict=True):
            values = asdict(score) | {"pose_seconds": score.estimate_seconds}
            assert line == {name: str(values[name]) for name in columns}


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


def test_a_run_that_another_one_writes_is_left_as_it_is(finished, open_store, tmp_path) -> None:
    """It is neither overwritten nor read."""
    folder, whole = finished
    with open_store(resume=True):
        for options in ({"overwrite": True}, {"resume": True}):
            with pytest.raises(InputError, match="another run is writing there"):
                RunStore(folder, DtuScore, len(METHODS), SETTINGS, **options)
        assert (folder / "results.csv").read_bytes() == whole
    with RunStore(folder, DtuScore, len(METHODS), SETTINGS, overwrite=True) as store:
        assert store.done == 0


def test_what_is_there_is_not_replaced(finished, open_store) -> None:
    folder, whole = finished
    with pytest.raises(InputError, match=": resume goes on"):
        open_store()
    with pytest.raises(InputError, match=r'had protocol "native", not "paper"'):
        open_store(resume=True, settings={**SETTINGS, "protocol": "paper"})
    assert (folder / "results.csv").read_bytes() == whole
    (folder / "results.csv").write_bytes(whole.replace(b"True", b"maybe", 1))
    with pytest.raises(InputError, match=r"results\.csv is not a table"):
        open_store(resume=True)
    (folder / "run.json").unlink()
    with pytest.raises(InputError, match="of no run of this command"):
        open_store(resume=True)
