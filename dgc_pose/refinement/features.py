"""Matches of the frozen encoder's own features at native resolution, guided by the dense map.

The encoder is fully convolutional, so the image keeps its shape and most of its resolution. At
stride 16 each cell of image 2 gets a few candidate cells of image 1: the most similar ones, and
those that the map points to. At stride 8 their children are compared, and mutual nearest neighbours
are kept. At stride 4 the point is located to a fraction of a cell. Only the comparison at stride 16
is quadratic in the number of pixels.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from dgc_pose.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.matcher import CorrespondenceMap
from dgc_pose.network.net import DGCNet
from dgc_pose.pixels import rescale
from dgc_pose.refinement.consistency import consistent
from dgc_pose.refinement.guide import (
    points_in_image1,
    rotate_points,
    rotation_between,
    scale_between,
)
from dgc_pose.refinement.native import (
    Features,
    NativeCache,
    cells_at,
    native_cache,
    native_features,
)
from dgc_pose.refinement.options import FeatureOptions

ERROR_CELLS = 0.25  # of a match along one axis, in cells of stride 4
_FEW = 0.3  # share of consistent matches below which other scales are tried
_OTHER_SCALES = (1 / 3, 3.0)
_SHARPNESS = 20.0  # inverse temperature of the soft-argmax over cosines
_RADIUS = 3  # cells of stride 4 searched around the cell found at stride 8
_WINDOWS = 128  # compared at a time, which stays in the processor's cache
_CHUNK = 1024  # coarse cells compared at a time, which bounds the memory


class FeatureMatches:
    """Matches of the features of a frozen network, guided by the map (a `MatchSource`).

    cache: of the features; None to compute them anew for each pair.
    """

    def __init__(
        self,
        net: DGCNet,
        options: FeatureOptions | None = None,
        cache: NativeCache | None = None,
    ) -> None:
        self.net = net
        self.options = options or FeatureOptions()
        self.cache = cache

    def find(
        self, image1: Image, image2: Image, correspondence_map: CorrespondenceMap, matches: Matches
    ) -> Matches:
        """Matches at the scale that the map shows, to the octave: features tolerate half of one.

        If the map is weak, other scales are tried, and that with the most consistent matches kept.
        """
        options, cache = self.options, self.cache or native_cache()
        given = (self.net, image1, image2, correspondence_map, options, cache)
        shown = 2.0 ** round(math.log2(scale_between(correspondence_map)))
        found = match_features(*given, scale=shown)
        if correspondence_map.matchability.mean() >= options.other_scales_below:
            return found
        most = len(consistent(found, options.neighbours).index)
        # Equal scale is always tried: that of a weak map is no more likely.
        for scale in (1.0, *_OTHER_SCALES):
            if scale == shown or (scale != 1.0 and most >= _FEW * len(found)):
                continue
            other = match_features(*given, scale=scale)
            count = len(consistent(other, options.neighbours).index)
            if count > most:
                found, most = other, count
        return found


@torch.no_grad()
def match_features(
    net: DGCNet,
    image1: Image,
    image2: Image,
    correspondence_map: CorrespondenceMap,
    options: FeatureOptions,
    cache: NativeCache,
    *,
    scale: float,
) -> Matches:
    """Mutual nearest neighbours of the features; the confidence is their cosine, at least 0.

    scale: pixels of image 1 per pixel of image 2. Features are invariant neither to scale nor to
    rotation: the images are resized to one scale, with long sides of about `long_side` pixels, and
    image 2 is rotated by the quarter turns that the map shows.
    """
    quarter_turns = rotation_between(correspondence_map)
    rotated = np.ascontiguousarray(np.rot90(image2.pixels, quarter_turns))
    factor1, factor2 = equal_scales(image1.size, image2.size, scale, options.long_side)
    cells1 = cells_at(image1.size, factor1)
    cells2 = cells_at((rotated.shape[1], rotated.shape[0]), factor2)
    source = cache.get((image1, 0, cells1), lambda: native_features(net, image1.pixels, cells1))
    target = cache.get(
        (image2, quarter_turns, cells2), lambda: native_features(net, rotated, cells2)
    )
    guided = _guided_cells(correspondence_map, source, target, quarter_turns)
    similar = _similar_cells(source, target, options.candidates)
    found1, found2, cosine = mutual_neighbours(source, target, torch.cat([similar, guided], 1))
    fine1, fine2 = subcell_points(source.fine, target.fine, found1, found2)
    points2 = to_pixels(fine2, target.fine, target.size).cpu().numpy().astype(np.float64)
    cell = math.sqrt(_cell_area(source) * _cell_area(target)) ** 0.5
    return Matches(
        to_pixels(fine1, source.fine, source.size).cpu().numpy(),
        rotate_points(points2, target.size, -quarter_turns),
        cosine.clamp(0, 1).cpu().numpy(),
        error_px=ERROR_CELLS * cell,
    )


def equal_scales(
    size1: tuple[int, int], size2: tuple[int, int], scale: float, long_side: int
) -> tuple[float, float]:
    """Factors, at most 1, that bring both images to one scale; sizes (width, height).

    scale: pixels of image 1 per pixel of image 2. At scale 1 each long side is at most `long_side`
    afterwards; otherwise the image of the larger scale becomes smaller than that.
    """
    factor1, factor2 = (min(1.0, long_side / max(size)) for size in (size1, size2))
    ratio = scale * factor1 / factor2
    return factor1 / max(ratio, 1.0), factor2 * min(ratio, 1.0)


def mutual_neighbours(
    source: Features, target: Features, candidates: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Mutual nearest neighbours at stride 8 among the children of candidate cells.

    candidates: (n, K) indices, row by row, of stride-16 cells of the source for each of the
    target's n. Returns cells (M, 2) of stride 8, x and y, in source and target, and their cosine.
    """
    middle1, middle2 = source.middle.flatten(1).T.contiguous(), target.middle.flatten(1).T
    children1, children2 = _children(source.coarse), _children(target.coarse)
    limit = middle1.new_full((len(middle1),), -torch.inf)  # best cosine of each source cell
    best, cell = [], []
    for rows, own in zip(candidates.split(_CHUNK), children2.split(_CHUNK), strict=True):
        index = children1[rows].flatten(1)  # (m, 4 K)
        scores = torch.bmm(middle2[own], middle1[index].transpose(1, 2))  # (m, 4, 4 K)
        limit.scatter_reduce_(0, index.flatten(), scores.amax(1).flatten(), "amax")
        score, which = scores.max(2)
        best.append(score.flatten())
        cell.append(index.gather(1, which).flatten())
    cosine, cell1, cell2 = torch.cat(best), torch.cat(cell), children2.flatten()
    mutual = cosine >= limit[cell1]
    cell1, cell2 = cell1[mutual], cell2[mutual]
    return _xy(cell1, source.middle), _xy(cell2, target.middle), cosine[mutual]


