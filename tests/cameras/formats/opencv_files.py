"""Files as OpenCV writes them, and its lenses."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dgc_pose.cameras.camera import Camera


def assert_lens(camera: Camera, coefficients: Any, is_fisheye: bool = False) -> None:
    """OpenCV projects the camera's rays back onto the pixels."""
    pixels = np.random.default_rng(0).uniform((100, 80), (540, 400), (30, 2))
    points, lens = camera.normalise(pixels), np.array(coefficients, np.float64)
    if is_fisheye:
        again = cv2.fisheye.distortPoints(points[:, None], camera.K, lens)
    else:
        rays = np.column_stack([points, np.ones(len(points))])
        again, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.K, lens)
    np.testing.assert_allclose(again[:, 0], pixels, atol=1e-3)


def write_storage(path: Path, **values: Any) -> str:
    """Write a cv::FileStorage; the ending tells YAML, XML or JSON."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        if isinstance(value, list):
            storage.startWriteStruct(name, cv2.FileNode_SEQ)
            for text in value:
                storage.write("", text)
            storage.endWriteStruct()
        else:
            storage.write(name, value)
    storage.release()
    return str(path)
