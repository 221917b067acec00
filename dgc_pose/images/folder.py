"""The images below a folder, by content; the skipped files; and the frames of a video."""

import os
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from dgc_pose.errors import ImageError, InputError
from dgc_pose.images.decoding import UnreadableFormatError, image_format
from dgc_pose.system.files import open_file, replaced_folder

_PREVIEWS = ("@eadir", "__macosx", "thumbs", "thumbnails")  # folders that devices create
_VIDEOS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm")
# A file with such a name that cannot be read is a lost picture, not a file of another kind.
_PICTURES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".bmp")


@dataclass(frozen=True)
class FolderImages:
    """The images of a folder, and the skipped files."""

    names: tuple[str, ...]  # of the images, relative to the folder, sorted
    skipped: tuple[str, ...]  # skipped files, one line for each reason, see `skipped_line`
    bad: Mapping[str, str]  # by name, why a file with the name of a picture cannot be read


def search_images(folder: str | Path) -> FolderImages:
    """Find the images below a folder, by content and not by name.

    Follows links, skips hidden names, and searches no folder twice. Raises OSError, with the path,
    if the folder cannot be read.
    """
    root = Path(folder)
    names: list[str] = []
    bad: dict[str, str] = {}
    skipped = defaultdict[tuple[str, str], list[str]](list)  # by kind and reason
    searched: set[str] = set()

    # Links to folders come last, so that a file is named by the folder that contains it.
    folders = [root]
    links = list[Path]()
    while folders or links:
        parent = folders.pop() if folders else links.pop(0)
        resolved = os.path.realpath(parent)
        if resolved in searched:
            continue
        searched.add(resolved)

        try:
            entries = sorted(os.listdir(parent))
        except OSError as failure:
            if parent == root:
                raise
            name = parent.relative_to(root).as_posix()
            skipped["folder", failure.strerror or str(failure)].append(name)
            continue

        for path in (parent / entry for entry in entries if not entry.startswith(".")):
            name = path.relative_to(root).as_posix()
            if not os.path.isdir(path):
                kind, why = _judged(path, name)
                if kind == "image":
                    names.append(name)
                elif kind == "bad":
                    bad[name] = why
                else:
                    skipped["file", why].append(name)
            elif path.name.lower() in _PREVIEWS:
                skipped["folder", "previews that a device made"].append(name)
            else:
                (links if path.is_symlink() else folders).append(path)

    lines = (skipped_line(kind, paths, why) for (kind, why), paths in skipped.items())
    return FolderImages(tuple(sorted(names)), tuple(lines), dict(sorted(bad.items())))


def identical_copies(root: Path, names: Collection[str]) -> set[str]:
    """The images with the same bytes as another one. In each group of equal files, the file with
    the shortest name, then the first, is not a copy: "x.jpg" beside "x (1).jpg"."""
    by_size = defaultdict[int, list[str]](list)
    for name in names:
        by_size[os.path.getsize(root / name)].append(name)
    by_content = defaultdict[bytes, list[Path]](list)
    for name in (name for group in by_size.values() if len(group) > 1 for name in group):
        by_content[sha256((root / name).read_bytes()).digest()].append(Path(name))
    copies = set[str]()
    for paths in by_content.values():
        paths.sort(key=lambda path: (len(path.name), path))
        copies.update(path.as_posix() for path in paths[1:])
    return copies


def skipped_line(kind: str, names: Collection[str], why: str) -> str:
    """State how many files or folders are skipped, the first of them, and the reason."""
    return f"{len(names)} {kind}{'s' * (len(names) > 1)} skipped (first: {min(names)}): {why}"


def _judged(path: Path, name: str) -> tuple[Literal["image", "bad", "skipped"], str]:
    """Whether a file is an image, a picture that cannot be read, or skipped; and the reason."""
    is_picture = path.suffix.lower() in _PICTURES
    try:
        name.encode()
        with open_file(path, ImageError) as stream:
            image_format(stream)
    except UnicodeEncodeError:  # HDF5 and COLMAP store names as UTF-8
        return "skipped", "a name that is not UTF-8"
    except OSError as failure:
        return "bad" if is_picture else "skipped", failure.strerror or str(failure)
    except ImageError:
        return "skipped", "not a regular file"
    except UnreadableFormatError as error:
        return "bad" if is_picture else "skipped", str(error)
    return "image", ""


def frames_folder(path: Path, number: int, folder: Path) -> Path:
    """Write the sharpest frame of each of `number` equal parts of a video to `folder` as JPEG, and
    return `folder`. Return `path` if it is not a video.

    A `folder` with the modification time of the video is not written again. Raises InputError, with
    the path, if no frame can be read.
    """
    if path.suffix.lower() not in _VIDEOS or not path.is_file():
        return path
    time = path.stat().st_mtime
    if folder.exists() and abs(folder.stat().st_mtime - time) <= 2:  # s: file systems round it
        return folder
    # The number of frames in the header may be wrong, and the frames do not fit into memory.
    sharpness = [cv2.Laplacian(pixels, cv2.CV_32F).std() for pixels in _frames(path)]
    if not sharpness:
        raise InputError(path, "is not a video that can be read")
    bounds = [len(sharpness) * part // number for part in range(number + 1)]
    parts = (range(*part) for part in pairwise(bounds))
    chosen = [max(part, key=sharpness.__getitem__) for part in parts if part]
    folder.parent.mkdir(parents=True, exist_ok=True)
    with replaced_folder(folder) as new:
        for frame, pixels in enumerate(_frames(path)):
            if frame in chosen:
                file = new / f"{chosen.index(frame):06d}.jpg"
                file.write_bytes(cv2.imencode(".jpg", pixels)[1].tobytes())
        os.utime(new, (time, time))
    return folder


def _frames(path: Path) -> Iterator[np.ndarray]:
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # FFmpeg would write to the terminal
    video = cv2.VideoCapture(str(path))
    while (frame := video.read())[0]:
        yield frame[1]
