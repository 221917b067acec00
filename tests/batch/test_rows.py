"""Rows of a batch as JSON."""

from __future__ import annotations

import pytest

from dgc_pose.batch.rows import bad_row, parse_row, row_data
from dgc_pose.errors import InputError


def test_a_row_comes_back() -> None:
    row = bad_row(("a.jpg", "b.jpg"), "corrupt")
    assert parse_row(row_data(row), "rows") == row


@pytest.mark.parametrize("field", ["name1", "status", "success", "num_matches", "inlier_ratio"])
def test_a_list_in_place_of_one_value_is_refused(field: str) -> None:
    data = row_data(bad_row(("a.jpg", "b.jpg"), "corrupt"))
    with pytest.raises(InputError, match=f"rows: {field} is not that of a row"):
        parse_row(data | {field: [1.0, 2.0]}, "rows")
