"""Images in their own shape: grids that follow it, and maps that a squared image would give."""

import numpy as np
import pytest
import torch

from dgc_pose.images.image import Image, resize
from dgc_pose.matching.dense import load_dense_matcher
from dgc_pose.network.config import preset
from dgc_pose.network.correlation import cell_correlation, consensus, global_correlation, peaks
from dgc_pose.network.net import DGCNet


def test_the_grid_has_the_images_shape_and_about_225_cells():
    config = preset("dgcm-lite0")
    assert config.input_size((800, 800)) == (240, 240)
    assert config.input_size((1242, 375)) == (432, 128)
    assert config.input_size((480, 640)) == config.input_size((640, 480))[::-1]
    for width in range(40, 2000, 37):
        columns, rows = (side / 16 for side in config.input_size((width, 300)))
        assert columns == int(columns) and rows == int(rows)
        if 1 / 9 <= width / 300 <= 9:
            assert 200 <= columns * rows <= 250
            assert abs(np.log(columns / rows / (width / 300))) < 0.15
    assert config.input_size((5000, 10)) == (720, 80)  # squeezed to 9:1


@pytest.mark.parametrize("name", ["dgc", "dgcm", "dgcm+local-correlation"])
def test_networks_tied_to_225_channels_square_their_images(name):
    config = preset(name)
    assert not config.any_shape
    assert config.input_size((1242, 375)) == (240, 240)


def test_correlation_of_two_shapes_against_loops():
    generator = torch.Generator().manual_seed(5)
    source = torch.randn(1, 3, 2, 4, generator=generator, dtype=torch.float64)
    target = torch.randn(1, 3, 4, 6, generator=generator, dtype=torch.float64)
    found = global_correlation(source, target)
    assert found.shape == (1, 8, 4, 6)
    by_cells = cell_correlation(source, target, side=2)
    assert by_cells.shape == (1, 2, 2, 3)
    for xs in range(4):
        for ys in range(2):
            expected = (source[0, :, ys, xs, None, None] * target[0]).sum(0)
            torch.testing.assert_close(found[0, xs * 2 + ys], expected)
    for cell in range(2):
        columns = [found[0, xs * 2 + ys] for xs in (2 * cell, 2 * cell + 1) for ys in (0, 1)]
        best = torch.stack(columns).amax(0)
        for row in range(2):
            for column in range(3):
                mean = best[2 * row : 2 * row + 2, 2 * column : 2 * column + 2].mean()
                torch.testing.assert_close(by_cells[0, cell, row, column], mean)


def test_consensus_of_two_shapes_follows_a_shift():
    """Every target cell (x, y) has its match at (x + 2, y + 1), but one that is misled."""
    rows, columns = 6, 9
    scores = torch.full((1, rows * columns, 4, 5), -8.0)
    for y in range(4):
        for x in range(5):
            scores[0, (x + 2) * rows + y + 1, y, x] = 0.0
    scores[0, 4 * rows + 3, 2, 2] = -2.0
    scores[0, 0, 2, 2] = 0.0
    for passes, expected in ((0, (0.0, 0.0)), (3, (4.0, 3.0))):
        belief = consensus(scores, passes, (rows, columns)) if passes else scores
        points, _ = peaks(belief, (rows, columns), window=0)
        assert points[0, :, 2, 2].tolist() == list(expected)
    assert points[0, :, 0, 4].tolist() == [6.0, 1.0]


def test_corrections_are_in_cells_of_the_source():
    """A decoder that gives (1, 1) moves each point by a source cell along both axes."""
    net = DGCNet(preset("dgcm-lite0")).eval()
    for parameter in net.reg_2.parameters():
        torch.nn.init.zeros_(parameter)
    net.reg_2.final.bias.data[:2] = 1.0
    warped = target = torch.zeros(1, 64, 12, 20)
    previous = torch.zeros(1, 3, 12, 20)
    with torch.no_grad():
        moved = net.refine(2, warped, target, previous, grid=(8, 40))
    torch.testing.assert_close(moved[0, :, 5, 5], torch.tensor([2 / 40, 2 / 8, 0.0]))


@pytest.fixture(scope="module")
def wide_pair() -> tuple[Image, Image]:
    """Two overlapping crops, 3 to 1, of smooth noise."""
    rng = np.random.default_rng(3)
    picture = np.zeros((220, 640, 3))
    for cells in (6, 20, 60):
        noise = rng.uniform(0, 255, (cells, 3 * cells, 3)).astype(np.uint8)
        picture += resize(noise, (640, 220)).astype(float) / 3
    pixels = picture.astype(np.uint8)
    return Image(pixels[:180, :540].copy()), Image(pixels[30:210, 60:600].copy())


def test_a_wide_pair_is_matched_in_its_shape(wide_pair):
    found = load_dense_matcher("dgcm-lite0").match(*wide_pair).correspondence_map
    height, width = found.matchability.shape
    assert (width, height) == preset("dgcm-lite0").input_size((540, 180))
    offset = (found.map - found.grid)[height // 4 : -height // 4, width // 4 : -width // 4]
    assert np.abs(np.median(offset, (0, 1)) - (60, 30)).max() < 2
    # The grid covers image 2: its outer cells end at the image's edges.
    step = found.grid[0, 1, 0] - found.grid[0, 0, 0]
    assert found.grid[0, 0, 0] == pytest.approx(step / 2 - 0.5, abs=1e-3)
    assert found.grid[0, -1, 0] == pytest.approx(539 - step / 2 + 0.5, abs=1e-2)


def test_a_batch_of_several_shapes_gives_each_pair_its_own_map(wide_pair):
    matcher = load_dense_matcher("dgcm-lite0")
    upright = tuple(Image(np.ascontiguousarray(np.rot90(image.pixels))) for image in wide_pair)
    pairs = [wide_pair, upright, wide_pair[::-1]]
    for pair, found in zip(pairs, matcher.correspondence_maps(pairs), strict=True):
        alone = matcher.match(*pair).correspondence_map
        np.testing.assert_allclose(found.map, alone.map, atol=0.05)
        assert found.size1 == pair[0].size
