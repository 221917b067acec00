"""Rows of a batch as JSON."""

from __future__ import annotations

import pytest

from dgc_pose.batch.rows import BAD_INPUT, parse_row, row_data, unmatched_row
from dgc_pose.errors import InputError


def test_a_row_comes_back() -> None:
    row = unmatched_row(("a.jpg", "b.jpg"), BAD_INPUT, "corrupt")
    assert parse_row(row_data(row), "rows") == row


@pytest.mark.parametrize("field", ["name1", "status", "success", "num_matches", "inlier_ratio"])
def test_a_list_in_place_of_one_value_is_refused(field: str) -> None:
    data = row_data(unmatched_row(("a.jpg", "b.jpg"), BAD_INPUT, "corrupt"))
    with pytest.raises(InputError, match=f"rows: {field} is not that of a row"):
        parse_row(data | {field: [1.0, 2.0]}, "rows")
