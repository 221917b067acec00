"""Trained decoders put on another encoder, by least squares instead of training from scratch.

A decoder's first convolution reads the encoder's features; all that follows reads that convolution.
So the first convolution is fitted by ridge regression to give, on the new features, the values that
the trained one gives on the former ones; the rest is copied.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import unfold

from dgc_pose.errors import WeightsError
from dgc_pose.network.config import COARSEST, LEVEL_SIZES
from dgc_pose.network.net import DGCNet, normalise, upsample
from dgc_pose.training.synthesis.map_pairs import MapPairs

_CELLS = 2400  # most cells of a batch and level that enter the fit
# The levels fitted, coarse to fine, each with its ridge on the normalised equations; others are
# copied.
_RIDGE = {4: 3e-2, 3: 1e-3, 2: 1e-3}


@dataclass
class _Equations:
    """Normal equations of a level's first convolution, summed over batches."""

    gram: Tensor | float = 0.0  # (n, n) float64
    moments: Tensor | float = 0.0  # (n, channels) float64
    count: int = 0

    def add(self, columns: Tensor, differences: Tensor) -> None:
        """Of inputs (m, n - 1) and the values (m, channels) that are to be added to the outputs."""
        columns = torch.cat([columns, columns.new_ones(len(columns), 1)], 1)  # the bias
        self.gram = self.gram + (columns.T @ columns).double()
        self.moments = self.moments + (columns.T @ differences).double()
        self.count += len(columns)

    def solve(self, convolution: nn.Conv2d, ridge: float) -> None:
        """Add the regression's weights to the convolution's."""
        assert isinstance(self.gram, Tensor) and isinstance(self.moments, Tensor)
        scale = self.gram.diagonal().clamp(min=1e-9 * self.count).sqrt()[:, None]
        normal = self.gram / scale / scale.T
        normal += ridge * torch.eye(len(normal), dtype=normal.dtype)
        weights = (torch.linalg.solve(normal, self.moments / scale) / scale).to(convolution.weight)
        convolution.weight += weights[:-1].T.reshape(convolution.weight.shape)
        assert convolution.bias is not None
        convolution.bias += weights[-1]


@torch.no_grad()
def fit_decoders(net: DGCNet, trained: DGCNet, batches: Iterable[MapPairs], seed: int = 0) -> None:
    """Put the decoders of a trained network on the encoder of `net`, in place.

    batches: pairs of 240x240, some hundred in all. Levels 0 and 1, whose features an encoder with a
    backbone shares, are copied. Raises WeightsError if the decoders differ in more than the inputs
    of their first convolutions.
    """
    for level in range(COARSEST + 1):
        _copy(net, trained, level)
    equations = {level: _Equations() for level in _RIDGE}
    generator = torch.Generator().manual_seed(seed)
    for pairs in batches:
        images = [normalise(image) for image in (pairs.image1, pairs.image2)]
        new, former = ([n.features(image) for image in images] for n in (net, trained))
        # Both networks are given the same states.
        state = net.peak(net.correlate(*new), (LEVEL_SIZES[COARSEST],) * 2)
        for level in _RIDGE:
            before = state if level == COARSEST else upsample(state)
            inputs, values = _first_values(net, level, new, before)
            _, wanted = _first_values(trained, level, former, before)
            dilation = _first(net, level).dilation
            columns = unfold(inputs, 3, dilation, padding=dilation).movedim(1, 2).flatten(0, 1)
            differences = (wanted - values).flatten(2).movedim(1, 2).flatten(0, 1)
            chosen = torch.randperm(len(columns), generator=generator)[:_CELLS]
            equations[level].add(columns[chosen], differences[chosen])
            warped = trained.warp(former[0][level], before)
            state = trained.refine(level, warped, former[1][level], before)
    for level, ridge in _RIDGE.items():
        equations[level].solve(_first(net, level), ridge)


def _first_values(
    net: DGCNet, level: int, features: list[list[Tensor]], before: Tensor
) -> tuple[Tensor, Tensor]:
    """Inputs and outputs of the first convolution of a level, from the state before it."""
    warped = net.warp(features[0][level], before)
    inputs = torch.cat([net.level_features(level, warped, features[1][level]), before], 1)
    return inputs, _first(net, level)(inputs)


def _copy(net: DGCNet, trained: DGCNet, level: int) -> None:
    """Copy a level's decoder. In its first convolution the channels of the encoder's features get
    weight 0, if the level is fitted."""
    name = f"reg_{level}"
    state = trained.get_submodule(name).state_dict()
    first = "conv0.0.weight"
    if level in _RIDGE:
        # The last channels are the state before, and, at levels 3 and 2, the local correlation.
        same = net.config.map_channels
        weight = torch.zeros_like(_first(net, level).weight)
        if level != COARSEST:
            same = weight.shape[1] - 2 * net.config.level_channels[level]
        weight[:, -same:] = state[first][:, -same:]
        state = {**state, first: weight}
    try:
        net.get_submodule(name).load_state_dict(state)
    except RuntimeError as error:
        raise WeightsError(
            f"the decoders of {trained.config.name} do not fit {net.config.name} at level {level}"
        ) from error


def _first(net: DGCNet, level: int) -> nn.Conv2d:
    convolution = net.get_submodule(f"reg_{level}.conv0.0")
    assert isinstance(convolution, nn.Conv2d)
    return convolution
