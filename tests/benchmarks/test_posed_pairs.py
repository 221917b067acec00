from dataclasses import replace

import dense_scene
import numpy as np
import pytest
from evaluation_pairs import posed_pairs

from dgc_pose.benchmarks.evaluate import epipolar_errors
from dgc_pose.benchmarks.posed_pairs import ListedPairs
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError


@pytest.mark.parametrize("size", [None, (256, 256)])
def test_a_size_changes_images_and_cameras_alike(tmp_path, size) -> None:
    """A point that both cameras see stays the same point of the scene: true matches stay true,
    their distances from the epipolar lines being zero after the resize as before."""
    found = dense_scene.true_map()
    shown = posed_pairs(tmp_path, 1, size).pair(0)
    truth, expected = shown.truth, size or dense_scene.SIZE
    assert truth.camera1.size == truth.camera2.size == expected
    for image in (shown.image1, shown.image2):
        assert image.size == expected
        assert (image.stored_size or image.size) == dense_scene.SIZE
    scale = np.divide(expected, dense_scene.SIZE)
    points1, points2 = ((p + 0.5) * scale - 0.5 for p in (found.map, found.grid))
    assert max(epipolar_errors(truth, points1, points2)) < 1e-3
    names = (shown.image1.name, truth.ids["image1"])
    assert names == (str(tmp_path / "one.png"), "one.png")


def test_the_K_of_another_image_is_refused(tmp_path) -> None:
    (pair,) = posed_pairs(tmp_path, 1).pairs
    far = Camera(np.array([[900.0, 0, 800], [0, 900, 600], [0, 0, 1]]))
    with pytest.raises(InputError, match=r"K of .*two_2\.png"):
        ListedPairs([replace(pair, camera2=far)]).pair(0)
