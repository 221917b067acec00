import numpy as np
import pytest

from dgc_pose.geometry.pixels import pixel_grid, rescale


@pytest.mark.parametrize(
    ("point", "size", "other", "expected"),
    [
        ((-0.5, -0.5), (640, 480), (240, 200), (-0.5, -0.5)),  # the outer edges stay
        ((639.5, 479.5), (640, 480), (240, 200), (239.5, 199.5)),
        ((0, 0), (240, 240), (1600, 1200), (0.5 * 1600 / 240 - 0.5, 0.5 * 1200 / 240 - 0.5)),
    ],
)
def test_the_outer_edges_of_a_resized_image_stay(point, size, other, expected) -> None:
    assert rescale(np.array(point), size, other) == pytest.approx(expected)


def test_cell_centres_are_means_of_their_pixels() -> None:
    pixels = pixel_grid((12, 8))
    means = pixels.reshape(4, 2, 4, 3, 2).mean((1, 3))
    assert rescale(pixel_grid((4, 4)), (4, 4), (12, 8)) == pytest.approx(means)
