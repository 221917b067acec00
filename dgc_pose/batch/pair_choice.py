"""Which images of a folder are paired: all, neighbours in a sequence, or the most similar."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, cast

import numpy as np

from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.system.parallel import in_threads, one_blas_thread

Way = Literal["exhaustive", "sequential", "auto"]
_PAIRS = ArgumentName("pairs")


@dataclass(frozen=True)
class PairChoice:
    """A way to choose pairs."""

    way: Way
    # sequential: pairs of images at most so far apart. auto: most similar images of each image.
    number: int = 1

    def pairs(self, count: int) -> list[tuple[int, int]]:
        """The pairs (i, j), i < j, of so many images; none for "auto", which needs their scores."""
        widest = {"exhaustive": count, "sequential": self.number, "auto": 0}[self.way]
        return [(i, j) for i in range(count) for j in range(i + 1, min(i + widest + 1, count))]


def parse_pair_choice(text: str) -> PairChoice:
    """`exhaustive`, `sequential:W` or `auto:K`. Raises InputError for another text."""
    if text == "exhaustive":
        return PairChoice("exhaustive")
    if match := re.fullmatch("(sequential|auto):([1-9][0-9]{0,8})", text):
        return PairChoice(cast(Way, match[1]), int(match[2]))
    raise InputError(
        _PAIRS, f"must be exhaustive, sequential:W or auto:K, W and K from 1, not {text!r}"
    )


@one_blas_thread()
def similarities(
    features: Sequence[np.ndarray], progress: Callable[[int, int], None] = lambda done, of: None
) -> np.ndarray:
    """Scores (N, N) float32 of all pairs, within -1 and 1; the diagonal is 1.

    features: for each image its coarsest cells (cells, C), of unit length. progress: takes how many
    pairs are compared, of how many.
    """
    cells = [feature.astype(np.float32) for feature in features]
    scores, count = np.eye(len(cells), dtype=np.float32), len(cells)
    for i in range(1, count):
        row = in_threads(partial(similarity, cells[i]), cells[:i])
        scores[i, :i] = scores[:i, i] = row
        progress(i * (i + 1) // 2, count * (count - 1) // 2)
    return scores


def similarity(cells1: np.ndarray, cells2: np.ndarray) -> float:
    """The score of two images: the mean, over the cells of both, (cells, C) of unit length, of the
    largest cosine with a cell of the other image."""
    cosines = cells1 @ cells2.T
    return float((cosines.max(0).sum() + cosines.max(1).sum()) / sum(cosines.shape))


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
        yield int(nearest[node]), node
        outside[node] = False
        closer = outside & (scores[node] > best)
        best[closer], nearest[closer] = scores[node][closer], node
