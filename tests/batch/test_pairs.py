"""Rows of a batch, as JSON."""

import json
from dataclasses import replace

import pytest
from results import ambiguous_pose

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
    assert not again.success and again.rejected == (row is JUDGED)
    for name in ("status", "reason", "bad_images", "folder_probability", "folder_triples"):
        assert getattr(again, name) == getattr(row, name)


@pytest.mark.parametrize(
    "changed", [{"name1": None}, {"status": "fine"}, {"alternatives": [{}]}, {"warnings": 3}]
)
def test_json_of_no_row_is_refused(changed):
    data = json.loads(AMBIGUOUS.to_json()) | changed
    data = {key: value for key, value in data.items() if value is not None}
    with pytest.raises(InputError, match="^rows cannot be read as a row of a batch"):
        parse_row(json.dumps(data), 0, "rows")
