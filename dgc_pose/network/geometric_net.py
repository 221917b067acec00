"""CNNGeometric (Rocco, Arandjelovic and Sivic, CVPR 2017): transformations by regression."""

from torch import Tensor, nn

from dgc_pose.network.config import COARSEST, INPUT_SIZE, LEVEL_SIZES, NetworkConfig
from dgc_pose.network.coordinates import identity_map
from dgc_pose.network.correlation import global_correlation, l2_normalise
from dgc_pose.network.correspondence_net import CorrespondenceNet, Prediction
from dgc_pose.network.spline import TPS_KNOTS, thin_plate_spline

_CELLS = LEVEL_SIZES[COARSEST]
_KERNELS = (7, 5)  # of the two convolutions, without padding
_CHANNELS = (48, 64)  # the paper's are 128 and 64; with fewer both regressions fit into 3 MB
_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)  # an affine transformation (2, 3), row by row


class GeometricNet(CorrespondenceNet):
    """Two regressions, one after the other: affine, then a thin-plate spline on a 3x3 grid.

    Each reads the correlation of the coarsest features of both images. The spline is of the source
    warped by the affine transformation. Both images are squared to 240x240.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        self.affine = Regression(len(_IDENTITY))
        self.spline = Regression(TPS_KNOTS.numel())

    def features(self, image: Tensor) -> list[Tensor]:
        """Features of levels 0 to 4 of a normalised image (B, 3, 240, 240), and the image, which
        the affine transformation is to warp."""
        return [*self.encode(image), image]

    def decode(
        self, source: list[Tensor], target: list[Tensor], finest: int = INPUT_SIZE
    ) -> Prediction:
        """The transformation on the grid of each level; it is the same at all of them."""
        affine = self.estimate_affine(source[COARSEST], target[COARSEST])
        warped = self.warped_features(source[-1], affine)
        spline = self.estimate_spline(warped, target[COARSEST])
        sizes = LEVEL_SIZES[LEVEL_SIZES.index(finest) :][::-1]
        return Prediction(tuple(self.dense_map(affine, spline, size) for size in sizes), ())

    def estimate_affine(self, source: Tensor, target: Tensor) -> Tensor:
        """Affine transformations (B, 2, 3), target to source in normalised coordinates.

        source, target: (B, C, 15, 15), the coarsest features of both images.
        """
        change = self._regress(self.affine, source, target)
        return (change + change.new_tensor(_IDENTITY)).view(-1, 2, 3)

    def estimate_spline(self, warped: Tensor, target: Tensor) -> Tensor:
        """The points (B, 9, 2) that TPS_KNOTS of the target map to in the warped source.

        warped: (B, C, 15, 15), the coarsest features of the source warped by the affine map.
        """
        change = self._regress(self.spline, warped, target)
        return change.view(-1, *TPS_KNOTS.shape) + TPS_KNOTS.to(change)

    def warped_features(self, image: Tensor, affine: Tensor) -> Tensor:
        """The coarsest features of a normalised source (B, 3, 240, 240), warped by the affine
        transformations (B, 2, 3)."""
        return self.coarsest(self.warp(image, self.dense_map(affine, None, INPUT_SIZE)))

    def coarsest(self, image: Tensor) -> Tensor:
        """The coarsest features (B, C, 15, 15) of normalised images, alone."""
        with self._precision(image):
            return self.pyramid.coarsest(image).to(image.dtype)

    def _regress(self, regression: nn.Module, source: Tensor, target: Tensor) -> Tensor:
        correlation = self.correlate(source, target)
        with self._precision(correlation):
            numbers = regression(correlation)
        return numbers.to(correlation.dtype)

    def correlate(self, source: Tensor, target: Tensor) -> Tensor:
        """The correlation (B, 225, 15, 15) that a regression reads: without its negative values,
        of unit length over the source's cells."""
        if self.config.normalise_features:
            source, target = l2_normalise(source), l2_normalise(target)
        return l2_normalise(global_correlation(source, target).relu())

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
    (B, 225, 15, 15) to `outputs` numbers (B, outputs), all 0 before training."""

    def __init__(self, outputs: int) -> None:
        super().__init__()
        self.conv0 = _block(_CELLS**2, _CHANNELS[0], _KERNELS[0])
        self.conv1 = _block(*_CHANNELS, _KERNELS[1])
        side = _CELLS - sum(kernel - 1 for kernel in _KERNELS)
        self.final = nn.Linear(_CHANNELS[1] * side**2, outputs)
        nn.init.zeros_(self.final.weight)
        nn.init.zeros_(self.final.bias)

    def forward(self, correlation: Tensor) -> Tensor:
        features = self.conv1(self.conv0(correlation))
        numbers: Tensor = self.final(features.flatten(1))
        return numbers


def _block(inputs: int, outputs: int, kernel: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(inputs, outputs, kernel), nn.BatchNorm2d(outputs), nn.ReLU())