def subcell_points(
    fine1: Tensor, fine2: Tensor, cells1: Tensor, cells2: Tensor
) -> tuple[Tensor, Tensor]:
    """Points (M, 2) in cells of stride 4 of matched cells (M, 2) of stride 8.

    The target's point is the cell's centre; the source's is the mean of the cells within one of the
    most similar in a window, weighted by the softmax of their cosines.
    """
    halves1, halves2 = _between_cells(fine1), _between_cells(fine2)
    axis = torch.arange(-_RADIUS, _RADIUS + 1, device=fine1.device)
    window = torch.stack(torch.meshgrid(axis, axis, indexing="xy"), -1).view(-1, 2)
    corner1, corner2 = 2 * cells1.long(), 2 * cells2.long()
    around = corner1[:, None] + window
    limit = around.new_tensor((halves1.shape[1] - 1, halves1.shape[0] - 1))
    inside = (around >= 0).all(-1) & (around <= limit).all(-1)
    around = around.clamp_min(0).minimum(limit)
    wanted = halves2[corner2[:, 1], corner2[:, 0], :, None]  # (M, C, 1)
    cells = around[..., 1] * halves1.shape[1] + around[..., 0]
    rows = halves1.flatten(0, 1)
    cosines = torch.cat(
        [
            torch.bmm(rows[part], own)[..., 0]
            for part, own in zip(cells.split(_WINDOWS), wanted.split(_WINDOWS), strict=True)
        ]
    )
    cosines = cosines.masked_fill(~inside, -torch.inf)
    best = window[cosines.argmax(1)]
    far = (window - best[:, None]).abs().amax(-1) > 1
    weights = (_SHARPNESS * cosines).masked_fill(far, -torch.inf).softmax(1)
    return 2 * cells1 + 0.5 + weights @ window.to(fine1.dtype), 2 * cells2 + 0.5


