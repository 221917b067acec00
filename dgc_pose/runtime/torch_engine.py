"""The network run by torch: on any device, with any weights."""

from copy import deepcopy
from typing import TypeVar

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from dgc_pose.images.image import resize
from dgc_pose.network.config import COARSEST, STRIDE
from dgc_pose.network.net import DGCNet, normalise, to_pixels
from dgc_pose.network.weights import fingerprint
from dgc_pose.runtime.engine import MapFeatures, NativeFeatures

Net = TypeVar("Net", bound=nn.Module)


class TorchEngine:
    """A network as an `Engine`, on the device where its weights are; see `for_inference`."""

    concurrent = False  # its layers use all threads, or the GPU
    can_resume = False

    def __init__(self, net: DGCNet) -> None:
        weights = ((key, value.cpu().numpy()) for key, value in net.state_dict().items())
        self.fingerprint = fingerprint(weights)
        self.net = for_inference(net)
        self.config = net.config
        self._device = next(self.net.parameters()).device
        self.correlation_scales = net.get_buffer("correlation_scales").float().cpu().numpy()

    @torch.inference_mode()
    def encode(self, pixels: np.ndarray) -> MapFeatures:
        size = self.config.input_size((pixels.shape[1], pixels.shape[0]))
        return MapFeatures(self.net.features(network_input(pixels, size, self._device)), size)

    @torch.inference_mode()
    def coarsest(self, features: MapFeatures) -> np.ndarray:
        return _unit(features.levels[COARSEST])

    @torch.inference_mode()
    def decode(
        self, source: MapFeatures, target: MapFeatures, finest: int
    ) -> tuple[np.ndarray, np.ndarray]:
        prediction = self.net.decode(source.levels, target.levels, finest)
        normalised = prediction.maps[-1][0].movedim(0, -1).float().nan_to_num(-2.0)
        points = to_pixels(normalised, source.size, self.config.align_corners)
        mask = torch.ones(points.shape[:2])
        if prediction.logits:
            mask = prediction.logits[-1][0, 0].float().sigmoid()
        return points.cpu().numpy(), mask.cpu().numpy()

    @torch.inference_mode()
    def native(self, pixels: np.ndarray, cells: tuple[int, int]) -> NativeFeatures:
        planes = network_input(pixels, (cells[0] * STRIDE, cells[1] * STRIDE), self._device)
        fine, middle, coarse = map(_unit, self.net.coarse_features(planes))
        return NativeFeatures(coarse, middle, fine)


def for_inference(net: Net) -> Net:
    """A frozen copy: batch norms folded into the convolutions before them, ReLUs in place, filters
    channels last."""
    copy = deepcopy(net).eval().requires_grad_(False)
    for module in list(copy.modules()):
        if isinstance(module, nn.Sequential):
            _fold(module)
    copy.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return copy


def _fold(layers: nn.Sequential) -> None:
    """Fold batch norms and leave identities in their places, so other layers keep their names."""
    for index, (before, layer) in enumerate(zip(layers, list(layers)[1:], strict=False), 1):
        if isinstance(layer, nn.BatchNorm2d) and isinstance(before, nn.Conv2d):
            layers[index - 1] = fuse_conv_bn_eval(before, layer)
            layers[index] = nn.Identity()
        elif isinstance(layer, nn.ReLU):
            layer.inplace = True  # its input, a convolution's output, is not read again


def network_input(pixels: np.ndarray, size: tuple[int, int], device: torch.device) -> Tensor:
    """The network's input (1, 3, h, w), channels last in memory, of `size` (width, height), from an
    image (H, W, 3) uint8."""
    resized = torch.from_numpy(resize(pixels, size))
    planes = resized.to(device).permute(2, 0, 1)[None].float() / 255
    return normalise(planes).contiguous(memory_format=torch.channels_last)


def _unit(level: Tensor) -> np.ndarray:
    """Features (1, C, h, w) as (h, w, C) of unit length over the channels."""
    unit: np.ndarray = F.normalize(level[0].float().permute(1, 2, 0), dim=-1).cpu().numpy()
    return np.ascontiguousarray(unit)
