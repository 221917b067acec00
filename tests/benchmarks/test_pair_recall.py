"""The recall of `auto:K` against a finished batch."""

from __future__ import annotations

import numpy as np
import pytest
from batch_runs import run_sift, view_folder
from click.testing import CliRunner

from dgc_pose.batch.run import Batch
from dgc_pose.benchmarks.pair_recall import recall_table, recalls
from dgc_pose.cli.main import main

COUNT = 5


@pytest.fixture(scope="module")
def batch(tmp_path_factory: pytest.TempPathFactory) -> Batch:
    """Views of an arc, each with the next two; all of these pairs verify."""
    folder = tmp_path_factory.mktemp("recall")
    view_folder(folder / "photos", COUNT)
    return run_sift(folder / "photos", folder / "out", pairs="sequential:2")


def test_chosen_pairs_that_verify_are_counted(batch: Batch) -> None:
    """Cells of neighbouring views are alike: auto:1 takes a chain, and all K all pairs."""
    cells = np.eye(8)
    features = [cells[i : i + 4] for i in range(COUNT)]
    one, two, every = recalls(batch, features, [1, 2, 9])
    assert (one.pairs, one.verified) == (10, 7)
    assert (one.chosen, one.found) == (4, 4)
    assert two.found == two.chosen - (two.chosen > 7) and 4 < two.chosen < 10
    assert (every.chosen, every.found) == (10, 7)
    line = recall_table([every]).splitlines()[1]
    assert line.split() == ["auto:9", "10", "100.0", "7", "7", "100.0"]


def test_the_command(batch: Batch) -> None:
    """With the features of the shipped network: K of all others is all pairs."""
    done = CliRunner().invoke(main, ["bench-choice", str(batch.folder), "--k", "1,4"])
    assert done.exit_code == 0, done.output
    some, every = done.stdout.splitlines()[1:]
    assert every.split() == ["auto:4", "10", "100.0", "7", "7", "100.0"]
    assert 4 <= int(some.split()[1]) <= 5
    for wrong in ("0", "x", ""):
        done = CliRunner().invoke(main, ["bench-choice", str(batch.folder), "--k", wrong])
        assert done.exit_code == 2 and "--k" in done.stderr
    sift = CliRunner().invoke(main, ["bench-choice", str(batch.folder), "--weights", "sift"])
    assert sift.exit_code == 2 and "features of a network" in sift.stderr
