"""The frozen network as a matcher: images of any size in, matches in their own pixels out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.errors import InputError
from dgc_pose.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.cache import BoundedCache
from dgc_pose.matching.matcher import CorrespondenceMap
from dgc_pose.matching.selection import MatchingOptions, select_matches
from dgc_pose.network.config import COARSEST, INPUT_SIZE
from dgc_pose.network.coordinates import to_pixels
from dgc_pose.network.device import choose_device
from dgc_pose.network.inference import for_inference
from dgc_pose.network.net import DGCNet, Prediction
from dgc_pose.network.statistics import normalise
from dgc_pose.network.weights import DEFAULT, load_network

# The encoder's features of an image, the object and not its content, by quarter turns of it.
FeatureCache = BoundedCache[tuple[Image, int], list[Tensor]]


def feature_cache() -> FeatureCache:
    """A cache of the usual size; the images that it keeps alive count."""
    return BoundedCache(
        lambda key, features: key[0].pixels.nbytes + sum(level.nbytes for level in features)
    )


class DenseMatcher:
    """Matches by a frozen `DGCNet`; image 1 is its source, image 2 its target.

    Raises InputError where the options stop at a level that the network's mask is not made for.
    """

    def __init__(
        self,
        net: DGCNet,
        options: MatchingOptions | None = None,
        cache: FeatureCache | None = None,
    ) -> None:
        self.net = net.eval().requires_grad_(False)
        self.options = options or MatchingOptions()
        if net.config.matchability == "network" and self.options.finest != INPUT_SIZE:
            raise InputError(
                f"the mask network of {self.name} works at {INPUT_SIZE} cells alone: finest must "
                f"be {INPUT_SIZE}, not {self.options.finest}"
            )
        self.cache = cache

    @property
    def name(self) -> str:
        return self.net.config.name

    def match(self, image1: Image, image2: Image) -> Matches:
        """The matches that pass the options, in pixels of the original images."""
        return self.trace(image1, image2)[1]

    def trace(self, image1: Image, image2: Image) -> tuple[CorrespondenceMap, Matches]:
        """The dense map, and the matches of it that pass the options."""
        correspondences = self.correspond(image1, image2)
        return correspondences, self.select(correspondences)

    def correspond(self, image1: Image, image2: Image) -> CorrespondenceMap:
        """The dense map at `finest` x `finest` cells; with the way back where the options ask for
        a cycle."""
        return self.correspond_batch([(image1, image2)])[0]

    @torch.inference_mode()
    def correspond_batch(self, pairs: Sequence[tuple[Image, Image]]) -> list[CorrespondenceMap]:
        """As `correspond` for each pair, decoded together; images are encoded one by one, so that
        what the encoder makes of an image does not hang on those beside it."""
        cache = feature_cache() if self.cache is None else self.cache
        found = self._at_roll(pairs, 0, cache)
        rolls = {
            i: self._likely_roll(*pairs[i], cache)
            for i, one in enumerate(found)
            if one.matchability.mean() < self.options.roll_share
        }
        for roll in (1, 2, 3):
            weak = [i for i, likely in rolls.items() if likely == roll]
            maps = self._at_roll([pairs[i] for i in weak], roll, cache) if weak else []
            for i, turned in zip(weak, maps, strict=True):
                found[i] = max((found[i], turned), key=lambda c: float(c.matchability.mean()))
        return found

    def select(self, correspondences: CorrespondenceMap) -> Matches:
        """The cells of a map that pass the options."""
        return select_matches(correspondences, self.options)

    def _likely_roll(self, image1: Image, image2: Image, cache: FeatureCache) -> int:
        """The roll of image 2 at which its coarsest cells find the most alike ones in image 1.

        No decoder need run for that: on rendered pairs it names the roll as well as the maps do.
        """
        source, *targets = (
            F.normalize(self._features(image, roll, cache)[COARSEST][0].flatten(1), dim=0)
            for image, roll in ((image1, 0), *((image2, roll) for roll in range(4)))
        )
        alike = [float((source.T @ target).amax(0).mean()) for target in targets]
        return alike.index(max(alike))

    def _at_roll(
        self, pairs: Sequence[tuple[Image, Image]], roll: int, cache: FeatureCache
    ) -> list[CorrespondenceMap]:
        """The maps to images 2 turned by `roll` times 90 degrees, on the grids of images 2 as they
        are."""
        source = _stacked([self._features(first, 0, cache) for first, _ in pairs])
        target = _stacked([self._features(second, roll, cache) for _, second in pairs])
        there = _split(self.net.decode(source, target, self.options.finest))
        back: Sequence[Prediction | None] = [None] * len(pairs)
        if self.options.cycle_px is not None:
            back = _split(self.net.decode(target, source, self.options.finest))
        return [
            self._found(*pair, roll, there_, back_)
            for pair, there_, back_ in zip(pairs, there, back, strict=True)
        ]

    def _found(
        self, image1: Image, image2: Image, roll: int, there: Prediction, back: Prediction | None
    ) -> CorrespondenceMap:
        """The map of one pair from the predictions with image 2 turned."""
        place = self._cells(there)
        cycle = None
        if back is not None:
            size = image2.size if roll % 2 == 0 else image2.size[::-1]
            cycle = np.rot90(self._cycle(place, self._cells(back), size), -roll)
        axis = _centres(self.options.finest)
        return CorrespondenceMap(
            map=_to_original(np.rot90(place[0].cpu().numpy(), -roll), image1.size),
            grid=_to_original(np.stack(np.meshgrid(axis, axis), -1), image2.size),
            matchability=np.ascontiguousarray(np.rot90(_matchability(there), -roll)),
            size1=image1.size,
            size2=image2.size,
            cycle=cycle,
        )

    def _features(self, image: Image, roll: int, cache: FeatureCache) -> list[Tensor]:
        """The encoder's features of an image turned by `roll` times 90 degrees."""

        def encode() -> list[Tensor]:
            turned = np.ascontiguousarray(np.rot90(image.pixels, roll))
            return self.net.features(self._input(turned))

        return cache.get((image, roll), encode)

    def _input(self, image: np.ndarray) -> Tensor:
        return network_input(image, next(self.net.parameters()).device)

    def _cells(self, prediction: Prediction) -> Tensor:
        """The finest map (1, S, S, 2), in pixels of the source as the network sees it."""
        size = (INPUT_SIZE, INPUT_SIZE)
        place = prediction.maps[-1].movedim(1, -1).float()
        return to_pixels(place.nan_to_num(-2.0), size, self.net.config.align_corners)

    def _cycle(self, there: Tensor, back: Tensor, size2: tuple[int, int]) -> np.ndarray:
        """How far each cell of image 2 (size2) comes back off, in its pixels: (S, S)."""
        normalised = (2 * there + 1) / INPUT_SIZE - 1
        sampled = F.grid_sample(
            back.movedim(-1, 1), normalised, padding_mode="border", align_corners=False
        )
        returned = sampled[0].movedim(0, -1).cpu().numpy()
        axis = _centres(len(returned))
        off = returned - np.stack(np.meshgrid(axis, axis), -1)
        return np.linalg.norm(off * np.divide(size2, INPUT_SIZE), axis=-1).astype(np.float32)


