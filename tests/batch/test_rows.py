"""Rows of a batch as JSON."""

from dataclasses import asdict

import pytest

from dgc_pose.batch.rows import BAD_INPUT, PairRow, parse_row
from dgc_pose.errors import InputError

ROW = PairRow("a.jpg", "b.jpg", BAD_INPUT, False, "corrupt")


def test_a_row_comes_back() -> None:
    assert parse_row(asdict(ROW), "rows") == ROW


@pytest.mark.parametrize("field", ["name1", "status", "success", "num_matches", "inlier_ratio"])
def test_a_list_in_place_of_one_value_is_refused(field: str) -> None:
    with pytest.raises(InputError, match=f"rows: {field} must be"):
        parse_row(asdict(ROW) | {field: [1.0, 2.0]}, "rows")
