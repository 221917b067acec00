"""The network run by torch: on any device, with any weights."""

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import cast

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from dgc_pose.geometry.pixels import Size
from dgc_pose.images.image import resize
from dgc_pose.network.config import COARSEST, STRIDE
from dgc_pose.network.coordinates import to_pixels
from dgc_pose.network.inference import for_inference
from dgc_pose.network.net import DGCNet, normalise
from dgc_pose.network.weights import load_network, network_fingerprint
from dgc_pose.runtime.engine import DecodedMap, MapFeatures, NativeFeatures


class TorchEngine:
    """A network as an `Engine`, on the device where its weights are.

    fingerprint: of the weights before `for_inference`; None to compute it.
    """

    concurrent = False  # its layers use all threads, or the GPU

    def __init__(self, net: DGCNet, fingerprint: str | None = None) -> None:
        self.net = net.eval().requires_grad_(False)
        self.config = net.config
        self._fingerprint = fingerprint

    @cached_property
    def fingerprint(self) -> str:
        return self._fingerprint or network_fingerprint(self.net)

    @cached_property
    def correlation_scales(self) -> np.ndarray:
        return cast(Tensor, self.net.correlation_scales).float().cpu().numpy()

    @torch.inference_mode()
    def encode(self, pixels: np.ndarray) -> MapFeatures:
        size = self.config.input_size((pixels.shape[1], pixels.shape[0]))
        return MapFeatures(self.net.features(self._input(pixels, size)), size)

    @torch.inference_mode()
    def coarsest(self, features: MapFeatures) -> np.ndarray:
        return _unit(features.levels[COARSEST])

    @torch.inference_mode()
    def decode(
        self, source: Sequence[MapFeatures], target: Sequence[MapFeatures], finest: int
    ) -> list[DecodedMap]:
        """As `Engine.decode`; pairs of images of the same shapes are decoded together."""
        groups: dict[tuple[Size, Size], list[int]] = {}
        for index, (first, second) in enumerate(zip(source, target, strict=True)):
            groups.setdefault((first.size, second.size), []).append(index)
        decoded: dict[int, DecodedMap] = {}
        for indices in groups.values():
            maps = self._decode([source[i] for i in indices], [target[i] for i in indices], finest)
            decoded |= zip(indices, maps, strict=True)
        return [decoded[index] for index in range(len(source))]

    def _decode(
        self, source: Sequence[MapFeatures], target: Sequence[MapFeatures], finest: int
    ) -> list[DecodedMap]:
        """As `decode`, of images of the same shapes."""
        size = source[0].size
        prediction = self.net.decode(_stacked(source), _stacked(target), finest)
        maps = prediction.maps[-1].movedim(1, -1).float().nan_to_num(-2.0)
        points = to_pixels(maps, size, self.config.align_corners)
        masks = torch.ones(points.shape[:3])
        if prediction.logits:
            masks = prediction.logits[-1][:, 0].float().sigmoid()
        arrays = zip(points.cpu().numpy(), masks.cpu().numpy(), strict=True)
        return [DecodedMap(*pair, size) for pair in arrays]

    @torch.inference_mode()
    def native(self, pixels: np.ndarray, cells: tuple[int, int]) -> NativeFeatures:
        planes = self._input(pixels, (cells[0] * STRIDE, cells[1] * STRIDE))
        fine, middle, coarse = map(_unit, self.net.coarse_features(planes))
        return NativeFeatures(coarse, middle, fine, (pixels.shape[1], pixels.shape[0]))

    def _input(self, pixels: np.ndarray, size: Size) -> Tensor:
        return network_input(pixels, size, next(self.net.parameters()).device)


def load_torch_engine(
    weights: str | Path, device: torch.device, half_precision: bool = False
) -> TorchEngine:
    """An engine of weights by name or path (see `load_network`), made faster for inference.

    half_precision: convolutions in bfloat16.
    """
    net = load_network(weights, device)
    net.half_precision = half_precision
    return TorchEngine(for_inference(net), network_fingerprint(net))


def network_input(pixels: np.ndarray, size: tuple[int, int], device: torch.device) -> Tensor:
    """An image (H, W, 3), uint8, as the network takes it: (1, 3, h, w) of `size` (width, height),
    channels last."""
    resized = torch.from_numpy(resize(pixels, size))
    planes = resized.to(device).permute(2, 0, 1)[None].float() / 255
    return normalise(planes).contiguous(memory_format=torch.channels_last)


def _unit(level: Tensor) -> np.ndarray:
    """Features (1, C, h, w) as (h, w, C) of unit length over the channels."""
    unit: np.ndarray = F.normalize(level[0].float().permute(1, 2, 0), dim=-1).cpu().numpy()
    return np.ascontiguousarray(unit)


def _stacked(images: Sequence[MapFeatures]) -> list[Tensor]:
    """The features of several images as those of one batch, level by level."""
    if len(images) == 1:
        return images[0].levels
    return [torch.cat(level) for level in zip(*(image.levels for image in images), strict=True)]
