"""The corners of markers in drawn pictures."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from marker_scene import draw_markers, pixels_of, square, texture

from dgc_pose.errors import InputError
from dgc_pose.images.markers import find_markers, shared_markers

K = np.array([[900.0, 0, 320], [0, 900, 240], [0, 0, 1]])
POSE = np.eye(3, 4)
SIZE = (640, 480)


NAMES = ("APRILTAG_36h11:7", "APRILTAG_16h5:2", "4X4_1000:30", "6X6_1000:11", "ARUCO_ORIGINAL:99")


def test_corners_are_found_to_a_fraction_of_a_pixel_unless_a_marker_is_there_twice() -> None:
    """Each corner, of markers 60 pixels wide; in colours of 8 and in grey of 16 bit too."""
    markers = {
        name: square(60 / 900, (0.12 * place - 0.22, -0.03, 1.0), (0.3, -0.2, 0.1))
        for place, name in enumerate(NAMES)
    }
    image = draw_markers(texture(SIZE), K, POSE, markers)
    for pixels in (image, np.dstack([image] * 4), image.astype(np.uint16) * 200):
        found = find_markers(pixels)
        for name, corners in markers.items():
            assert np.abs(found[name] - pixels_of(K, POSE, corners)).max() < 0.25
    twice = draw_markers(image, K, POSE, {NAMES[2]: square(0.07, (0.0, 0.15, 1.0))})
    assert {*NAMES} - find_markers(twice).keys() == {NAMES[2]}


def test_markers_of_several_images(tmp_path: Path) -> None:
    """One must be in two of them. The error names a number that an image shows twice."""
    first, second, third = (
        draw_markers(texture(SIZE), K, POSE, {name: square(0.07, (x, 0.0, 1.0))})
        for name, x in (("4X4_1000:2", 0.0), ("4X4_1000:2", 0.1), ("4X4_1000:5", 0.0))
    )
    file = tmp_path / "third.png"
    damaged = tmp_path / "damaged.png"
    cv2.imwrite(str(file), third)
    damaged.write_bytes(b"no image")
    images = {"first": first, "file": file, "damaged": damaged, "second": second}
    found = shared_markers(images)
    assert [*found] == [*images] and found["damaged"] == {}
    assert [*found["first"]] == [*found["second"]] == ["4X4_1000:2"]
    assert [*found["file"]] == ["4X4_1000:5"]
    twice = draw_markers(first, K, POSE, {"4X4_1000:2": square(0.07, (0.0, 0.15, 1.0))})
    for images, words in (
        ({"a": first, "b": twice}, "2 images: a shows 4X4_1000:2, b 4X4_1000:2 (2 times)"),
        ({"a": texture(SIZE), "b": twice}, "2 images: b shows 4X4_1000:2 (2 times), a none"),
        ({"a": texture(SIZE), "b": damaged}, "2 images"),
    ):
        with pytest.raises(InputError) as error:
            shared_markers(images)
        assert str(error.value) == f"marker finds no marker in two of the {words}"


def test_an_image_without_markers() -> None:
    assert find_markers(np.zeros((48, 64, 3), np.uint8)) == {}
    assert find_markers(texture(SIZE)) == {}
