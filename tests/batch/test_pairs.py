"""Rows of a batch, as JSON."""

import json
from dataclasses import replace

import numpy as np
import pytest
from results import INLIERS, PROBABILITIES, ambiguous_pose

from dgc_pose.batch.pairs import BAD_INPUT, PairRow, parse_row, row_of
from dgc_pose.errors import InputError

ROW = PairRow("a.jpg", "b.jpg", BAD_INPUT, "corrupt", bad_images={"a.jpg": "corrupt"}, index=7)
AMBIGUOUS = row_of(("a.jpg", "c.jpg"), ambiguous_pose(), 0.5, 7)


JUDGED = replace(AMBIGUOUS, folder_probability=0.25, folder_triples=(1, 3))


@pytest.mark.parametrize("row", [ROW, AMBIGUOUS, JUDGED], ids=["bad", "ambiguous", "judged"])
def test_a_row_comes_back(row):
    """An ambiguous one has all its poses."""
    text = row.to_json()
    again = parse_row(text, row.index, "rows")
    assert again.to_json() == text and (again.index, again.names) == (row.index, row.names)
    assert (again.status, again.reason, again.success) == (row.status, row.reason, False)
    assert dict(again.bad_images) == dict(row.bad_images)
    assert again.folder_probability == row.folder_probability
    assert again.folder_triples == row.folder_triples
    assert again.turned_down == (row is JUDGED)
    if row.pose is not None:
        assert again.pose is not None and again.pose.R is None and again.error_px == 0.5
        others = again.pose.alternatives
        assert tuple(other.num_inliers for other in others) == INLIERS
        assert tuple(other.probability for other in others) == PROBABILITIES
        np.testing.assert_array_equal(others[0].R, ambiguous_pose().alternatives[0].R)


@pytest.mark.parametrize(
    "changed", [{"name1": None}, {"status": "fine"}, {"alternatives": [{}]}, {"warnings": 3}]
)
def test_what_is_no_row_is_refused(changed):
    data = json.loads(AMBIGUOUS.to_json()) | changed
    data = {key: value for key, value in data.items() if value is not None}
    with pytest.raises(InputError, match="^rows is not a row of a batch"):
        parse_row(json.dumps(data), 0, "rows")
