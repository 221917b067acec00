"""Which images of a folder are paired: all, neighbours in a sequence, or the most similar."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from dgc_pose.errors import InputError

Way = Literal["exhaustive", "sequential", "auto"]
_COUNTED = ("sequential", "auto")
_DIGITS = 10  # of a number of images


@dataclass(frozen=True)
class PairChoice:
    """A way to choose pairs. Raises InputError for a number below 1."""

    way: Way
    # sequential: pairs of images at most so far apart. auto: most similar images of each image.
    number: int = 1

    def __post_init__(self) -> None:
        if self.number < 1:
            raise InputError(f"--pairs {self.way}:N needs N of at least 1, not {self.number}")


def parse_pair_choice(text: str) -> PairChoice:
    """`exhaustive`, `sequential:W` or `auto:K`. Raises InputError for another text."""
    way, colon, number = text.partition(":")
    if way == "exhaustive" and not colon:
        return PairChoice("exhaustive")
    if way in _COUNTED and number.isdecimal() and len(number) < _DIGITS:
        return PairChoice("sequential" if way == "sequential" else "auto", int(number))
    raise InputError(
        f"--pairs must be exhaustive, sequential:W or auto:K, not {text!r}"
        if way in get_args(Way) or way
        else "--pairs is empty"
    )


def exhaustive(count: int) -> list[tuple[int, int]]:
    """All pairs (i, j), i < j, of so many images."""
    return [(i, j) for i in range(count) for j in range(i + 1, count)]


def sequential(count: int, width: int) -> list[tuple[int, int]]:
    """The pairs (i, j), i < j <= i + width."""
    return [(i, j) for i in range(count) for j in range(i + 1, min(i + width, count - 1) + 1)]


def most_similar(scores: np.ndarray, most: int) -> list[tuple[int, int]]:
    """The pairs (i, j), i < j, in which one image is among the `most` most similar ones of the
    other, and those of a spanning tree of largest similarity, so that all images are connected.

    scores: (N, N), symmetric, the larger the more similar; its diagonal does not count.
    """
    count = len(scores)
    others = scores.astype(np.float64).copy()
    np.fill_diagonal(others, -np.inf)
    chosen = np.zeros((count, count), dtype=bool)
    nearest = np.argsort(-others, axis=1, kind="stable")[:, : min(most, count - 1)]
    chosen[np.arange(count)[:, None], nearest] = True
    for edge in _spanning_tree(others):
        chosen[edge] = True
    chosen |= chosen.T
    return [(int(i), int(j)) for i, j in zip(*np.nonzero(np.triu(chosen, 1)), strict=True)]


def _spanning_tree(scores: np.ndarray) -> Iterator[tuple[int, int]]:
    """The edges of the tree of largest scores (N, N) that reaches every node (Prim 1957)."""
    count = len(scores)
    outside, nearest = np.ones(count, dtype=bool), np.zeros(count, dtype=np.int64)
    outside[:1] = False
    best = scores[0].copy() if count else np.zeros(0)
    for _ in range(count - 1):
        node = int(np.where(outside, best, -np.inf).argmax())
        if not outside[node]:  # the scores of all others are -inf
            node = int(outside.argmax())
        yield int(nearest[node]), node
        outside[node] = False
        closer = outside & (scores[node] > best)
        best[closer], nearest[closer] = scores[node][closer], node


def pairs_of(choice: PairChoice, names: Sequence[str]) -> list[tuple[int, int]]:
    """The pairs of a choice that needs no scores. Raises ValueError for "auto"."""
    if choice.way == "exhaustive":
        return exhaustive(len(names))
    if choice.way == "sequential":
        return sequential(len(names), choice.number)
    raise ValueError("auto needs the scores of all pairs")
