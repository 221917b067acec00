"""The bundled demo pair: it is what its program renders, and its pose is the scene's."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from demo_scene import demo_scene
from render_demo import IMAGE_NAMES, LIST_NAME, pair_line, render_demo

import dgc_pose
from dgc_pose.synthesis.render.scene_pair import RenderedPair

SHIPPED = Path(dgc_pose.__file__).parent / "data" / "demo"


@pytest.fixture(scope="module")
def demo() -> RenderedPair:
    return render_demo()


def test_shipped_images_are_what_the_program_renders(demo):
    for name, image in zip(IMAGE_NAMES, (demo.image1, demo.image2), strict=True):
        shipped = cv2.cvtColor(cv2.imread(str(SHIPPED / name)), cv2.COLOR_BGR2RGB)
        assert shipped.shape == image.shape
        difference = np.abs(shipped.astype(int) - image)
        assert difference.mean() < 6  # JPEG of quality 90 with halved chroma, on fine texture
        # What JPEG takes away is gone after a blur; another scene is not.
        blurred = cv2.blur(shipped, (16, 16)).astype(int) - cv2.blur(image, (16, 16))
        assert np.abs(blurred).max() < 12


def test_shipped_files_are_small():
    assert sum((SHIPPED / name).stat().st_size for name in IMAGE_NAMES) < 400_000


def test_shipped_pair_list_has_the_cameras_of_the_scene(demo):
    fields = (SHIPPED / LIST_NAME).read_text().split()
    assert tuple(fields[:2]) == IMAGE_NAMES and len(fields) == 38
    numbers = np.array(fields[4:], dtype=np.float64)
    _, first, second = demo_scene()
    extrinsics = []
    for camera in (first, second):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = camera.rotation[0].numpy(), camera.translation[0].numpy()
        extrinsics.append(matrix)
    assert np.allclose(numbers[:9], first.K[0].numpy().ravel(), atol=1e-9)
    assert np.allclose(numbers[9:18], second.K[0].numpy().ravel(), atol=1e-9)
    expected = extrinsics[1] @ np.linalg.inv(extrinsics[0])
    assert np.allclose(numbers[18:], expected.ravel(), atol=1e-9)
    assert pair_line(demo).split() == fields


def test_demo_views_overlap_with_rotation_and_baseline(demo):
    angle = np.degrees(np.arccos((np.trace(demo.R) - 1) / 2))
    assert 12 < angle < 20
    assert np.linalg.norm(demo.t) > 0.15 * np.median(demo.depth1)
    assert 0.5 < demo.visible.mean() < 0.95
