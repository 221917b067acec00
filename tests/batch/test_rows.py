"""Rows of a batch, as JSON."""

import json
from dataclasses import asdict

import numpy as np
import pytest
from results import INLIERS, PROBABILITIES, ambiguous_pose

from dgc_pose.batch.rows import (
    BAD_INPUT,
    PairRow,
    parse_row,
    row_of,
)
from dgc_pose.errors import InputError

ROW = PairRow("a.jpg", "b.jpg", BAD_INPUT, False, "corrupt")
AMBIGUOUS = row_of(("a.jpg", "c.jpg"), ambiguous_pose(), 0.5)


def test_an_ambiguous_row_has_all_its_poses() -> None:
    assert not AMBIGUOUS.success and AMBIGUOUS.R is None and AMBIGUOUS.t is None
    assert AMBIGUOUS.probability == 0
    for row, pose in zip(AMBIGUOUS.alternatives, ambiguous_pose().alternatives, strict=True):
        np.testing.assert_array_equal(np.reshape(row.R, (3, 3)), pose.R)
        np.testing.assert_array_equal(row.t, pose.t)
    assert tuple(row.num_inliers for row in AMBIGUOUS.alternatives) == INLIERS
    assert tuple(row.probability for row in AMBIGUOUS.alternatives) == PROBABILITIES


@pytest.mark.parametrize("row", [ROW, AMBIGUOUS], ids=["bad", "ambiguous"])
def test_a_row_comes_back(row: PairRow) -> None:
    assert parse_row(json.loads(json.dumps(asdict(row))), "rows") == row


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"t": [0.0, 1.0]}, "R has 9 numbers and t has 3"),
        ({"R": None}, "R must be a tuple"),
        ({"num_inliers": 2.5}, "num_inliers must be an integer"),
        ({"probability": "high"}, "probability must be a number"),
    ],
)
def test_an_alternative_that_is_no_pose_is_refused(changed: dict[str, object], words: str) -> None:
    data = asdict(AMBIGUOUS)
    data["alternatives"] = [data["alternatives"][0] | changed]
    with pytest.raises(InputError, match=f"rows: .*{words}"):
        parse_row(data, "rows")


@pytest.mark.parametrize("field", ["name1", "status", "success", "num_matches", "inlier_ratio"])
def test_a_list_in_place_of_one_value_is_refused(field: str) -> None:
    with pytest.raises(InputError, match=f"rows: {field} must be"):
        parse_row(asdict(ROW) | {field: [1.0, 2.0]}, "rows")
