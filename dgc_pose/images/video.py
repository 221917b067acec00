"""The frames of a video, as photographs in a folder."""

import os
import re
from pathlib import Path

import cv2

from dgc_pose.errors import InputError
from dgc_pose.files.inputs import read_start
from dgc_pose.files.outputs import replaced_folder

_START = re.compile(rb"\0.{3}(ftyp|moov|mdat|wide|free)|RIFF.{4}AVI |\x1aE\xdf\xa3", re.DOTALL)
_ENDINGS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm")


def frames_folder(path: Path, number: int, folder: Path) -> Path:
    """`folder` with the sharpest frame of each of `number` equal parts of a video, as JPEG; any
    other path as it is. A folder of this name and of the video's time has them already.

    Raises InputError, with the path, if no frame can be read.
    """
    start = read_start(path, 12) if path.is_file() else b""
    if not start or not (_START.match(start) or path.suffix.lower() in _ENDINGS):
        return path
    time = path.stat().st_mtime
    if folder.exists() and abs(folder.stat().st_mtime - time) <= 2:  # s, as file systems round it
        return folder
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # FFmpeg would write to the terminal
    video, again = cv2.VideoCapture(str(path)), cv2.VideoCapture(str(path))
    count = sum(1 for _ in iter(lambda: video.read()[0], False))  # that of the header may be wrong
    if count == 0:
        raise InputError(path, "is a video, and no frame of it can be read")
    number = min(number, count)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with replaced_folder(folder) as new:
        for part in range(number):
            length = (part + 1) * count // number - part * count // number
            frames = (again.read()[1] for _ in range(length))
            sharpest = max(frames, key=lambda pixels: cv2.Laplacian(pixels, cv2.CV_32F).std())
            (new / f"{part:06d}.jpg").write_bytes(cv2.imencode(".jpg", sharpest)[1].tobytes())
        os.utime(new, (time, time))
    return folder
