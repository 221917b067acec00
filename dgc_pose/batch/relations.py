"""The poses of a folder's pairs, which of them agree in threes, and what of a pair no other has.

A pair of two places that look alike has a pose as good as any. It shows in the folder: three poses
between three images agree if all are right, or if two are of the same deception, and never if one
alone is wrong; and images of one place have more in common than what many images show.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from dgc_pose.batch.rows import MatchedPair
from dgc_pose.cameras.camera import Camera
from dgc_pose.geometry.epipolar import depths
from dgc_pose.geometry.pixels import Size

CELLS = 80  # along the longer side of an image
_LEAST_SHARED = 8  # cells with depths of two pairs, that their scale is measured by
# Of three poses that agree: between rotations, degrees; and of the gap that their translations
# leave, over the longest. Or so many times their expected errors.
_ROTATION_DEG, _GAP, _ERRORS = 4.0, 0.2, 2.0
_CLEAR = 2.5  # times as much: of three that do not
_FEW = 2  # pairs of an image that have a cell


@dataclass(frozen=True, eq=False)
class Relation:
    """The pose of a pair, and where its inliers are.

    Attributes:
        images: Numbers of images 1 and 2.
        R: Rotation (3, 3) from camera 1 to camera 2.
        t: Direction (3,) of the translation; None with a rotation alone.
        error_deg: Expected errors of R and t, nine times in ten.
        cells: Of each image, the cells (n,) int that have inliers, in order.
        log_depths: Their logarithms of depth (n,), in units of |t|; NaN where there is none.
    """

    images: tuple[int, int]
    R: np.ndarray
    t: np.ndarray | None
    error_deg: tuple[float, float]
    cells: tuple[np.ndarray, np.ndarray]
    log_depths: tuple[np.ndarray, np.ndarray]

    @classmethod
    def of(cls, pair: MatchedPair, images: tuple[int, int], cameras: Sequence[Camera]) -> Relation:
        """The relation of a pair that has a pose or a rotation. cameras: that it is of."""
        pose = pair.row.pose
        assert pose is not None and pose.R is not None
        matches = pair.matches.subset(pose.inliers)
        points, cells = (matches.points1, matches.points2), []
        found = [np.full(len(matches), np.nan)] * 2
        if pose.t is not None:
            rays1, rays2 = (c.normalise(p) for c, p in zip(cameras, points, strict=True))
            found = list(depths(rays1, rays2, pose.R, pose.t))
            front = (found[0] > 0) & (found[1] > 0)
            with np.errstate(divide="ignore", invalid="ignore"):
                found = [np.where(front & np.isfinite(z), np.log(z), np.nan) for z in found]
        errors = pose.rotation_error_90_deg or 0.0, pose.translation_error_90_deg or 0.0
        log_depths = []
        for camera, of_image, values in zip(cameras, points, found, strict=True):
            assert camera.size is not None
            unique, first = np.unique(_cells(of_image, camera.size), return_index=True)
            cells.append(unique)
            log_depths.append(values[first].astype(np.float32))
        facts = (cells[0], cells[1]), (log_depths[0], log_depths[1])
        return cls(images, pose.R, pose.t, errors, *facts)


def _cells(points: np.ndarray, size: Size) -> np.ndarray:
    """Numbers (N,) of the cells of points (N, 2) of an image, row by row, with a cell around it."""
    x, y = np.floor((points + 0.5) * (CELLS / max(size))).astype(np.int64).T.clip(0, CELLS - 1)
    return (y + 1) * (CELLS + 2) + x + 1


def by_image(relations: Sequence[Relation]) -> dict[int, list[tuple[int, int]]]:
    """Of each image its relations, by their number, and which of their images it is."""
    found: dict[int, list[tuple[int, int]]] = defaultdict(list)
    for number, relation in enumerate(relations):
        for side, image in enumerate(relation.images):
            found[image].append((number, side))
    return found


def triples(relations: Sequence[Relation]) -> tuple[np.ndarray, np.ndarray]:
    """Triples (M, 3) int of relations between three images; and (M,) bool, whether their poses
    agree. Those of which it is not clear are left out."""
    number = {tuple(sorted(r.images)): k for k, r in enumerate(relations)}
    near: dict[int, set[int]] = defaultdict(set)
    for first, second in number:
        near[first].add(second)
    images = np.array(
        [
            (first, second, third)
            for first in sorted(near)
            for second, third in combinations(sorted(near[first]), 2)
            if third in near[second]
        ],
        dtype=np.int64,
    ).reshape(-1, 3)
    found = np.array(
        [[number[a, b], number[b, c], number[a, c]] for a, b, c in images.tolist()], dtype=np.int64
    ).reshape(-1, 3)
    R, t, errors = _arrays(relations)
    e12, e23, e13 = found.T
    turned = R[e23] @ R[e12] @ R[e13].transpose(0, 2, 1)
    cosine = (np.trace(turned, axis1=1, axis2=2) - 1) / 2
    angle = np.degrees(np.arccos(cosine.clip(-1, 1)))
    limit = np.maximum(_ROTATION_DEG, _ERRORS * np.linalg.norm(errors[found, 0], axis=1))
    lengths = _lengths(found, images, _log_ratios(relations))
    gap = _gaps(np.einsum("nij,nj->ni", R[e23], t[e12]), t[e23], t[e13], *lengths)
    gap_limit = np.radians(np.linalg.norm(errors[found, 1], axis=1))
    gap_limit = np.maximum(_GAP, _ERRORS * gap_limit)
    apart = np.fmax(angle / limit, gap / gap_limit)
    clear = (np.isfinite(gap) & (apart < 1)) | (apart > _CLEAR)
    return found[clear], apart[clear] < 1


def _arrays(relations: Sequence[Relation]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """R (n, 3, 3) and t (n, 3) from the image of the lower number to the other, NaN where there is
    none, and the expected errors (n, 2)."""
    R, t = [], []
    for relation in relations:
        turn = relation.R
        shift = np.full(3, np.nan) if relation.t is None else relation.t
        if relation.images[0] > relation.images[1]:
            turn, shift = turn.T, -turn.T @ shift
        R.append(turn)
        t.append(shift)
    errors = np.array([relation.error_deg for relation in relations]).reshape(-1, 2)
    return np.array(R).reshape(-1, 3, 3), np.array(t).reshape(-1, 3), errors


def _log_ratios(relations: Sequence[Relation]) -> dict[tuple[int, int, int], float]:
    """By an image and two of its relations, the logarithm of the second one's baseline over that of
    the first, by the depths of the cells that they share."""
    ratios = {}
    for image, those in by_image(relations).items():
        for (first, side1), (second, side2) in combinations(those, 2):
            a, b = relations[first], relations[second]
            _, in_a, in_b = np.intersect1d(
                a.cells[side1], b.cells[side2], assume_unique=True, return_indices=True
            )
            difference = a.log_depths[side1][in_a] - b.log_depths[side2][in_b]
            difference = difference[np.isfinite(difference)]
            if len(difference) >= _LEAST_SHARED:
                ratio = float(np.median(difference))
                ratios[image, first, second], ratios[image, second, first] = ratio, -ratio
    return ratios


def _lengths(
    found: np.ndarray, images: np.ndarray, ratios: dict[tuple[int, int, int], float]
) -> tuple[np.ndarray, np.ndarray]:
    """The baselines 23 and 13 of triples, (M,) each, over 12; NaN where the images do not
    determine them."""
    logs = np.full((len(found), 2), np.nan)
    for row, ((e12, e23, e13), (i1, i2, i3)) in enumerate(
        zip(found.tolist(), images.tolist(), strict=True)
    ):
        by1, by2, by3 = (
            ratios.get(key, np.nan) for key in ((i1, e12, e13), (i2, e12, e23), (i3, e23, e13))
        )
        logs[row, 0] = by1 - by3 if np.isnan(by2) else by2
        logs[row, 1] = by2 + by3 if np.isnan(by1) else by1
    length23, length13 = np.exp(logs).T
    return length23, length13


def _gaps(
    leg12: np.ndarray, leg23: np.ndarray, leg13: np.ndarray, long23: np.ndarray, long13: np.ndarray
) -> np.ndarray:
    """The gap (M,) that directions (M, 3) of three baselines leave, over the longest. long23,
    long13: over baseline 12; of one that is not known, what leaves the least. NaN if none is."""
    along23 = np.einsum("ni,ni->n", leg13 * long13[:, None] - leg12, leg23)
    long23 = np.where(np.isnan(long23), along23.clip(0), long23)
    along13 = np.einsum("ni,ni->n", leg12 + leg23 * long23[:, None], leg13)
    long13 = np.where(np.isnan(long13), along13.clip(0), long13)
    left = leg12 + leg23 * long23[:, None] - leg13 * long13[:, None]
    return np.linalg.norm(left, axis=1) / np.maximum(np.maximum(long23, long13), 1.0)


def own_cells(relations: Sequence[Relation]) -> np.ndarray:
    """Of each relation the logarithm (n,) of the number of cells that at most `_FEW` relations of
    their image have; mean of both images. A relation has a cell if it, or one beside it, has an
    inlier."""
    few = np.zeros((len(relations), 2))
    for those in by_image(relations).values():
        has = np.zeros((len(those), CELLS + 2, CELLS + 2), bool)
        for grid, (number, side) in zip(has, those, strict=True):
            grid.reshape(-1)[relations[number].cells[side]] = True
        for axis in (1, 2):
            has = has | np.roll(has, 1, axis) | np.roll(has, -1, axis)
        by_few = has.sum(0) <= _FEW
        for grid, (number, side) in zip(has, those, strict=True):
            few[number, side] = np.log1p((grid & by_few).sum())
    return few.mean(1)
