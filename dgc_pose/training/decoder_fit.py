"""Trained decoders put on another encoder, by least squares instead of training from scratch.

A decoder's first convolution reads the encoder's features; all that follows reads that convolution.
So the first convolution is fitted by ridge regression to give, on the new features, the values that
the trained one gives on its own; the rest is copied.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import unfold
from torch.utils.hooks import RemovableHandle

from dgc_pose.errors import WeightsError
from dgc_pose.network.config import COARSEST
from dgc_pose.network.net import DGCNet, upsample
from dgc_pose.network.statistics import normalise
from dgc_pose.synthesis.map_pairs import MapPairs

_CELLS = 2400  # most cells of a batch and level that enter the fit
# The levels fitted, coarse to fine, each with its ridge on the normalised equations; others are
# copied.
_RIDGE = {4: 3e-2, 3: 1e-3, 2: 1e-3}


@dataclass
class _Equations:
    """Normal equations of a level's first convolution, summed over batches."""

    gram: Tensor  # (n, n) float64
    moments: Tensor  # (n, channels) float64
    count: int = 0


@torch.no_grad()
def fit_decoders(net: DGCNet, trained: DGCNet, batches: Iterable[MapPairs], seed: int = 0) -> None:
    """Put the decoders of a trained network on the encoder of `net`, in place.

    batches: pairs of 240x240, some hundred in all. Levels 0 and 1, whose features an encoder with a
    backbone shares, are copied. Both networks must pass on the same states. Raises WeightsError if
    the decoders differ in more than the inputs of their first convolutions.
    """
    for level in range(COARSEST + 1):
        _copy(net, trained, level)
    equations: dict[int, _Equations] = {}
    generator = torch.Generator().manual_seed(seed)
    for pairs in batches:
        images = [normalise(image) for image in (pairs.image1, pairs.image2)]
        new = [net.features(image) for image in images]
        old = [trained.features(image) for image in images]
        state: Tensor | None = None
        for level in _RIDGE:
            inputs, values, wanted, state = _both(net, trained, level, new, old, state)
            dilation = _first(net, level).dilation
            columns = unfold(inputs, 3, dilation, padding=dilation).movedim(1, 2).flatten(0, 1)
            difference = (wanted - values).flatten(2).movedim(1, 2).flatten(0, 1)
            chosen = torch.randperm(len(columns), generator=generator)[:_CELLS]
            _add(equations, level, columns[chosen], difference[chosen])
    for level, ridge in _RIDGE.items():
        _solve(_first(net, level), equations[level], ridge)


def _both(
    net: DGCNet,
    trained: DGCNet,
    level: int,
    new: list[list[Tensor]],
    old: list[list[Tensor]],
    state: Tensor | None,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """A level of both networks from the same state before it.

    Returns the inputs and outputs of the new first convolution, the outputs of the trained one, and
    the trained network's state.
    """
    if state is None:
        inputs, values, _ = _watched(net, level, lambda: net.coarsest(*new))
        before = inputs[:, -net.config.map_channels :]
        _, wanted, following = _watched(trained, level, lambda: trained.coarsest(*old), before)
        return inputs, values, wanted, following
    before = upsample(state)

    def refined(one: DGCNet, features: list[list[Tensor]]) -> Callable[[], Tensor]:
        warped = one.warp(features[0][level], before)
        return lambda: one.refine(level, warped, features[1][level], before)

    inputs, values, _ = _watched(net, level, refined(net, new))
    _, wanted, following = _watched(trained, level, refined(trained, old))
    return inputs, values, wanted, following


def _watched(
    net: DGCNet, level: int, run: Callable[[], Tensor], before: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """Inputs and outputs of a level's first convolution while `run` runs, and what it returns.

    before: put in place of the state before the level, the last channels of the inputs.
    """
    seen: list[Tensor] = []

    def replace(module: nn.Module, arguments: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
        if before is None:
            return arguments
        (inputs,) = arguments
        return (torch.cat([inputs[:, : -before.shape[1]], before], 1),)

    def keep(module: nn.Module, arguments: tuple[Tensor, ...], output: Tensor) -> None:
        seen.extend([arguments[0], output])

    convolution = _first(net, level)
    hooks: list[RemovableHandle] = [
        convolution.register_forward_pre_hook(replace),
        convolution.register_forward_hook(keep),
    ]
    try:
        result = run()
    finally:
        for hook in hooks:
            hook.remove()
    return seen[0], seen[1], result


def _copy(net: DGCNet, trained: DGCNet, level: int) -> None:
    """Copy a level's decoder. In its first convolution the channels of the encoder's features get
    weight 0, if the level is fitted."""
    name = f"reg_{level}"
    state = trained.get_submodule(name).state_dict()
    first = "conv0.0.weight"
    given, own = state[first], _first(net, level).weight
    if level in _RIDGE:
        # The last channels are the state before, and, at levels 3 and 2, the local correlation.
        same = net.config.map_channels
        if level != COARSEST:
            same = own.shape[1] - 2 * net.config.level_channels[level]
        kept = torch.zeros_like(own)
        kept[:, -same:] = given[:, -same:]
        state = {**state, first: kept}
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


def _add(equations: dict[int, _Equations], level: int, columns: Tensor, difference: Tensor) -> None:
    columns = torch.cat([columns, columns.new_ones(len(columns), 1)], 1)  # the bias
    gram, moments = (columns.T @ columns).double(), (columns.T @ difference).double()
    if level in equations:
        equations[level].gram += gram
        equations[level].moments += moments
    else:
        equations[level] = _Equations(gram, moments)
    equations[level].count += len(columns)


def _solve(convolution: nn.Conv2d, equations: _Equations, ridge: float) -> None:
    """Add the regression's weights to the convolution's."""
    scale = equations.gram.diagonal().clamp(min=1e-9 * equations.count).sqrt()
    normal = equations.gram / scale[:, None] / scale
    normal += ridge * torch.eye(len(normal), dtype=normal.dtype)
    weights = torch.linalg.solve(normal, equations.moments / scale[:, None]) / scale[:, None]
    weights = weights.to(convolution.weight.dtype)
    convolution.weight += weights[:-1].T.reshape(convolution.weight.shape)
    assert convolution.bias is not None
    convolution.bias += weights[-1]
