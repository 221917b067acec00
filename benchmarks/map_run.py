"""Every method on every pair of a data set with known maps."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import cv2
import numpy as np
import torch
from torch import Tensor, nn

from dgc_pose.benchmarks.flow import NAME as FLOW
from dgc_pose.benchmarks.flow import FlowMatcher
from dgc_pose.benchmarks.map_scores import Comparison, LevelMap, MapScore, score_map
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.geometry.pixels import pixel_grid
from dgc_pose.images.image import Image
from dgc_pose.matchers import MatcherOptions
from dgc_pose.matching.matcher import Matcher
from dgc_pose.network.config import INPUT_SIZE, NetworkConfig
from dgc_pose.network.net import normalise, to_pixels
from dgc_pose.network.weights import choose_device, load_network
from dgc_pose.training.map_pairs import MapPairs, image_arrays, level_truth

MapMethod = Callable[[MapPairs], list[Comparison]]  # of a batch, pair by pair
_SIZE = (INPUT_SIZE, INPUT_SIZE)


@dataclass(frozen=True, eq=False)
class MapCase:
    """A batch of 240x240 pairs, named."""

    group: str  # that the figures are averaged in
    names: tuple[str, ...]  # of each pair
    pairs: MapPairs


@dataclass(frozen=True, eq=False)
class MapSet:
    """A data set: pairs with known maps, batch by batch."""

    cases: Iterable[MapCase]
    total: int  # pairs
    facts: Mapping[str, Any]  # what is known of the set, for the JSON
    title: str  # a line


def load_map_methods(names: Sequence[str], *, device: str) -> dict[str, MapMethod]:
    """What makes the dense maps of methods, by name: bare networks, and matchers without one.

    Raises InputError for no names, one that is given twice, or a matcher of key points;
    WeightsError if weights cannot be loaded.
    """
    if not names:
        raise InputError("no methods named")
    chosen = choose_device(device)
    methods: dict[str, MapMethod] = {}
    for name in names:
        if name in methods:
            raise InputError(f"the method {name} is named twice")
        if not MatcherOptions(name).is_network:
            words = f"{name}: has key points alone and no dense map"
            raise InputError(ArgumentName("methods"), words)
        if name == FLOW:
            methods[name] = partial(compare_matcher, FlowMatcher())
        else:
            methods[name] = partial(compare, load_network(name, chosen))
    return methods


def map_scores(cases: Iterable[MapCase], methods: Mapping[str, MapMethod]) -> Iterator[MapScore]:
    """The figures of each pair by each method, case by case."""
    for case in cases:
        for method, comparisons_of in methods.items():
            for name, comparison in zip(case.names, comparisons_of(case.pairs), strict=True):
                yield score_map(method, case.group, name, comparison)


@torch.no_grad()
def compare(net: nn.Module, pairs: MapPairs) -> list[Comparison]:
    """The net's forward pass on a batch of 240x240 pairs, split into pairs.

    net: a `DGCNet` in evaluation mode, or another module with its `config` that gives a
    `Prediction`.
    """
    align_corners = cast(NetworkConfig, net.config).align_corners
    device = next(net.parameters()).device
    images = [
        normalise(image.to(device)).contiguous(memory_format=torch.channels_last)
        for image in (pairs.image1, pairs.image2)
    ]
    prediction = net(*images)
    levels = []
    for level in prediction.maps:
        truth, valid = level_truth(pairs.map, pairs.valid, level.shape[-1])
        points = to_pixels(level.float().movedim(1, -1), _SIZE, align_corners)
        parts = zip(_array(points), _array(truth), _array(valid), strict=True)
        levels.append([LevelMap(*part) for part in parts])
    masks: list[np.ndarray | None] = [None] * len(pairs.map)
    if prediction.logits:
        masks = [*_array(prediction.logits[-1][:, 0].float().sigmoid())]
    return [Comparison(*parts) for parts in zip(zip(*levels, strict=True), masks, strict=True)]


def compare_matcher(matcher: Matcher, pairs: MapPairs) -> list[Comparison]:
    """The dense maps of a matcher that makes them, of 240x240 pairs.

    A map of fewer cells is brought to the pixels: its displacements linearly, beyond the outermost
    centres as there, and its matchability as that of the nearest cell.
    """
    comparisons = []
    images = zip(image_arrays(pairs.image1), image_arrays(pairs.image2), strict=True)
    truths = zip(_array(pairs.map), _array(pairs.valid), strict=True)
    for pixels, truth in zip(images, truths, strict=True):
        dense = matcher.match(*map(Image, pixels)).correspondence_map
        assert dense is not None
        shift = cv2.resize(dense.map - dense.grid, _SIZE, interpolation=cv2.INTER_LINEAR)
        mask = cv2.resize(dense.matchability, _SIZE, interpolation=cv2.INTER_NEAREST)
        points = (pixel_grid(_SIZE) + shift).astype(np.float32)
        comparisons.append(Comparison((LevelMap(points, *truth),), mask))
    return comparisons


def _array(values: Tensor) -> np.ndarray:
    return values.cpu().numpy()
