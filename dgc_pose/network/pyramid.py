"""A feature pyramid of plain convolutions: VGG-16's first layers in the paper's presets."""

from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from dgc_pose.network.config import EfficientNet, NetworkConfig, Pool, PyramidLevel


class Pyramid(nn.Module):
    """Features of an image at 240, 120, 60, 30 and 15 cells a side (paper, section 3.1).

    batch_norm: after each convolution, in training only; folded afterwards.
    """

    def __init__(self, config: NetworkConfig, batch_norm: bool = False) -> None:
        super().__init__()
        assert not isinstance(config.pyramid, EfficientNet)
        inputs = 3
        for index, level in enumerate(config.pyramid):
            self.add_module(f"level_{index}", plain_level(level, inputs, batch_norm))
            inputs = config.level_channels[index]

    def forward(self, image: Tensor) -> list[Tensor]:
        """Features (B, C_k, S_k, S_k) of levels 0 to 4 of a normalised image (B, 3, S, S)."""
        features = []
        for level in self.children():
            image = level(image)
            features.append(image)
        return features

    def coarse(self, image: Tensor) -> list[Tensor]:
        """Features of levels 2 to 4 (strides 4, 8 and 16) of an image (B, 3, 16 h, 16 w)."""
        return self(image)[2:]


def plain_level(level: PyramidLevel, inputs: int, batch_norm: bool = False) -> nn.Sequential:
    """The layers of a level with `inputs` input channels."""
    layers: list[nn.Module] = []
    for part in level:
        if isinstance(part, Pool):
            layers.append(nn.MaxPool2d(2, 2))
            continue
        layers.append(nn.Conv2d(inputs, part.channels, 3, part.stride, padding=1))
        if batch_norm:
            layers.append(nn.BatchNorm2d(part.channels))
        layers.append(nn.ReLU())
        inputs = part.channels
    return nn.Sequential(*layers)


def fold_batch_norm(trained: Pyramid, plain: Pyramid) -> None:
    """Load a pyramid trained with batch norm into one without, which then gives the same features.

    VGG without batch norm does not learn from random weights; with it, folded afterwards, it does.
    """
    convolutions = [m for m in plain.modules() if isinstance(m, nn.Conv2d)]
    modules = [m for m in trained.modules() if isinstance(m, nn.Conv2d | nn.BatchNorm2d)]
    was_training = trained.training
    trained.eval()
    pairs = zip(modules[::2], modules[1::2], strict=True)
    for target, (convolution, norm) in zip(convolutions, pairs, strict=True):
        assert isinstance(convolution, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d)
        target.load_state_dict(fuse_conv_bn_eval(convolution, norm).state_dict())
    trained.train(was_training)
