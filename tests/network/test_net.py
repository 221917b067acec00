"""The assembled network: sizes and keys as published, images in their own shape, and the
same maps from a network made for inference."""

from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
import torch
from torch import nn

from dgc_pose.images.image import Image, load_image, resize
from dgc_pose.matchers import load_matcher
from dgc_pose.matching.correspondence_map import MATCHABILITY
from dgc_pose.network.config import preset
from dgc_pose.network.efficientnet import EfficientPyramid
from dgc_pose.network.net import DGCNet, to_normalised, to_pixels
from dgc_pose.network.weights import load_network
from dgc_pose.runtime.torch_engine import for_inference, network_input

_DECODERS = (  # parameters and dilations
    (335_618, [1, 4, 12, 16]),
    (335_618, [1, 4, 6, 8]),
    (483_074, [1, 2, 3, 4]),
    (925_826, [1] * 5),
    (595_202, [1] * 5),
)


def _count(module: torch.nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


def _published_keys(mask: bool) -> set[str]:
    """Every key of the authors' checkpoints, written out from their layout."""
    convolutions = {0: (0,), 1: (0,), 2: (0, 2), 3: (0, 2, 4), 4: (0, 2, 4)}
    keys = {
        f"pyramid.level_{level}.{index}.{kind}"
        for level, indices in convolutions.items()
        for index in indices
        for kind in ("weight", "bias")
    }
    norm = ("weight", "bias", "running_mean", "running_var", "num_batches_tracked")
    blocks = [f"reg_{k}.conv{j}" for k in range(5) for j in range(5 if k > 2 else 4)]
    if mask:
        blocks += [f"matchability_net.conv{j}" for j in range(3)]
        keys |= {"matchability_net.conv3.weight", "matchability_net.conv3.bias"}
    for block in blocks:
        keys |= {f"{block}.0.weight", f"{block}.0.bias"}
        keys |= {f"{block}.1.{kind}" for kind in norm}
    keys |= {f"reg_{k}.final.{kind}" for k in range(5) for kind in ("weight", "bias")}
    return keys


def test_parameters_and_dilations_are_the_published_ones():
    dgc, dgcm = DGCNet(preset("dgc")), DGCNet(preset("dgcm"))
    parts = dgc, dgcm, dgcm.pyramid, dgcm.matchability_net
    assert [_count(part) for part in parts] == [10_310_602, 10_407_723, 7_635_264, 97_121]
    for level, (count, dilations) in enumerate(_DECODERS):
        decoder = dgcm.get_submodule(f"reg_{level}")
        assert _count(decoder) == count
        assert [block[0].dilation[0] for block in list(decoder)[:-1]] == dilations


def test_keys_are_the_published_ones():
    for name, mask in (("dgc", False), ("dgcm", True)):
        assert set(DGCNet(preset(name)).state_dict()) == _published_keys(mask)


def test_align_corners_modes_sample_at_their_points():
    """A map made from pixels by either convention fetches exactly those pixels' features."""
    features = torch.randn(1, 4, 60, 60, generator=torch.Generator().manual_seed(0))
    pixels = torch.tensor([[3.0, 5.0], [0.0, 59.0], [17.0, 41.0]])
    for align_corners in (True, False):
        net = DGCNet(replace(preset("dgc"), align_corners=align_corners))
        place = to_normalised(pixels, (60, 60), align_corners)
        state = place.T.reshape(1, 2, 1, 3)
        warped = net.warp(features, state)[0, :, 0]
        expected = torch.stack([features[0, :, int(y), int(x)] for x, y in pixels], 1)
        torch.testing.assert_close(warped, expected, atol=1e-4, rtol=0)
        torch.testing.assert_close(to_pixels(place, (60, 60), align_corners), pixels)


def test_a_part_of_a_level_decodes_as_the_whole_does():
    """Away from the part's border, as training needs it."""
    config = preset("dgcm-lite0")
    net = DGCNet(config).eval()
    generator = torch.Generator().manual_seed(5)
    channels = config.level_channels[1]
    source, target = torch.randn(2, 1, channels, 120, 120, generator=generator)
    state = torch.rand(1, 3, 120, 120, generator=generator) - 0.5
    rows, columns = slice(20, 90), slice(30, 100)
    with torch.no_grad():
        whole = net.refine(1, net.warp(source, state), target, state, (120, 120))
        part = state[:, :, rows, columns]
        warped = net.warp(source, part)
        found = net.refine(1, warped, target[:, :, rows, columns], part, (120, 120))
    inner = slice(15, -15)
    expected = whole[:, :, rows, columns][:, :, inner, inner]
    torch.testing.assert_close(found[:, :, inner, inner], expected, atol=1e-5, rtol=1e-4)


def test_the_grid_has_the_images_shape_and_about_225_cells():
    config = preset("dgcm-lite0")
    assert config.input_size((800, 800)) == (240, 240)
    assert config.input_size((480, 640)) == config.input_size((640, 480))[::-1]
    for width in range(40, 2000, 37):
        columns, rows = (side / 16 for side in config.input_size((width, 300)))
        assert columns == int(columns) and rows == int(rows)
        if 1 / 9 <= width / 300 <= 9:
            assert 200 <= columns * rows <= 250
            assert abs(np.log(columns / rows / (width / 300))) < 0.15
    assert config.input_size((5000, 10)) == (720, 80)  # squeezed to 9:1
    assert preset("dgcm").input_size((1242, 375)) == (240, 240)


def test_a_wide_pair_is_matched_in_its_shape():
    """Two overlapping crops, 3 to 1, of smooth noise."""
    rng = np.random.default_rng(3)
    picture = np.zeros((220, 640, 3))
    for cells in (6, 20, 60):
        noise = rng.uniform(0, 255, (cells, 3 * cells, 3)).astype(np.uint8)
        picture += resize(noise, (640, 220)).astype(float) / 3
    pixels = picture.astype(np.uint8)
    pair = Image(pixels[:180, :540].copy()), Image(pixels[30:210, 60:600].copy())
    dense = load_matcher("dgcm-lite0").match(*pair).correspondence_map
    height, width = dense.matchability.shape
    assert (width, height) == preset("dgcm-lite0").input_size((540, 180))
    offset = (dense.map - dense.grid)[height // 4 : -height // 4, width // 4 : -width // 4]
    assert np.abs(np.median(offset, (0, 1)) - (60, 30)).max() < 2
    # The grid covers image 2: its outer cells end at the image's edges.
    step = dense.grid[0, 1, 0] - dense.grid[0, 0, 0]
    assert dense.grid[0, 0, 0] == pytest.approx(step / 2 - 0.5, abs=1e-3)
    assert dense.grid[0, -1, 0] == pytest.approx(539 - step / 2 + 0.5, abs=1e-2)


def test_features_of_a_rotated_image_lie_in_the_rotated_cells():
    """By 180 degrees, kernels too. With odd kernels of stride 2 they would be half a cell off."""
    torch.manual_seed(0)
    pyramid = EfficientPyramid().eval().requires_grad_(False)
    image = torch.randn(1, 3, 96, 64)
    upright = pyramid(image)
    for module in pyramid.modules():
        if isinstance(module, nn.Conv2d):
            module.weight.copy_(module.weight.flip(-1, -2))
    rotated = pyramid(image.flip(-1, -2))
    # Level 1 has an odd kernel of stride 2, as in dgcm-lite0, and is not matched between rotations.
    for level in (0, 2, 3, 4):
        expected = upright[level].flip(-1, -2)
        assert torch.allclose(rotated[level], expected, atol=1e-4 * expected.abs().max())


@pytest.fixture
def net():
    return load_network("dgcm-lite0")


def _inputs(width=240, height=240):
    """The images of the rendered pair, as the network takes them."""
    folder = resources.files("dgc_pose") / "data" / "rendered"
    images = [load_image(str(folder / f"image{number}.jpg")).pixels for number in (1, 2)]
    return [network_input(pixels, (width, height), torch.device("cpu")) for pixels in images]


@torch.inference_mode()
def _decoded(net, inputs):
    """The finest map in pixels, (H, W, 2), and its matchability, (H, W)."""
    prediction = net(*inputs)
    points = to_pixels(prediction.maps[-1][0].movedim(0, -1), (240, 240), net.config.align_corners)
    return points, prediction.logits[-1][0, 0].sigmoid()


def test_a_network_made_for_inference_is_the_same_function(net):
    """In double precision, where rounding is far below any fault."""
    fast = for_inference(net.double())
    assert nn.BatchNorm2d not in [type(module) for module in fast.modules()]
    inputs = [image.double() for image in _inputs(96, 80)]
    wanted, found = (_decoded(one, inputs) for one in (net, fast))
    assert wanted[0].dtype == torch.float64
    for own, other in zip(found, wanted, strict=True):
        torch.testing.assert_close(own, other, atol=1e-7, rtol=0)


def test_a_network_made_for_inference_gives_the_same_matches(net):
    """Up to rounding, which differs between processors."""
    (wanted, expected), (found, own) = (
        _decoded(one, _inputs()) for one in (net, for_inference(net))
    )
    matched = expected >= MATCHABILITY
    assert 0.3 < matched.float().mean() < 0.9
    assert ((own >= MATCHABILITY) != matched).float().mean() < 1e-3
    assert (found - wanted)[matched].norm(dim=-1).max() < 0.02
