"""Poses of pairs that are matched, estimated by the cameras of their folder."""

from collections import defaultdict
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
from dgc_pose.geometry.epipolar import essential_from_pose, sampson_distance

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
                of_block = {n: cameras[n] for row in block.rows for n in row.names if n in cameras}
                tasks.append(Estimate(block, of_block, fit))
            for outcome in self.run(tasks):
                assert isinstance(outcome, Matched)
                yield outcome


def epipolar_error_px(
    row: PairRow, cameras: Sequence[Camera], points1: np.ndarray, points2: np.ndarray
) -> np.ndarray:
    """Sampson distances (N,) of matches to the pose of a pair, pixels of the originals; infinite
    where distortion cannot be undone, and 0 without a translation. cameras: that the pose is of."""
    if row.R is None or row.t is None:
        return np.zeros(len(points1))
    camera1, camera2 = cameras
    E = essential_from_pose(np.reshape(row.R, (3, 3)), np.array(row.t))
    focal = (camera1.focal + camera2.focal) / 2
    distance = sampson_distance(camera1.normalise(points1), camera2.normalise(points2), E) * focal
    return np.where(np.isfinite(distance), distance, np.inf)


def fitted_pairs(blocks: Iterable[Matched]) -> list[FittedPair]:
    """The pairs with the cameras that each fits, in their order."""
    pairs = []
    for block in blocks:
        for index, row, matches in zip(block.indices, block.rows, block.matches, strict=True):
            is_fit = row.success and row.camera_model == "assumed"
            pairs.append(FittedPair(index, row, matches.fitted if is_fit else None))
    return sorted(pairs, key=lambda pair: pair.index)


def compared(blocks: Iterable[Matched], alone: Sequence[PairRow]) -> Iterator[Matched]:
    """The blocks, in which no pose is of a mirrored photograph and one that is not; and where few
    inliers are left, a warning. alone: the rows of the pairs by themselves."""
    mirrored = _mirrored(alone)
    inliers = {row.names: row.num_inliers if row.success else 0 for row in alone}
    for block in blocks:
        rows, matches = list(block.rows), list(block.matches)
        for i, row in enumerate(rows):
            one = mirrored.intersection(row.names)
            if row.num_inliers < _FEW_LEFT * (before := inliers[row.names]):
                few = f"the folder's cameras leave {row.num_inliers} of {before} inliers"
                rows[i] = replace(row, warnings=(*row.warnings, few))
            if len(one) == 1 and row.t is not None:
                why = f"by most pairs {one.pop()} is a mirror image of the other photographs"
                rows[i] = PairRow(*row.names, "mirrored", False, why, num_matches=row.num_matches)
                matches[i] = replace(matches[i], inliers=np.zeros_like(matches[i].inliers))
        yield replace(block, rows=rows, matches=matches)


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
