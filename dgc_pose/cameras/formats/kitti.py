"""KITTI's calibrations: calib.txt of odometry and objects, calib_cam_to_cam.txt of raw drives.

The projections P are of the rectified images, which KITTI's folders hold, in OpenCV's pixels.
"""

import re
from pathlib import Path

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.formats.file_cameras import FileCameras, Size, rig
from dgc_pose.cameras.formats.lens import require_read
from dgc_pose.errors import InputError

_PROJECTION = re.compile(r"P(?:_rect_)?(\d+):\s*(.*)")
_SIZE = re.compile(r"S_rect_(\d+):\s*(\S+)\s+(\S+)")
_OTHERS = re.compile(r"(?!(?:P\d+|[SKD]_\d+|corner_dist):)(\w+):(.*)")  # S, K, D: unrectified


def is_kitti(text: str) -> bool:
    """Whether a text is a calibration of KITTI's."""
    return any(_PROJECTION.fullmatch(line.strip()) for line in text.splitlines())


def read_kitti(text: str, path: Path) -> FileCameras:
    """The cameras "image_0", "image_1", ... of a text of KITTI's; the first is that of images that
    lie below no folder of such a name.

    Raises InputError, with the path and line, and as `require_read` does.
    """
    others = filter(None, map(_OTHERS.match, text.splitlines()))
    require_read({match[1]: match[2] for match in others})
    cameras: dict[int, Camera] = {}
    sizes: dict[int, Size] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        try:
            if match := _PROJECTION.fullmatch(line.strip()):
                P = np.array(match[2].split(), dtype=np.float64).reshape(3, 4)
                cameras[int(match[1])] = Camera(P[:, :3], sizes.get(int(match[1])))
            elif match := _SIZE.fullmatch(line.strip()):
                sizes[int(match[1])] = int(float(match[2])), int(float(match[3]))
        except (ValueError, OverflowError) as error:
            raise InputError(f"{path}:{number}: not a 3x4 projection ({error})") from None
    return rig({f"image_{number}": camera for number, camera in cameras.items()}, path, {})
