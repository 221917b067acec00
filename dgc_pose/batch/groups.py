"""The groups of a folder's images that pairs connect, and the pairs that would join two groups."""

from collections.abc import Iterable, Sequence

from dgc_pose.batch.pairs import PairRow
from dgc_pose.pose import is_open

Groups = dict[str, frozenset[str]]  # by image, all images of its group


def connected(rows: Iterable[PairRow], joined: Iterable[PairRow]) -> Groups:
    """The groups of the images of all rows that chains of joined pairs connect."""
    groups = {name: frozenset([name]) for row in rows for name in row.names}
    for row in joined:
        first, second = (groups[name] for name in row.names)
        if first is not second:
            both = first | second
            groups.update(dict.fromkeys(both, both))
    return groups


def joining(rows: Sequence[PairRow]) -> list[PairRow]:
    """The pairs without a pose that may have one and would join two groups, which pairs with a pose
    connect. rows: of all pairs, each on its own."""
    groups = connected(rows, (row for row in rows if row.success))
    apart = (row for row in rows if row.name2 not in groups[row.name1])
    return [row for row in apart if row.pose is not None and is_open(row.pose)]
