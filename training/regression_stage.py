"""The stage of a `GeometricNet`: its regressions on the frozen encoder."""

from __future__ import annotations

import torch
from torch import Tensor

from dgc_pose.network.config import COARSEST, INPUT_SIZE, LEVEL_SIZES
from dgc_pose.network.coordinates import to_pixels
from dgc_pose.network.geometric_net import GeometricNet
from dgc_pose.network.net import normalise
from dgc_pose.training.losses import masked_mean
from dgc_pose.training.stages import FrozenEncoderStage, Loss
from dgc_pose.training.symmetry import SYMMETRIES, Symmetry, brought_back, moved
from dgc_pose.training.synthesis.draw import Draw
from dgc_pose.training.synthesis.map_pairs import MapPairs, level_truth

_GRID = LEVEL_SIZES[COARSEST - 1]  # points a side that the loss is of
_STEPS = (0, 2, 4)  # from one symmetry of a step to its others


class RegressionStage(FrozenEncoderStage):
    """Both regressions at once, the spline fed with the source warped by the detached affine.

    Encoding takes most of the time. Therefore each pair of features is also taken by three random
    symmetries of the square: for a regression, which knows nothing of them, these are other pairs.

    end_to_end: the affine transformation is not detached (the polish stage).
    """

    net: GeometricNet

    def forward(self, pairs: MapPairs, draw: Draw) -> Loss:
        """The mean distance over a grid of points, in cells, of the affine transformation and of
        both; and in pixels."""
        net = self.net
        images = normalise(torch.cat([pairs.image1, pairs.image2]))
        images = images.contiguous(memory_format=torch.channels_last)
        with torch.no_grad():
            source, target = net.coarsest(images).chunk(2)
        views = _random_views(draw)
        targets = moved(views, target)
        affines = net.estimate_affine(moved(views, source), targets)
        affines = brought_back(views, Symmetry.affine, affines)
        affine = affines[: len(source)]  # of the pairs as they are
        if not self.end_to_end:
            affine = affine.detach()
        warped = net.warped_features(images[: len(source)], affine)
        splines = net.estimate_spline(moved(views, warped), targets)
        splines = brought_back(views, Symmetry.spline, splines)
        both = net.dense_map(affine.repeat(len(views), 1, 1), splines, _GRID)
        truth = level_truth(pairs.map, pairs.valid, _GRID)
        distances = {
            "epe_affine": self._distance(net.dense_map(affines, None, _GRID), *truth),
            "epe": self._distance(both, *truth),
        }
        total = sum(distances.values(), start=images.new_zeros(())) / 2**COARSEST
        return total, {name: distance.detach() for name, distance in distances.items()}

    def _distance(self, maps: Tensor, truth: Tensor, valid: Tensor) -> Tensor:
        """The mean distance of maps (V * B, 2, n, n) from the truth (B, n, n, 2), pixels of 240."""
        size = (INPUT_SIZE, INPUT_SIZE)
        points = to_pixels(maps.movedim(1, -1), size, self.net.config.align_corners)
        points = points.view(-1, *truth.shape)
        # 0 elsewhere, so that undefined values of the truth reach no gradient.
        error = torch.where(valid[..., None], points - truth, 0)
        return masked_mean((error.square().sum(-1) + 1e-6).sqrt(), valid.expand(points.shape[:-1]))


def _random_views(draw: Draw) -> list[Symmetry]:
    """The symmetry that moves nothing and three others."""
    first, *others = SYMMETRIES
    (offset,) = draw.numbers(1, len(others))
    return [first, *(others[(offset + step) % len(others)] for step in _STEPS)]
