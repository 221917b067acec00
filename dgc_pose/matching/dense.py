"""The frozen network as a matcher: images of any size in, matches in their own pixels out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.image import Image
from dgc_pose.matches import Matches
from dgc_pose.matching.cache import BoundedCache
from dgc_pose.matching.matcher import CorrespondenceMap
from dgc_pose.matching.selection import MatchingOptions, select_matches
from dgc_pose.network.config import INPUT_SIZE
from dgc_pose.network.coordinates import to_pixels
from dgc_pose.network.device import choose_device
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
    """Matches by a frozen `DGCNet`; image 1 is its source, image 2 its target."""

    def __init__(
        self,
        net: DGCNet,
        options: MatchingOptions | None = None,
        cache: FeatureCache | None = None,
    ) -> None:
        self.net = net.eval().requires_grad_(False)
        self.options = options or MatchingOptions()
        self.cache = cache

    @property
    def name(self) -> str:
        return self.net.config.name

    def match(self, image1: Image, image2: Image) -> Matches:
        """The matches that pass the options, in pixels of the original images."""
        return self.select(self.correspond(image1, image2))

    def correspond(self, image1: Image, image2: Image) -> CorrespondenceMap:
        """The dense map at 240x240 cells; with the way back where the options ask for a cycle."""
        return self.correspond_batch([(image1, image2)])[0]

    @torch.no_grad()
    def correspond_batch(self, pairs: Sequence[tuple[Image, Image]]) -> list[CorrespondenceMap]:
        """As `correspond` for each pair, decoded together; images are encoded one by one, so that
        what the encoder makes of an image does not hang on those beside it."""
        found = self._at_roll(pairs, 0)
        least = self.options.roll_share
        weak = [i for i, one in enumerate(found) if one.matchability.mean() < least]
        for roll in (1, 2, 3) if weak else ():
            for i, turned in zip(weak, self._at_roll([pairs[i] for i in weak], roll), strict=True):
                found[i] = max((found[i], turned), key=lambda c: float(c.matchability.mean()))
        return found

    def select(self, correspondences: CorrespondenceMap) -> Matches:
        """The cells of a map that pass the options."""
        return select_matches(correspondences, self.options)

    def _at_roll(
        self, pairs: Sequence[tuple[Image, Image]], roll: int
    ) -> list[CorrespondenceMap]:
        """The maps to images 2 turned by `roll` times 90 degrees, on the grids of images 2 as they
        are."""
        source = _stacked([self._features(first, 0) for first, _ in pairs])
        target = _stacked([self._features(second, roll) for _, second in pairs])
        there = _split(self.net.decode(source, target))
        back: Sequence[Prediction | None] = [None] * len(pairs)
        if self.options.cycle_px is not None:
            back = _split(self.net.decode(target, source))
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
        axis = np.arange(INPUT_SIZE, dtype=np.float64)
        return CorrespondenceMap(
            map=_to_original(np.rot90(place[0].cpu().numpy(), -roll), image1.size),
            grid=_to_original(np.stack(np.meshgrid(axis, axis), -1), image2.size),
            matchability=np.ascontiguousarray(np.rot90(_matchability(there), -roll)),
            size1=image1.size,
            size2=image2.size,
            cycle=cycle,
        )

    def _features(self, image: Image, roll: int) -> list[Tensor]:
        """The encoder's features of an image turned by `roll` times 90 degrees."""

        def encode() -> list[Tensor]:
            turned = np.ascontiguousarray(np.rot90(image.pixels, roll))
            return self.net.features(self._input(turned))

        return encode() if self.cache is None else self.cache.get((image, roll), encode)

    def _input(self, image: np.ndarray) -> Tensor:
        pixels = torch.from_numpy(resize(image, (INPUT_SIZE, INPUT_SIZE)))
        device = next(self.net.parameters()).device
        planes = pixels.to(device).permute(2, 0, 1)[None].float() / 255
        return normalise(planes).contiguous(memory_format=torch.channels_last)

    def _cells(self, prediction: Prediction) -> Tensor:
        """The finest map (1, S, S, 2) in cells of the source."""
        size = (INPUT_SIZE, INPUT_SIZE)
        place = prediction.maps[-1].movedim(1, -1).float()
        return to_pixels(place.nan_to_num(-2.0), size, self.net.config.align_corners)

    def _cycle(self, there: Tensor, back: Tensor, size2: tuple[int, int]) -> np.ndarray:
        """How far each cell of image 2 (size2) comes back off, in its pixels: (S, S)."""
        normalised = 2 * there / (INPUT_SIZE - 1) - 1
        sampled = F.grid_sample(back.movedim(-1, 1), normalised, align_corners=True)
        returned = sampled[0].movedim(0, -1).cpu().numpy()
        axis = np.arange(INPUT_SIZE, dtype=np.float32)
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
    return DenseMatcher(load_network(weights, choose_device(device)), options, cache)


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


def _to_original(cells: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Places in cells of the 240 grid to pixels of the original image, by the half-pixel rule."""
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
        return np.ones((INPUT_SIZE, INPUT_SIZE), np.float32)
    return prediction.logits[-1][0, 0].float().sigmoid().cpu().numpy()
