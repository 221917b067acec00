"""The frozen network as a matcher: images of any size in, matches in their own pixels out."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.errors import InputError
from dgc_pose.image import Image, resize
from dgc_pose.matching.cache import BoundedCache
from dgc_pose.matching.matcher import CorrespondenceMap, Matcher, MatchResult
from dgc_pose.matching.selection import MatchingOptions, select_matches
from dgc_pose.matching.texture import textured
from dgc_pose.network.config import COARSEST, INPUT_SIZE
from dgc_pose.network.coordinates import to_pixels
from dgc_pose.network.device import choose_device
from dgc_pose.network.inference import for_inference
from dgc_pose.network.net import DGCNet, Prediction
from dgc_pose.network.statistics import normalise
from dgc_pose.network.weights import DEFAULT, load_network
from dgc_pose.pixels import Size, cell_centres, rescale

_SQUARE = (INPUT_SIZE, INPUT_SIZE)  # width and height of the images that the network takes

# The encoder's features by image and quarter turns of it; keyed by the object, not by its pixels.
FeatureCache = BoundedCache[tuple[Image, int], list[Tensor]]


def feature_cache() -> FeatureCache:
    """A cache of the default size. The images that it keeps alive count towards it."""
    return BoundedCache(
        lambda key, features: key[0].pixels.nbytes + sum(level.nbytes for level in features)
    )


class DenseMatcher(Matcher):
    """Matches by a frozen `DGCNet`; image 1 is its source, image 2 its target.

    cache: of the encoder's features; None to encode the images anew for each pair.

    Raises InputError if `finest` is a level that the network's mask is not made for.
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

    @property
    def fingerprint(self) -> str:
        """Of the weights: different weights of one network have different fingerprints."""
        digest = hashlib.sha256()
        for key, value in sorted(self.net.state_dict().items()):
            digest.update(key.encode() + value.cpu().numpy().tobytes())
        return digest.hexdigest()[:16]

    def match(self, image1: Image, image2: Image) -> MatchResult:
        """The map at `finest` x `finest` cells, and the matches of it that pass the options."""
        return self.match_batch([(image1, image2)])[0]

    def match_batch(self, pairs: Sequence[tuple[Image, Image]]) -> list[MatchResult]:
        """As `match` for each pair, decoded together."""
        return [
            MatchResult(textured(select_matches(found, self.options), *pair), found)
            for pair, found in zip(pairs, self.correspondence_maps(pairs), strict=True)
        ]

    @torch.inference_mode()
    def coarse_features(self, image: Image) -> np.ndarray:
        """The coarsest features of an image (cells, C) float32, of unit length over C."""
        cache = feature_cache() if self.cache is None else self.cache
        coarse = self._features(image, 0, cache)[COARSEST][0].flatten(1)
        return F.normalize(coarse.float(), dim=0).T.cpu().numpy()

    @torch.inference_mode()
    def correspondence_maps(self, pairs: Sequence[tuple[Image, Image]]) -> list[CorrespondenceMap]:
        """The map of each pair, with the cycle error if the options ask for one.

        Pairs of images of the same shapes are decoded together. Images are encoded one by one, so
        that the features of an image are independent of the batch.
        """
        cache = feature_cache() if self.cache is None else self.cache
        found = self._rotated_maps(pairs, 0, cache)
        suggested = {
            i: self._likely_rotation(*pairs[i], cache)
            for i, one in enumerate(found)
            if one.matchability.mean() < self.options.rotate_below
        }
        for quarter_turns in sorted({*suggested.values()} - {0}):
            weak = [i for i, rotation in suggested.items() if rotation == quarter_turns]
            maps = self._rotated_maps([pairs[i] for i in weak], quarter_turns, cache)
            for i, rotated in zip(weak, maps, strict=True):
                found[i] = max((found[i], rotated), key=lambda c: float(c.matchability.mean()))
        return found

    def _likely_rotation(self, image1: Image, image2: Image, cache: FeatureCache) -> int:
        """The quarter turns of image 2 whose coarsest features are most similar to image 1's.

        This needs no decoder, and on rendered pairs it finds the rotation as well as the maps do.
        """
        source, *targets = (
            F.normalize(self._features(image, turns, cache)[COARSEST][0].flatten(1), dim=0)
            for image, turns in ((image1, 0), *((image2, turns) for turns in range(4)))
        )
        similarity = [float((source.T @ target).amax(0).mean()) for target in targets]
        return similarity.index(max(similarity))

    def _rotated_maps(
        self, pairs: Sequence[tuple[Image, Image]], quarter_turns: int, cache: FeatureCache
    ) -> list[CorrespondenceMap]:
        """The maps computed with each image 2 rotated, given over image 2 as it is."""
        found: dict[int, CorrespondenceMap] = {}
        for same in _by_shapes(pairs):
            source = _stacked([self._features(pairs[i][0], 0, cache) for i in same])
            target = _stacked([self._features(pairs[i][1], quarter_turns, cache) for i in same])
            forward = _split(self.net.decode(source, target, self.options.finest))
            reverse: Sequence[Prediction | None] = [None] * len(same)
            if self.options.cycle_px is not None:
                reverse = _split(self.net.decode(target, source, self.options.finest))
            for i, one, other in zip(same, forward, reverse, strict=True):
                found[i] = self._map(*pairs[i], quarter_turns, one, other)
        return [found[i] for i in range(len(pairs))]

    def _map(
        self,
        image1: Image,
        image2: Image,
        quarter_turns: int,
        forward: Prediction,
        reverse: Prediction | None,
    ) -> CorrespondenceMap:
        """The map of one pair from its predictions with image 2 rotated."""
        seen1, seen2 = (self.net.config.input_size(image.size) for image in (image1, image2))
        points1 = self._finest_points(forward, seen1)
        cycle = None
        if reverse is not None:
            rotated2 = _rotated_size(seen2, quarter_turns)
            returned = self._finest_points(reverse, rotated2)
            size2 = _rotated_size(image2.size, quarter_turns)
            cycle = _cycle_error(points1, returned, (seen1, rotated2), size2)
            cycle = np.rot90(cycle, -quarter_turns)
        upright = np.rot90(points1[0].cpu().numpy(), -quarter_turns)
        centres = cell_centres(upright.shape[1::-1], seen2)
        return CorrespondenceMap(
            map=rescale(upright, seen1, image1.size).astype(np.float32),
            grid=rescale(centres, seen2, image2.size).astype(np.float32),
            matchability=np.ascontiguousarray(np.rot90(_matchability(forward), -quarter_turns)),
            size1=image1.size,
            size2=image2.size,
            cycle=cycle,
        )

    def _features(self, image: Image, quarter_turns: int, cache: FeatureCache) -> list[Tensor]:
        """The encoder's features of an image rotated by `numpy.rot90`."""

        def encode() -> list[Tensor]:
            rotated = np.ascontiguousarray(np.rot90(image.pixels, quarter_turns))
            size = self.net.config.input_size((rotated.shape[1], rotated.shape[0]))
            device = next(self.net.parameters()).device
            return self.net.features(network_input(rotated, device, size))

        return cache.get((image, quarter_turns), encode)

    def _finest_points(self, prediction: Prediction, size: tuple[int, int]) -> Tensor:
        """The finest map (1, H, W, 2), in pixels of the source at `size`, the network's input."""
        finest = prediction.maps[-1].movedim(1, -1).float()
        return to_pixels(finest.nan_to_num(-2.0), size, self.net.config.align_corners)


