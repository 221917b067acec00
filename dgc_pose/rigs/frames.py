"""One still picture for each fixed camera: its only frame, or the median of its frames."""

import os
import shutil
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from dgc_pose.errors import ArgumentName, DgcPoseError, InputError
from dgc_pose.images.folder import frames_folder, identical_copies, search_images, skipped_line
from dgc_pose.images.image import Image, load_image, unmatchable
from dgc_pose.system.files import naming_path

_FRAMES = ArgumentName("frames")
_MOST_FRAMES = 15  # read from each camera
_CHANGE = 12.0  # grey levels; a pixel that differs more from the still picture is moving
_STAYING = 0.7  # least share of frames in which a static pixel matches the still picture
_LEAST_SIDE = 15  # of a static part, pixels; smaller ones are masked


def camera_frames(
    folder: Path, videos: Path, others: Collection[Path] = ()
) -> tuple[dict[str, list[Path]], tuple[str, ...]]:
    """The frames of each camera, by camera name; and a line about skipped entries. Each entry of
    the folder is a camera, named by `camera_name`: an image, a video, or a folder of frames. An
    image or video that cannot be read is the only frame of its camera.

    videos: folder for the frames of videos. others: files and folders that are not cameras. Raises
    InputError for fewer than two cameras, two cameras with one name, and two with equal files.
    """
    if not folder.is_dir():
        raise InputError(_FRAMES, f"{folder}: no such folder")
    cameras: dict[str, list[Path]] = {}
    skipped = []
    content = search_images(folder)
    images = [name for name in content.names if "/" not in name]
    not_cameras = {path.resolve() for path in others}
    for entry in sorted(path for path in folder.iterdir() if path.name[0] != "."):
        if entry.resolve() in not_cameras:
            continue
        found = _frames(entry, videos / entry.name)
        found = [entry] if entry.name in (*images, *content.bad) else found
        name = camera_name(entry)
        if not found:
            skipped.append(entry.name)
        elif name in cameras:
            raise InputError(_FRAMES, f"{folder}: two cameras have the name {name}")
        else:
            cameras[name] = found[:: -(-len(found) // _MOST_FRAMES)]
    why = "neither a picture, nor a video, nor a folder of pictures"
    lines = [skipped_line("file", skipped, why)] if skipped else []
    if len(cameras) < 2:
        few = f"{folder}: {len(cameras)} cameras found, and a rig has two"
        raise InputError(_FRAMES, "; ".join([few, *lines]))
    if copies := identical_copies(folder, images):
        raise InputError(_FRAMES, f"{folder / min(copies)} is the picture of another camera")
    return cameras, tuple(lines)


def _frames(entry: Path, video: Path) -> list[Path]:
    """The frames of a camera that is a folder or a video. video: folder for a video's frames."""
    try:
        folder = frames_folder(entry, _MOST_FRAMES, video)
    except InputError:  # a video that cannot be read, nor as an image
        return [entry]
    if not folder.is_dir():
        return []
    content = search_images(folder)
    return [folder / name for name in sorted((*content.names, *content.bad))]


def camera_name(entry: Path) -> str:
    """The name of a camera: its folder's name, or its image's or video's without the ending."""
    return entry.name if entry.is_dir() else entry.stem


def still_pictures(
    cameras: Mapping[str, Sequence[Path]], folder: Path
) -> tuple[dict[str, Path], dict[str, str], tuple[str, ...]]:
    """The `still_picture` of each camera, without the frames that cannot be read; why other cameras
    have none; and a line for each frame left out. cameras: their frames, by name."""
    pictures: dict[str, Path] = {}
    bad: dict[str, str] = {}
    lines = list[str]()
    for name, frames in cameras.items():
        left = [*frames]
        while name not in pictures and name not in bad:
            try:
                pictures[name] = still_picture(left, name, folder)
            except DgcPoseError as error:
                if error.path in left and len(left) > 1:
                    left.remove(error.path)
                    lines.append(str(error))
                else:
                    bad[name] = str(error)
    return pictures, bad, tuple(lines)


def still_picture(frames: Sequence[Path], name: str, folder: Path) -> Path:
    """Write the still picture of a camera to a folder, as `name` with an ending.

    A single upright frame is copied. Otherwise the picture is the upright median of the frames,
    with the mask `name`.png.png, black where things move. Raises InputError for frames of several
    sizes and for a picture in which nothing can be matched; ImageError.
    """
    images = [load_image(path) for path in frames]
    if len({image.size for image in images}) > 1:
        raise InputError(f"{frames[0].parent}: frames of several sizes")
    stack = np.stack([image.pixels for image in images])
    still = np.median(stack, axis=0).astype(np.uint8)
    grey, *others = (cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY) for pixels in (still, *stack))
    if why := unmatchable(Image(still)):
        raise InputError(f"{frames[0]}: {why}")
    if len(frames) == 1 and images[0].exif.orientation == 1:
        return Path(shutil.copy2(frames[0], folder / f"{name}{frames[0].suffix}"))
    offsets = [cv2.blur(other.astype(np.float32) - grey, (5, 5)) for other in others]
    moves = [np.abs(offset - np.median(offset)) > _CHANGE for offset in offsets]
    stays = np.where(np.mean(moves, axis=0) <= 1 - _STAYING, 255, 0).astype(np.uint8)
    mask = cv2.morphologyEx(stays, cv2.MORPH_OPEN, np.ones((_LEAST_SIDE, _LEAST_SIDE)))
    newest = max(frame.stat().st_mtime_ns for frame in frames)
    path = folder / f"{name}.png"
    for file, pixels in ((path, still[:, :, ::-1]), (folder / f"{name}.png.png", mask)):
        with naming_path(file):
            file.write_bytes(cv2.imencode(".png", pixels)[1].tobytes())
            os.utime(file, ns=(newest, newest))  # --resume compares times
    return path
