"""A feature pyramid of plain convolutions: VGG-16's first layers in the paper's presets."""

from torch import Tensor, nn

from dgc_pose.network.config import NetworkConfig


class Pyramid(nn.Module):
    """Features of an image at 240, 120, 60, 30 and 15 cells a side (paper, section 3.1): 3x3
    convolutions with ReLU, and a max-pool at the end of all levels but the first."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        assert not isinstance(config.pyramid, str)
        inputs = 3
        for index, level in enumerate(config.pyramid):
            layers: list[nn.Module] = []
            for channels in level:
                layers.append(nn.Conv2d(inputs, channels, 3, padding=1))
                layers.append(nn.ReLU())
                inputs = channels
            if index > 0:
                layers.append(nn.MaxPool2d(2, 2))
            self.add_module(f"level_{index}", nn.Sequential(*layers))

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
