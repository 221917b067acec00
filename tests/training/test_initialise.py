"""ImageNet's VGG-16 as an encoder: its features, and what is refused."""

import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from dgc_pose.errors import WeightsError
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.training.run import initialise_encoder


def _torchvision_vgg16(seed: int) -> nn.Sequential:
    """The convolutions of torchvision's `vgg16().features`, "D" in its list of configurations."""
    torch.manual_seed(seed)
    layers: list[nn.Module] = []
    inputs = 3
    for width, count in ((64, 2), (128, 2), (256, 3), (512, 3), (512, 3)):
        for _ in range(count):
            layers += [nn.Conv2d(inputs, width, kernel_size=3, padding=1), nn.ReLU()]
            inputs = width
        layers.append(nn.MaxPool2d(kernel_size=2, stride=2))
    return nn.Sequential(*layers)


def _vgg16_state(seed: int = 4) -> dict[str, Tensor]:
    """As torchvision's file has it, a layer of the classifier included."""
    state = _torchvision_vgg16(seed).state_dict(prefix="features.")
    return {**state, "classifier.6.bias": torch.zeros(1000)}


@pytest.mark.parametrize("ending", ["pth", "safetensors"])
def test_an_encoder_of_torchvision_has_its_features(tmp_path, ending):
    path = tmp_path / f"vgg16.{ending}"
    if ending == "pth":
        torch.save(_vgg16_state(), path)
    else:
        save_file(_vgg16_state(), path)
    image = torch.randn(1, 3, 48, 64)
    net = DGCNet(preset("dgcm"))
    initialise_encoder(path, net)
    layers, ends = _torchvision_vgg16(4), (2, 5, 10, 17, 24)
    with torch.no_grad():
        for end, features in zip(ends, net.pyramid(image), strict=True):
            torch.testing.assert_close(features, layers[:end](image))


def test_weights_of_another_encoder_are_refused(tmp_path):
    path = tmp_path / "encoder.pth"
    wider = {**_vgg16_state(), "features.2.weight": torch.zeros(64, 32, 3, 3)}
    integral = {**_vgg16_state(), "features.2.weight": torch.zeros(64, 64, 3, 3, dtype=torch.int8)}
    for state, words in (
        ({"conv.weight": torch.zeros(1)}, "lacks features.0.weight"),
        (wider, "has features.2.weight .64, 32, 3, 3. instead of .64, 64, 3, 3."),
        (integral, "has features.2.weight of int8"),
    ):
        torch.save(state, path)
        vgg = r"encoder\.pth: not weights of VGG-16 in torchvision's layout: it "
        with pytest.raises(WeightsError, match=vgg + words):
            initialise_encoder(path, DGCNet(preset("dgcm")))
