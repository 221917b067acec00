"""CNNGeometric (Rocco, Arandjelovic and Sivic, CVPR 2017): transformations by regression."""

from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from dgc_pose.benchmarks.spline import TPS_KNOTS, thin_plate_spline
from dgc_pose.geometry.pixels import cell_centres, rescale
from dgc_pose.images.image import Image
from dgc_pose.matching import (
    CorrespondenceMap,
    Matcher,
    MatchingOptions,
    MatchResult,
    select_matches,
)
from dgc_pose.network.config import COARSEST, INPUT_SIZE, LEVEL_SIZES
from dgc_pose.network.coordinates import identity_map, to_pixels
from dgc_pose.network.net import DGCNet, global_correlation, l2_normalise
from dgc_pose.network.stored import read_tensors
from dgc_pose.network.weights import choose_device, load_network, network_fingerprint
from dgc_pose.runtime.torch_engine import for_inference, network_input

WEIGHTS = Path(__file__).parent / "rocco.safetensors"  # of the regressions, in half precision
ENCODER = "encoder"  # in its header, the fingerprint of the pyramid that they were trained on
_SQUARE = (INPUT_SIZE, INPUT_SIZE)
_CELLS = LEVEL_SIZES[COARSEST]
_KERNELS = (7, 5)  # of the two convolutions, without padding
_CHANNELS = (48, 64)  # the paper's are 128 and 64; with fewer both regressions fit into 3 MB
_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)  # an affine transformation (2, 3), row by row


class GeometricNet(nn.Module):
    """Two regressions, one after the other: affine, then a thin-plate spline on a 3x3 grid.

    Each reads the correlation of the coarsest features of both images, as the encoder of `network`
    gives them. The spline is of the source warped by the affine transformation.
    """

    def __init__(self, network: DGCNet) -> None:
        super().__init__()
        self.network = network
        self.config = network.config
        self.affine = Regression(len(_IDENTITY))
        self.spline = Regression(TPS_KNOTS.numel())

    def transformations(self, source: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
        """Affine transformations (B, 2, 3), target to source in normalised coordinates, and the
        points (B, 9, 2) that TPS_KNOTS of the target map to in the source warped by them.

        source, target: normalised images (B, 3, 240, 240).
        """
        seen = self.coarsest(target)
        change = self.affine(self.correlate(self.coarsest(source), seen))
        affine = (change + change.new_tensor(_IDENTITY)).view(-1, 2, 3)
        warped = self.network.warp(source, self.dense_map(affine, None, INPUT_SIZE))
        change = self.spline(self.correlate(self.coarsest(warped), seen))
        return affine, change.view(-1, *TPS_KNOTS.shape) + TPS_KNOTS.to(change)

    def coarsest(self, image: Tensor) -> Tensor:
        """The coarsest features (B, C, 15, 15) of normalised images."""
        return self.network.coarse_features(image)[-1]

    def correlate(self, source: Tensor, target: Tensor) -> Tensor:
        """The correlation (B, 225, 15, 15) that a regression reads: without its negative values,
        of unit length over the source's cells."""
        return l2_normalise(global_correlation(l2_normalise(source), l2_normalise(target)).relu())

    def dense_map(self, affine: Tensor, spline: Tensor | None, size: int) -> Tensor:
        """The map (B, 2, size, size) of an affine transformation after a spline, if there is one:
        points of the source, normalised."""
        grid = identity_map(size, self.config.align_corners, affine)
        points = grid.flatten(2).transpose(1, 2).expand(len(affine), -1, -1)
        if spline is not None:
            points = thin_plate_spline(TPS_KNOTS.to(spline), spline)(points)
        moved = points @ affine[:, :, :2].transpose(1, 2) + affine[:, None, :, 2]
        return moved.transpose(1, 2).reshape(-1, 2, size, size)


class Regression(nn.Module):
    """Two convolutions with batch norm and ReLU, and a fully connected layer: the correlation
    (B, 225, 15, 15) to `outputs` numbers (B, outputs)."""

    def __init__(self, outputs: int) -> None:
        super().__init__()
        self.conv0 = _block(_CELLS**2, _CHANNELS[0], _KERNELS[0])
        self.conv1 = _block(*_CHANNELS, _KERNELS[1])
        side = _CELLS - sum(kernel - 1 for kernel in _KERNELS)
        self.final = nn.Linear(_CHANNELS[1] * side**2, outputs)

    def forward(self, correlation: Tensor) -> Tensor:
        features = self.conv1(self.conv0(correlation))
        numbers: Tensor = self.final(features.flatten(1))
        return numbers


def _block(inputs: int, outputs: int, kernel: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(inputs, outputs, kernel), nn.BatchNorm2d(outputs), nn.ReLU())


def load_rocco(device: torch.device | str = "cpu") -> GeometricNet:
    """The net with its weights, on the encoder of the shipped network, frozen."""
    net = GeometricNet(load_network())
    state = {key: value.float() for key, value in read_tensors(WEIGHTS, "pt")[1].items()}
    net.load_state_dict(state, strict=False)  # it lacks the encoder
    return net.eval().requires_grad_(False).to(device)


class RoccoMatcher(Matcher):
    """Matches by the affine transformation and the spline between both images, squared."""

    name = "rocco"

    def __init__(self, options: MatchingOptions, device: str = "auto") -> None:
        self.options = options
        self.device = choose_device(device)
        net = load_rocco(self.device)
        self._fingerprint = network_fingerprint(net)
        self.net: GeometricNet = for_inference(net)

    @property
    def fingerprint(self) -> str:
        return self._fingerprint

    @torch.inference_mode()
    def _match(self, image1: Image, image2: Image) -> MatchResult:
        """The map at `finest` x `finest` cells, matchable everywhere, and the matches selected."""
        cells = (self.options.finest, self.options.finest)
        squares = (network_input(image.pixels, _SQUARE, self.device) for image in (image1, image2))
        normalised = self.net.dense_map(*self.net.transformations(*squares), cells[0])
        points = to_pixels(normalised[0].movedim(0, -1), _SQUARE, self.net.config.align_corners)
        correspondence_map = CorrespondenceMap(
            map=rescale(points.cpu().numpy(), _SQUARE, image1.size).astype(np.float32),
            grid=cell_centres(cells, image2.size).astype(np.float32),
            matchability=np.ones(cells, np.float32),
            size1=image1.size,
            size2=image2.size,
        )
        return MatchResult(select_matches(correspondence_map, self.options), correspondence_map)
