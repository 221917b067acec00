"""One still picture for each fixed camera: its only frame, or the median of its frames."""

import os
import shutil
import unicodedata
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from dgc_pose.errors import ArgumentName, DgcPoseError, InputError
from dgc_pose.images.folder import frames_folder, identical_copies, search_images, skipped_line
from dgc_pose.images.image import Image, load_image, require_matchable
from dgc_pose.rigs.steadiness import steady_frames
from dgc_pose.system.files import naming_path

_FRAMES = ArgumentName("frames")
_MOST_FRAMES = 15  # read from each camera
_CHANGE = 12.0  # grey levels; a pixel that differs more from the still picture is moving
_STAYING = 0.7  # least share of frames in which a static pixel matches the still picture
_RESERVED = ("cameras", "metadata")  # keys of the TOML files
_LEAST_SIDE = 15  # of a static part, pixels; smaller ones are masked


@dataclass(frozen=True)
class CameraFrames:
    """The frames of the cameras in a folder, by camera name."""

    frames: Mapping[str, Sequence[Path]]  # at most 15; none if no file can be read
    unreadable: Mapping[str, Sequence[str]]  # sentences on files that cannot be read
    skipped: tuple[str, ...]  # a line about entries that are no cameras


@dataclass(frozen=True)
class StillPictures:
    """A still picture of each camera, by camera name."""

    pictures: Mapping[str, Path]
    bad: Mapping[str, str]  # why a camera has no picture
    lines: tuple[str, ...]  # a sentence for each file left out


