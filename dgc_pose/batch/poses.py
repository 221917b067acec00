"""Poses of pairs that are matched, estimated by the cameras of their folder."""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from dgc_pose.batch.pooling import FittedPair
from dgc_pose.batch.rows import PairRow
from dgc_pose.batch.schedule import block_size
from dgc_pose.batch.store import PairStore
from dgc_pose.batch.work import Estimate, Matched
from dgc_pose.batch.workers import RunTasks
from dgc_pose.cameras.camera import Camera

_BLOCKS_HELD = 4  # of matches in memory, for each worker
_FEW_LEFT = 0.5  # of the inliers of a pair by itself


@dataclass(frozen=True)
class Poses:
    """Estimates poses by workers."""

    store: PairStore  # of the pairs as they are matched
    run: RunTasks
    workers: int

    def estimated(
        self, cameras: Mapping[str, Camera], *, fit: bool, only: Collection[int] | None = None
    ) -> Iterator[Matched]:
        """The pairs with their poses by these cameras. fit: whether each pair fits its cameras;
        otherwise those alone do whose cameras are not known. only: indices of some pairs."""
        count = len(self.store if only is None else only)
        blocks = self.store.blocks(block_size(count, self.workers), only)
        while held := list(islice(blocks, _BLOCKS_HELD * self.workers)):
            tasks = []
            for block in held:
                names = {name for row in block.rows for name in (row.name1, row.name2)}
                of_block = {name: cameras[name] for name in names & cameras.keys()}
                tasks.append(Estimate(block, of_block, fit))
            for outcome in self.run(tasks):
                assert isinstance(outcome, Matched)
                yield outcome


def fitted_pairs(blocks: Iterable[Matched]) -> list[FittedPair]:
    """What each pair says of its cameras, in the order of the pairs."""
    pairs = []
    for block in blocks:
        for index, row, matches in zip(block.indices, block.rows, block.matches, strict=True):
            inputs = matches.pose_inputs
            pairs.append(FittedPair(index, row, None if inputs is None else inputs.camera_fits))
    return sorted(pairs, key=lambda pair: pair.index)


def compared(blocks: Iterable[Matched], alone: Sequence[PairRow]) -> Iterator[Matched]:
    """The blocks, in which no pose is of a photograph that more of its pairs show as mirrored than
    have a pose, and of another; and where few inliers are left, a warning. alone: the rows of the
    pairs by themselves."""
    votes, inliers = Counter[str](), {}
    for row in alone:
        vote = (row.status == "mirrored") - row.success
        votes.update({row.name1: vote, row.name2: vote})
        inliers[row.name1, row.name2] = row.num_inliers if row.success else 0
    mirrored = {name for name, vote in votes.items() if vote > 0}
    for block in blocks:
        rows, matches = list(block.rows), list(block.matches)
        for number, row in enumerate(rows):
            names = row.name1, row.name2
            one = mirrored.intersection(names)
            if row.num_inliers < _FEW_LEFT * inliers[names]:
                few = f"the folder's cameras leave {row.num_inliers} of {inliers[names]} inliers"
                rows[number] = replace(row, warnings=(*row.warnings, few))
            if len(one) == 1 and row.t is not None:
                why = f"most pairs of {one.pop()} are of its mirror image"
                rows[number] = PairRow(*names, "mirrored", False, why, num_matches=row.num_matches)
                none = np.zeros_like(matches[number].inliers)
                matches[number] = replace(matches[number], inliers=none)
        yield replace(block, rows=rows, matches=matches)
