"""Poses of pairs that are matched, estimated by the cameras of their folder."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from dgc_pose.batch.rows import MatchedPair, PairRow
from dgc_pose.batch.store import BatchStore
from dgc_pose.batch.work import Worker
from dgc_pose.batch.workers import Run, block_size, blocks_of
from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import RelativePose
from dgc_pose.geometry.epipolar import sampson_distance

_BLOCKS_HELD = 4  # of matches in memory, for each worker
_FEW_LEFT = 0.5  # of the inliers of a pair by itself


@dataclass(frozen=True)
class Poses:
    """Estimates poses by workers."""

    store: BatchStore  # of the pairs as they are matched
    run: Run
    workers: int

    def estimated(
        self, cameras: Mapping[str, Camera], *, fit: bool, only: Collection[int] | None = None
    ) -> Iterator[MatchedPair]:
        """The pairs with their poses by these cameras, in any order. fit: whether each pair fits
        its cameras; otherwise those alone do whose cameras are not known. only: some pairs."""
        indices = self.store.indices("matched") if only is None else only
        size = block_size(len(indices), self.workers)
        pairs = self.store.pairs("matched", indices)
        while held := list(islice(pairs, size * _BLOCKS_HELD * self.workers)):
            tasks = []
            for block in blocks_of(held, size):
                names = {name for pair in block for name in pair.row.names}
                of_block = {name: cameras[name] for name in names if name in cameras}
                tasks.append((block, of_block, fit))
            for outcome in self.run(Worker.estimate, tasks):
                yield from outcome


def epipolar_error_px(
    row: PairRow, cameras: Sequence[Camera], points1: np.ndarray, points2: np.ndarray
) -> np.ndarray:
    """Sampson distances (N,) of matches to the pose of a pair, pixels of the originals; infinite
    where distortion cannot be undone, and 0 without a translation. cameras: that the pose is of."""
    if row.pose is None or row.pose.E is None:
        return np.zeros(len(points1))
    camera1, camera2 = cameras
    normalised = camera1.normalise(points1), camera2.normalise(points2)
    distance = sampson_distance(*normalised, row.pose.E) * (camera1.focal + camera2.focal) / 2
    return np.where(np.isfinite(distance), distance, np.inf)


def compared(pairs: Iterable[MatchedPair], alone: Sequence[PairRow]) -> Iterator[MatchedPair]:
    """The pairs, in which no pose is of a mirrored photograph and one that is not; and where few
    inliers are left, a warning. alone: the rows of the pairs by themselves."""
    mirrored = _mirrored(alone)
    inliers = {row.names: row.num_inliers if row.success else 0 for row in alone}
    for pair in pairs:
        row, pose = pair.row, pair.row.pose
        one = mirrored.intersection(row.names)
        if pose is not None and pose.t is not None and len(one) == 1:
            why = f"by most pairs {one.pop()} is a mirror image of the other photographs"
            none = np.zeros_like(pose.inliers)
            pose = RelativePose("mirrored", why, none, pose.num_matches)
            row = replace(row, status=pose.status, reason=why, pose=pose)
        elif pose is not None and row.num_inliers < _FEW_LEFT * (before := inliers[row.names]):
            few = f"the folder's cameras leave {row.num_inliers} of {before} inliers"
            row = replace(row, pose=replace(pose, warnings=(*pose.warnings, few)))
        yield replace(pair, row=row)


def _mirrored(rows: Sequence[PairRow]) -> set[str]:
    """The photographs on one of two sides, by which fewest pairs are contradicted: those with a
    pose are of one side, and those that are `mirrored` of both."""
    signs: dict[str, list[tuple[str, int]]] = defaultdict(list)
    for row in rows:
        if row.success or row.status == "mirrored":
            for name, other in (row.names, row.names[::-1]):
                signs[name].append((other, 1 if row.success else -1))
    side = dict.fromkeys(signs, 1)
    while side:
        agreement = {
            name: side[name] * sum(sign * side[other] for other, sign in of_name)
            for name, of_name in signs.items()
        }
        worst = min(agreement, key=lambda name: agreement[name])
        if agreement[worst] >= 0:
            break
        side[worst] = -side[worst]
    return {name for name in side if side[name] < 0}