def camera_frames(folder: Path, videos: Path, others: Collection[Path] = ()) -> CameraFrames:
    """The frames of each camera. Each entry of the folder is a camera, named by `camera_name`: an
    image, a video, or a folder of frames.

    videos: folder for the frames of videos. others: files and folders that are not cameras. Raises
    InputError for fewer than two cameras, for two cameras with one name, and for the names that the
    TOML files of a rig reserve.
    """
    if not folder.is_dir():
        raise InputError(_FRAMES, f"{folder}: no such folder")
    cameras: dict[str, list[Path]] = {}
    unreadable = defaultdict[str, list[str]](list)
    skipped = []
    lines = list[str]()
    content = search_images(folder)
    images = [name for name in content.names if "/" not in name]
    not_cameras = {path.resolve() for path in others}
    for entry in sorted(path for path in folder.iterdir() if path.name[0] != "."):
        if entry.resolve() in not_cameras:
            continue
        if not _is_utf_8(entry.name):  # TOML and JSON store names as UTF-8
            lines.append(f"{entry.name!a} skipped: a name that is not UTF-8")
            continue
        found = list[Path]()
        bad = list[str]()
        if entry.name in content.bad:
            bad.append(f"{entry}: {content.bad[entry.name]}")
        elif entry.name in images:
            found.append(entry)
        else:
            found, bad = _frames(entry, videos / entry.name)
        name = camera_name(entry)
        if not found and not bad:
            skipped.append(entry.name)
            continue
        if name in _RESERVED:
            raise InputError(_FRAMES, f"{entry}: the files of a rig have no camera of this name")
        if found and cameras.get(name):
            raise InputError(_FRAMES, f"{folder}: two cameras have the name {name}")
        cameras[name] = cameras.get(name) or found[:: -(-len(found) // _MOST_FRAMES) or 1]
        unreadable[name] += bad
    why = "neither a picture, nor a video, nor a folder of pictures"
    if skipped:
        lines.append(skipped_line("file", skipped, why))
    if len(cameras) < 2:
        few = f"{folder}: {len(cameras)} cameras found, and a rig has two"
        raise InputError(_FRAMES, "; ".join([few, *lines]))
    return CameraFrames(cameras, unreadable, tuple(lines))


def _frames(entry: Path, video: Path) -> tuple[list[Path], list[str]]:
    """The frames of a camera that is a folder or a video, and sentences on files that cannot be
    read. video: folder for a video's frames."""
    try:
        folder = frames_folder(entry, _MOST_FRAMES, video)
        if not folder.is_dir():
            return [], []
        content = search_images(folder)
    except InputError as error:
        return [], [str(error)]
    except OSError as error:
        return [], [f"{entry}: {error.strerror or error}"]
    bad = [f"{folder / name}: {why}" for name, why in content.bad.items()]
    return [folder / name for name in content.names], bad


def _is_utf_8(name: str) -> bool:
    with suppress(UnicodeEncodeError):
        name.encode()
        return True
    return False


def camera_name(entry: Path) -> str:
    """The name of a camera: its folder's name, or its image's or video's without the ending, with
    composed characters (NFC), as a keyboard writes them."""
    return unicodedata.normalize("NFC", entry.name if entry.is_dir() else entry.stem)


def still_pictures(found: CameraFrames, folder: Path, masks: Path) -> StillPictures:
    """Write the `still_picture` of each camera, without the frames that cannot be read, to a
    folder, and its mask to the folder `masks`. Raises InputError if two cameras have one."""
    pictures: dict[str, Path] = {}
    bad: dict[str, str] = {}
    lines = list[str]()
    for name, frames in found.frames.items():
        images: dict[Path, Image] = {}
        reasons = [*found.unreadable.get(name, ())]
        for path in frames:
            try:
                images[path] = load_image(path)
            except DgcPoseError as error:
                reasons.append(str(error))
        try:
            if not images:
                raise InputError(reasons.pop(0))
            pictures[name], left_out = still_picture(images, name, folder, masks)
            reasons += left_out
        except DgcPoseError as error:
            bad[name] = str(error)
        lines += reasons
    copies = identical_copies(folder, [picture.name for picture in pictures.values()])
    for name, picture in pictures.items():
        if picture.name in copies:
            copied = f"{found.frames[name][0]} is the picture of another camera"
            raise InputError(_FRAMES, copied)
    return StillPictures(pictures, bad, tuple(lines))


def still_picture(
    frames: Mapping[Path, Image], name: str, folder: Path, masks: Path
) -> tuple[Path, list[str]]:
    """Write the still picture of a camera to a folder, as `name` with an ending. Returns its path,
    and sentences on frames that are left out.

    A single upright frame is copied. Otherwise the picture is the upright median of the
    `steady_frames`, with the mask `name`.png.png in the folder `masks`, black where things move.
    Raises InputError for frames of several sizes, if the camera has no position in most frames, and
    if all of the picture moves; ImageError if nothing in it can be matched.
    """
    first, *_ = frames
    if len({image.size for image in frames.values()}) > 1:
        raise InputError(f"{first.parent}: frames of several sizes")
    if len(frames) == 1 and frames[first].exif.orientation == 1:
        require_matchable(frames[first])
        return Path(shutil.copy2(first, folder / f"{name}{first.suffix}")), []
    frames, line = steady_frames(frames)
    stack = np.stack([image.pixels for image in frames.values()])
    still = np.median(stack, axis=0).astype(np.uint8)
    grey, *others = (cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY) for pixels in (still, *stack))
    offsets = [cv2.blur(other.astype(np.float32) - grey, (5, 5)) for other in others]
    moves = [np.abs(offset - np.median(offset)) > _CHANGE for offset in offsets]
    stays = np.where(np.mean(moves, axis=0) <= 1 - _STAYING, 255, 0).astype(np.uint8)
    for image in frames.values():
        if image.mask is not None:  # alpha 0
            stays[~image.mask] = 0
    mask = cv2.morphologyEx(stays, cv2.MORPH_OPEN, np.ones((_LEAST_SIDE, _LEAST_SIDE)))
    if not mask.any():
        raise InputError(f"{first.parent}: everything moves between the {len(frames)} frames")
    require_matchable(Image(still, str(first), mask=mask > 0))
    newest = max(path.stat().st_mtime_ns for path in frames)
    path = folder / f"{name}.png"
    for file, pixels in ((path, still[:, :, ::-1]), (masks / f"{name}.png.png", mask)):
        with naming_path(file):
            file.write_bytes(cv2.imencode(".png", pixels)[1].tobytes())
            os.utime(file, ns=(newest, newest))  # --resume compares times
    return path, [line] if line else []
