"""The groups of a folder, and the pairs that would join two of them."""

import pytest
from results import pair_row

from dgc_pose.batch.groups import connected, joining
from dgc_pose.batch.pairs import PairRow
from dgc_pose.estimation import Status


def _row(names: str, status: Status = "ok", likely: float = 0.3) -> PairRow:
    return pair_row(names, status, any_probability=likely)


def test_chains_of_pairs_connect_and_other_images_are_alone() -> None:
    rows = [_row("ab"), _row("cd"), _row("ce"), _row("be", "improbable"), _row("fg", "improbable")]
    groups = connected(rows, [row for row in rows if row.success])
    assert {frozenset(group) for group in groups.values()} == set(
        map(frozenset, ("ab", "cde", "f", "g"))
    )
    assert all(name in group for name, group in groups.items())
    assert connected([], []) == {}


@pytest.mark.parametrize(
    ("row", "joins"),
    [
        (_row("bc", "improbable"), True),
        (_row("bc", "ambiguous"), True),
        (_row("de", "improbable"), True),  # of images without any pose
        (_row("ac", "improbable"), False),  # b joins a and c already
        (_row("bd", "improbable", 0.001), False),  # hopeless
        (_row("bd", "mirrored"), False),
        (_row("bd", "rotation_only"), False),
        (PairRow("b", "d", "bad_input", "corrupt"), False),
    ],
)
def test_a_pair_in_doubt_joins_two_groups(row: PairRow, joins: bool) -> None:
    apart = row.names == ("b", "c")
    rows = [_row("ab"), row] if apart else [_row("ab"), _row("bc"), row]
    assert joining(rows) == ([row] if joins else [])
