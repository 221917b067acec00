"""The images below a folder by their content, and what is left out."""

import filecmp
import os
from collections import defaultdict
from collections.abc import Collection, Hashable
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import cv2
import numpy as np

from dgc_pose.errors import ImageError
from dgc_pose.files.inputs import open_regular, read_start
from dgc_pose.geometry.pixels import same_shape
from dgc_pose.images.header import UnreadableFormatError, image_format
from dgc_pose.images.image import image_size, load_image, resize

_PREVIEWS = ("@eadir", "__macosx", "thumbs", "thumbnails")  # folders that devices make
_SAME_PICTURE = 0.002  # of thumbnails: the mean square difference over the variance


@dataclass(frozen=True)
class FolderImages:
    """The images of a folder, and the files that are left out."""

    names: tuple[str, ...]  # of the images, relative to the folder, sorted
    left_out: tuple[str, ...]  # a line for each reason: how many, the first of them, and the reason


def search_images(folder: str | Path) -> FolderImages:
    """The images below a folder, whatever their names end in.

    Links are followed, hidden names are passed over, and no folder is searched twice. Raises
    OSError, with the path, if the folder cannot be read.
    """
    root = Path(folder)
    names: list[str] = []
    left_out = defaultdict[tuple[str, str], list[str]](list)  # by kind and reason
    searched: set[str] = set()
    # Links to folders come last, so that a file has the name of the folder that it lies in.
    folders, links = [root], list[Path]()
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
            left_out["folder", failure.strerror or str(failure)].append(name)
            continue
        for path in (parent / entry for entry in entries if not entry.startswith(".")):
            name = path.relative_to(root).as_posix()
            if not os.path.isdir(path):
                why = _why_not(path, name)
                (names if why is None else left_out["file", why]).append(name)
            elif path.name.lower() in _PREVIEWS:
                left_out["folder", "previews that a device made"].append(name)
            else:
                (links if path.is_symlink() else folders).append(path)
    lines = (left_out_line(kind, paths, why) for (kind, why), paths in left_out.items())
    return FolderImages(tuple(sorted(names)), tuple(lines))


def copies_of_others(root: Path, names: Collection[str]) -> set[str]:
    """The images that have the bytes of another, but the shortest name, of several the first; and
    of one name, but for its folder and ending, the smaller ones with the same picture."""
    groups = defaultdict[Hashable, list[str]](list)
    for name in names:
        groups[Path(name).stem].append(name)
        groups[os.path.getsize(root / name), hash(read_start(root / name, 2**16))].append(name)
    copies = set[str]()
    for other, name in (pair for group in groups.values() for pair in permutations(group, 2)):
        if name not in copies and _is_copy(root / name, root / other):
            copies.add(name)
    return copies


def _is_copy(path: Path, of: Path) -> bool:
    if filecmp.cmp(path, of, shallow=False):
        return (len(path.name), path) > (len(of.name), of)  # as "x (1).jpg" than "x.jpg"
    try:
        size, larger = (image_size(file) for file in (path, of))
        if size[0] >= larger[0] or not same_shape(size, larger):
            return False
        small, large = (load_image(file).pixels for file in (path, of))
    except ImageError:
        return False
    images = (cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY) for pixels in (small, resize(large, size)))
    first, second = (resize(grey, (32, 32)).astype(np.float32) for grey in images)
    return bool(np.square(first - second).mean() < _SAME_PICTURE * second.var())


def left_out_line(kind: str, names: Collection[str], why: str) -> str:
    """How many files or folders are left out, the first of them, and the reason."""
    return f"{len(names)} {kind}{'s' * (len(names) > 1)} left out (first: {min(names)}): {why}"


def _why_not(path: Path, name: str) -> str | None:
    try:
        name.encode()
    except UnicodeEncodeError:  # as HDF5 and COLMAP hold names
        return "a name that is not UTF-8"
    try:
        with open_regular(path, ImageError) as stream:
            image_format(stream)
    except OSError as failure:
        return failure.strerror or str(failure)
    except ImageError:
        return "no regular file"
    except UnreadableFormatError as error:
        return str(error)
    return None
