"""KITTI's calib.txt (odometry, objects) and calib_cam_to_cam.txt (raw drives).

The projections P describe the rectified images in KITTI's folders; S, K and D do not.
"""

import re

import numpy as np

from dgc_pose.cameras.by_image import Calibration
from dgc_pose.cameras.formats.keyed import unread
from dgc_pose.cameras.formats.opened import CameraFile
from dgc_pose.cameras.formats.rigs import calibration

_PROJECTION = re.compile(r"^P(?:_rect_)?(\d+):(.*)", re.MULTILINE)
_SIZE = re.compile(r"^S_rect_(\d+):\s*(\S+)\s+(\S+)", re.MULTILINE)
_OTHERS = re.compile(r"^(?!(?:P\d+|[SKD]_\d+|corner_dist):)(\w+):(.*)", re.MULTILINE)


def read(file: CameraFile) -> Calibration | None:
    """The cameras "image_0", "image_1", ...; None for a file without a projection."""
    text = file.text
    if not _PROJECTION.search(text):
        return None
    others = dict.fromkeys(unread(dict(_OTHERS.findall(text))), "unread")
    sizes = {key: (width, height) for key, width, height in _SIZE.findall(text)}
    tables = {}
    for key, values in _PROJECTION.findall(text):
        P = np.array(values.split(), dtype=np.float64).reshape(3, 4)
        table = {"matrix": P[:, :3].tolist(), "size": sizes.get(key)}
        tables[f"image_{int(key)}"] = others | table
    return calibration(tables, file.path)
