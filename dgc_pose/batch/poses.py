"""Poses of pairs that are matched, estimated by other cameras than before."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice

from dgc_pose.batch.pooling import FittedPair
from dgc_pose.batch.schedule import block_size
from dgc_pose.batch.store import PairStore
from dgc_pose.batch.work import Estimate, Matched
from dgc_pose.batch.workers import RunTasks
from dgc_pose.cameras.camera import Camera

_BLOCKS_HELD = 4  # of matches in memory, for each worker


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