def to_pixels(cells: Tensor, level: Tensor, size: tuple[int, int]) -> Tensor:
    """Points (M, 2) in cells of a level (C, h, w) to pixels of the image of `size`."""
    height, width = level.shape[1:]
    scale = cells.new_tensor((size[0] / width, size[1] / height))
    return (cells + 0.5) * scale - 0.5


def _similar_cells(source: Features, target: Features, count: int) -> Tensor:
    """The most similar cells of stride 16 of the source for each of the target's: (n, count)."""
    own, other = source.coarse.flatten(1), target.coarse.flatten(1).T
    count = min(count, own.shape[1])
    return torch.cat([(part @ own).topk(count, 1).indices for part in other.split(_CHUNK)])


def _guided_cells(
    correspondence_map: CorrespondenceMap, source: Features, target: Features, quarter_turns: int
) -> Tensor:
    """The 2x2 cells of stride 16 around the map's point for each cell of the target: (n, 4)."""
    height, width = target.coarse.shape[1:]
    index = torch.arange(height * width, device=target.coarse.device)
    centres = to_pixels(_xy(index, target.coarse), target.coarse, target.size)
    points2 = rotate_points(centres.cpu().numpy().astype(np.float64), target.size, -quarter_turns)
    rows, columns = source.coarse.shape[1:]
    points1 = points_in_image1(correspondence_map, points2)
    cells = rescale(points1, source.size, (columns, rows))
    corner = np.floor(cells).astype(np.int64)[:, None] + ((0, 0), (1, 0), (0, 1), (1, 1))
    corner = corner.clip(0, (columns - 1, rows - 1))
    found = torch.from_numpy(corner[..., 1] * columns + corner[..., 0])
    return found.to(target.coarse.device)


def _children(coarse: Tensor) -> Tensor:
    """Indices (n, 4), row by row, of the cells of twice the resolution in each cell of a level."""
    height, width = coarse.shape[1:]
    finer = torch.arange(4 * height * width, device=coarse.device).view(height, 2, width, 2)
    return finer.permute(0, 2, 1, 3).reshape(-1, 4)


def _xy(index: Tensor, level: Tensor) -> Tensor:
    """Indices (M,), row by row, of a level's cells as x and y (M, 2)."""
    width = level.shape[2]
    rows = torch.div(index, width, rounding_mode="floor")
    return torch.stack([index - rows * width, rows], -1).to(level.dtype)


def _between_cells(features: Tensor) -> Tensor:
    """Features (C, h, w) half a cell right of and below each cell: (h - 1, w - 1, C)."""
    cells = features.permute(1, 2, 0)  # channels last already, as `native_features` makes them
    pairs = cells[:, 1:] + cells[:, :-1]
    return (pairs[1:] + pairs[:-1]).mul_(0.25)


def _cell_area(features: Features) -> float:
    """Of a stride-4 cell, in pixels of the original."""
    return math.prod(features.size) / math.prod(features.fine.shape[1:])
