"""Image 1 as a map warps it."""

import dense_scene
import numpy as np

from dgc_pose.scene import warp_image


def test_the_warp_of_the_true_map_is_image_2_and_white_outside_image_1():
    first, second = dense_scene.pictures()
    found = warp_image(first, dense_scene.points_in_image1(dense_scene.grid(80, 60)), (320, 240))
    seen = dense_scene.points_in_image1(dense_scene.grid(320, 240))
    inside = ((seen > 1) & (seen < np.array(dense_scene.SIZE) - 2)).all(-1)
    assert inside.mean() > 0.4
    difference = np.abs(found.astype(float) - second)[inside]
    assert difference.mean() < 4
    # The picture varies much more than that, so another map would show.
    assert np.abs(first.astype(float) - second)[inside].mean() > 20
    outside = warp_image(first, np.full((4, 4, 2), -50.0), (8, 6))
    assert outside.shape == (6, 8, 3) and (outside == 255).all()