def load_matcher(
    weights: str | Path = DEFAULT,
    *,
    device: str = "auto",
    options: MatchingOptions | None = None,
    cache: FeatureCache | None = None,
) -> DenseMatcher:
    """A matcher with shipped weights, by name, or with those of a file (see `load_network`).

    Raises WeightsError where the weights cannot be had, InputError where the device cannot.
    """
    net = for_inference(load_network(weights, choose_device(device)))
    return DenseMatcher(net, options, cache)


def network_input(pixels: np.ndarray, device: torch.device) -> Tensor:
    """An image (H, W, 3), uint8, as the network takes it: (1, 3, 240, 240), channels last."""
    squared = torch.from_numpy(resize(pixels, (INPUT_SIZE, INPUT_SIZE)))
    planes = squared.to(device).permute(2, 0, 1)[None].float() / 255
    return normalise(planes).contiguous(memory_format=torch.channels_last)


def resize(pixels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """An image (H, W, 3) at `size` (width, height): means of areas where it shrinks, else bilinear.

    Both keep the outer edges of the image in place, as the half-pixel rule wants.
    """
    height, width = pixels.shape[:2]
    shrunk = (min(size[0], width), min(size[1], height))
    if shrunk != (width, height):
        pixels = cv2.resize(pixels, shrunk, interpolation=cv2.INTER_AREA)
    if shrunk != size:
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_LINEAR)
    return pixels


def _centres(cells: int) -> np.ndarray:
    """Centres of so many cells along a side (cells,), in pixels of the image the network sees."""
    return (np.arange(cells) + 0.5) * (INPUT_SIZE / cells) - 0.5


def _to_original(cells: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Places in pixels of the 240 x 240 image to the original's, by the half-pixel rule."""
    scale = np.divide(size, INPUT_SIZE)
    return ((cells + 0.5) * scale - 0.5).astype(np.float32)


def _stacked(features: Sequence[list[Tensor]]) -> list[Tensor]:
    """The features of several images as those of one batch, level by level."""
    if len(features) == 1:
        return features[0]
    return [torch.cat(level) for level in zip(*features, strict=True)]


def _split(prediction: Prediction) -> list[Prediction]:
    """The predictions of a batch, each as that of a batch of one."""
    return [
        Prediction(
            tuple(level[i : i + 1] for level in prediction.maps),
            tuple(level[i : i + 1] for level in prediction.logits),
        )
        for i in range(len(prediction.maps[0]))
    ]


def _matchability(prediction: Prediction) -> np.ndarray:
    if not prediction.logits:
        return np.ones(prediction.maps[-1].shape[2:], np.float32)
    return prediction.logits[-1][0, 0].float().sigmoid().cpu().numpy()
