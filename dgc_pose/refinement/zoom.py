"""Zoom: tiles of image 2 and the places they map to, cut from the originals and matched again."""

from __future__ import annotations

import numpy as np

from dgc_pose.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.dense import DenseMatcher
from dgc_pose.matching.matcher import CorrespondenceMap
from dgc_pose.network.config import INPUT_SIZE

_LEAST_SHARE = 0.1  # of a tile's cells that the map must be sure of
_MARGIN = 0.15  # of the place's extent, added on each side
_SPREAD = (5, 95)  # percentiles of the places that count as the tile's extent


def match_zoom(
    matcher: DenseMatcher,
    image1: Image,
    image2: Image,
    correspondences: CorrespondenceMap,
    *,
    tiles: int,
) -> Matches:
    """The matches of `tiles` x `tiles` tiles of image 2, each with its place in image 1.

    Tiles are cut where the map is sure of at least a tenth of the cells; the others are left out.
    The confidence is the matchability that the tile was given.
    """
    boxes = _boxes(correspondences, matcher.options.matchability, tiles)
    none = np.zeros((0, 2))
    if not boxes:
        return Matches(none, none, np.zeros(0), error_px=1.0)
    crops = [(_crop(image1, box1), _crop(image2, box2)) for box1, box2 in boxes]
    found = [matcher.select(part) for part in matcher.correspond_batch(crops)]
    placed = list(zip(found, boxes, strict=True))
    return Matches(
        np.concatenate([part.points1 + box1[0] for part, (box1, _) in placed]),
        np.concatenate([part.points2 + box2[0] for part, (_, box2) in placed]),
        np.concatenate([part.confidence for part in found]),
        error_px=float(np.mean([part.error_px for part in found])),
    )


def _boxes(
    correspondences: CorrespondenceMap, matchability: float, tiles: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Boxes ((left, top), (right, bottom)) of whole pixels, in image 1 and in image 2."""
    boxes = []
    size1, size2 = np.array(correspondences.size1), np.array(correspondences.size2)
    edges = np.linspace(0, len(correspondences.matchability), tiles + 1).astype(int)
    for row in range(tiles):
        for column in range(tiles):
            part = (slice(*edges[row : row + 2]), slice(*edges[column : column + 2]))
            sure = correspondences.matchability[part] >= matchability
            if sure.mean() < _LEAST_SHARE:
                continue
            low, high = np.percentile(correspondences.map[part][sure], _SPREAD, axis=0)
            margin = _MARGIN * (high - low)
            box1 = np.stack([np.floor(low - margin), np.ceil(high + margin) + 1])
            box1 = box1.clip(0, size1).astype(int)
            box2 = np.array([(column, row), (column + 1, row + 1)]) * size2 // tiles
            if (box1[1] - box1[0]).min() >= INPUT_SIZE // 15:  # a cell of the coarsest level
                boxes.append((box1, box2))
    return boxes


def _crop(image: Image, box: np.ndarray) -> Image:
    (left, top), (right, bottom) = box
    return Image(np.ascontiguousarray(image.pixels[top:bottom, left:right]), image.name)
