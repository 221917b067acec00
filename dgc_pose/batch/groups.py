"""The groups of a folder's images that pairs connect, and the pairs that would join two groups."""

from collections.abc import Iterable, Sequence

from dgc_pose.batch.pairs import PairRow
from dgc_pose.pose import is_hopeless, is_open

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
    """The pairs for the second matcher: they may have a pose, and would join two groups, which the
    other pairs with a pose connect. rows: of all pairs, each on its own; those that the second
    matcher matched already are among the result."""
    groups = connected(rows, (row for row in rows if row.success and not row.second))
    return [row for row in rows if row.name2 not in groups[row.name1] and _may_join(row)]


def _may_join(row: PairRow) -> bool:
    if row.second:
        return True
    return row.pose is not None and is_open(row.pose) and not is_hopeless(row.pose)