def load_dense_matcher(
    weights: str | Path = DEFAULT,
    *,
    device: str = "auto",
    options: MatchingOptions | None = None,
    cache: FeatureCache | None = None,
) -> DenseMatcher:
    """The network alone, without refinement: shipped weights by name, or those of a file (see
    `load_network`).

    Raises WeightsError if the weights cannot be loaded, InputError if there is no such device.
    """
    net = for_inference(load_network(weights, choose_device(device)))
    return DenseMatcher(net, options, cache)


def network_input(
    pixels: np.ndarray, device: torch.device, size: tuple[int, int] = _SQUARE
) -> Tensor:
    """An image (H, W, 3), uint8, as the network takes it: (1, 3, h, w), channels last.

    size: (w, h), see `NetworkConfig.input_size`.
    """
    resized = torch.from_numpy(resize(pixels, size))
    planes = resized.to(device).permute(2, 0, 1)[None].float() / 255
    return normalise(planes).contiguous(memory_format=torch.channels_last)


def _cycle_error(
    forward: Tensor, reverse: Tensor, seen: tuple[Size, Size], size2: Size
) -> np.ndarray:
    """Distance (H, W) between each cell of image 2 and its image under both maps, in pixels of
    image 2 at size2.

    forward: (1, H, W, 2), reverse: (1, H1, W1, 2), pixels of images 1 and 2 at the sizes `seen` by
    the network.
    """
    normalised = (2 * forward + 1) / forward.new_tensor(seen[0]) - 1
    sampled = F.grid_sample(
        reverse.movedim(-1, 1), normalised, padding_mode="border", align_corners=False
    )
    returned = sampled[0].movedim(0, -1).cpu().numpy()
    offset = returned - cell_centres(returned.shape[1::-1], seen[1])
    return np.linalg.norm(offset * np.divide(size2, seen[1]), axis=-1).astype(np.float32)


def _rotated_size(size: Size, quarter_turns: int) -> Size:
    return size if quarter_turns % 2 == 0 else (size[1], size[0])


def _by_shapes(pairs: Sequence[tuple[Image, Image]]) -> list[list[int]]:
    """Indices of the pairs, those of images of the same sizes together."""
    groups: dict[tuple[Size, Size], list[int]] = {}
    for index, (first, second) in enumerate(pairs):
        groups.setdefault((first.size, second.size), []).append(index)
    return list(groups.values())


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
