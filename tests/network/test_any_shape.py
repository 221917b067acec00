"""Images in their own shape: grids that follow it, and maps that a squared image would give."""

import numpy as np
import pytest

from dgc_pose.images.image import Image, resize
from dgc_pose.matchers import load_matcher
from dgc_pose.network.config import preset


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
