"""The source of a batch: photographs, their cameras and sizes, and their pairs. The pairs are those
of a list, all, neighbours in a sequence, or the most similar images."""

import os
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Literal, cast

import numpy as np

from dgc_pose.batch.given.matches import GivenMatches
from dgc_pose.cameras.by_image import Calibration, times
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.formats.colmap import read_database
from dgc_pose.cameras.lines import log_likelihoods
from dgc_pose.cameras.pair_list import read_pair_list
from dgc_pose.cameras.prior import by_lines
from dgc_pose.errors import ArgumentName, DgcPoseError, ImageError, InputError
from dgc_pose.geometry.pixels import exif_turn
from dgc_pose.images.decoding import Header, image_header
from dgc_pose.images.folder import identical_copies, search_images, skipped_line
from dgc_pose.images.image import load_image, mask_file, masked, size_in_file, unmatchable
from dgc_pose.system.parallel import in_threads, one_blas_thread

STORE = "batch.db"  # in the folder of a batch
# In the folder of a reconstruction
BATCH = "batch"
PAGE = "model.html"
_MOST_WITH_LINES = 16  # photographs of one camera whose lines are detected
_DATABASES = (".db", ".sqlite", ".sqlite3")
# Size in bytes and time of last change in nanoseconds, of a photograph and then of its mask.
FileState = tuple[int, ...]
_ROOT = ArgumentName("root")
Way = Literal["exhaustive", "sequential", "auto"]


@dataclass(frozen=True)
class Source:
    """Photographs, and their pairs if the source lists pairs."""

    root: Path  # folder that the names are relative to
    names: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...] | None  # None: to be chosen
    cameras: Mapping[str, Camera]  # from the source itself
    skipped: tuple[str, ...] = ()  # skipped files of a folder, a line for each reason
    masks: Path | None = None  # folder of the images' masks
    bad: Mapping[str, str] = field(default_factory=dict)  # pictures that are not in `names`, why
    given: GivenMatches | None = None  # matches to judge, instead of matching the photographs

    @property
    def has_photographs(self) -> bool:
        """Whether the photographs count. To matches alone, those in `root` are of no concern."""
        return self.given is None or self.given.with_images


def open_source(path: Path, root: Path | None = None, masks: Path | None = None) -> Source:
    """A folder of photographs, a list of pairs, or a COLMAP database.

    root: folder of the images of a list or database; by default the file's folder. A folder is
    searched without results of `batch` and `reconstruct`. masks: folder of the images' masks, see
    `mask_file`; masks that lie in the source are not photographs.

    Raises InputError if the source has fewer than two images, if none of its images is in `root`,
    or if none has a mask in `masks`; OSError if the source cannot be read.
    """
    if path.is_dir():
        if root is not None:
            raise InputError(_ROOT, f"applies to a list or a database, and {path} is a folder")
        source = _of_folder(path, masks)
    elif not path.is_file():
        raise InputError(path, "is not a folder, video, list or database")
    else:
        is_database = path.suffix.lower() in _DATABASES
        listed = read_database(path) if is_database else read_pair_list(path)
        source = Source(root or path.parent, listed.names, listed.pairs or None, listed.cameras)
    if len(source.names) < 2:
        what = "no image" if not source.names else "one image"
        lines = [f"{path}: {what}, and a pair needs two", *source.skipped]
        if source.bad:
            first, why = next(iter(source.bad.items()))
            lines.append(f"{len(source.bad)} cannot be read (first: {first}: {why})")
        raise InputError("; ".join(lines))
    _require_some(source.root, source.names, path, _ROOT)
    if masks is not None and not any(mask_file(masks, name) for name in source.names):
        missing = f"{masks}: no {source.names[0]}.png there, and no mask of another image"
        raise InputError(ArgumentName("masks"), missing)
    return replace(source, masks=masks)


def given_source(given: GivenMatches, images: Path | None = None) -> Source:
    """Matches to judge. images: folder of the photographs. Raises InputError if none is there."""
    if images is not None:
        _require_some(images, given.names, given.path, ArgumentName("images"))
        given = replace(given, with_images=True)
    root = images or (given.path if given.path.is_dir() else given.path.parent)
    return Source(root, given.names, tuple(given.places), given.cameras, given=given)


def _require_some(root: Path, names: Sequence[str], path: Path, argument: ArgumentName) -> None:
    """Raise InputError, naming the argument, if none of the images of `path` is in `root`."""
    if not any(os.path.isfile(root / name) for name in names):
        missing = f"{root}: none of the {len(names)} images of {path} is there"
        raise InputError(argument, f"{missing} (first: {names[0]})")


def _of_folder(root: Path, masks: Path | None) -> Source:
    """The photographs below a folder, without masks, copies, and results of `batch` and
    `reconstruct`."""

    def is_result(name: str) -> bool:
        folders = list((root / name).parents)[: name.count("/")]
        return any(os.path.isfile(folder / STORE) for folder in folders)

    content = search_images(root)
    results = [name for name in content.names if is_result(name)]
    files = {os.path.realpath(file) for n in content.names if (file := mask_file(masks, n))}
    others = {n for n in content.names if files and os.path.realpath(root / n) in files}
    names = [name for name in content.names if name not in others.union(results)]
    bad = {name: why for name, why in content.bad.items() if not is_result(name)}
    copies = identical_copies(root, names)
    why = {
        f"results, beside {STORE}": results,
        "copies of other photographs": copies,
    }
    lines = [skipped_line("file", found, reason) for reason, found in why.items() if found]
    kept = tuple(name for name in names if name not in copies)
    return Source(root, kept, None, {}, (*content.skipped, *lines), bad=bad)


def survey(
    source: Source, calibration: Calibration
) -> tuple[dict[str, Camera], dict[str, str], dict[str, FileState]]:
    """Three mappings by image name: the camera of the upright image, with its size; why an image is
    unusable, for example for want of a camera that fits it; and the state of its files, absent if
    they cannot be found.

    Raises InputError if no image has a camera that fits it, or if one K of unknown size is given
    for images of several sizes, both as stored and upright.
    """
    cameras: dict[str, Camera] = {}
    bad = dict(source.bad)
    states: dict[str, FileState] = {}
    headers: dict[str, Header] = {}
    failures = list[InputError]()
    for name in source.names:
        path = source.root / name
        with suppress(OSError):
            used = (path, mask_file(source.masks, name)) if source.has_photographs else ()
            if files := [file.stat() for file in used if file]:
                states[name] = tuple(n for s in files for n in (s.st_size, s.st_mtime_ns))
        try:
            header = _header(source, calibration, name)
        except (ImageError, InputError) as error:
            bad[name] = str(error)
            failures += [error] if isinstance(error, InputError) else []
            continue
        if np.linalg.det(exif_turn(header.exif.orientation)) < 0:  # no model can hold that
            bad[name] = f"{path}: its pixels as stored are a mirror image, by EXIF"
        elif why := unmatchable(header):
            bad[name] = f"{path}: {why}"
        else:
            headers[name] = header
    _require_one_size(source, calibration, headers)
    for name, header in headers.items():
        own = calibration
        listed = source.cameras.get(name)
        try:
            if listed is not None and calibration.lacks(source.root, name):
                where = "the list" if listed.size is None else "the database"
                own = Calibration(where, {name: listed})
            elif calibration.is_empty:
                own = Calibration(auto="files")
            camera = own.camera(source.root, name, header)
        except InputError as error:
            failures.append(error)
            bad[name] = str(error)
        else:
            stated = own.stated(source.root, name)
            known = source.given is None or source.given.has_size(name, stated)
            cameras[name] = replace(camera, size=header.size if known else None)
    if failures and not cameras:
        raise failures[0]
    if source.has_photographs:
        cameras = _with_lines(source, cameras)
    return cameras, bad, states


def _header(source: Source, calibration: Calibration, name: str) -> Header:
    path = source.root / name
    if source.given is None:
        return image_header(path)
    return source.given.header(path, name, calibration.stated(source.root, name))


def without_camera(source: Source, calibration: Calibration) -> list[str]:
    """The images for which neither the source nor the calibration states a camera."""
    lacking = list[str]()
    for name in source.names:
        with suppress(InputError):  # of ambiguous cameras, `survey` raises it
            if name not in source.cameras and calibration.lacks(source.root, name):
                lacking.append(name)
    return lacking


def _require_one_size(
    source: Source, calibration: Calibration, headers: Mapping[str, Header]
) -> None:
    """Raise InputError if the images of one K of unknown size have several sizes."""
    K = calibration.common
    if K is None or K.size is not None or calibration.details.size is not None:
        return
    common = [h for n, h in headers.items() if calibration.named(source.root, n) is None]
    stored = sorted({size_in_file(h) for h in common})
    upright = {h.size for h in common}
    if len(stored) > 1 and len(upright) > 1:
        first, second, *_ = map(times, stored)
        sizes = f"is a single K, and the images have several sizes ({first} and {second})"
        raise InputError(ArgumentName("K"), f"{sizes}: give a file with a K for each image")


@one_blas_thread()
def _with_lines(source: Source, cameras: Mapping[str, Camera]) -> dict[str, Camera]:
    """The cameras after the evidence of straight lines, in some photographs of each camera."""
    groups = defaultdict[str, list[str]](list)
    for name, camera in cameras.items():
        if camera.focal_prior is not None:
            groups[camera.identity or name].append(name)
    some = [n for names in groups.values() for n in names[:: -(-len(names) // _MOST_WITH_LINES)]]

    def lines(name: str) -> np.ndarray | None:
        with suppress(DgcPoseError):  # its pairs report the error
            image = load_image(source.root / name)
            return log_likelihoods(masked(image, mask_file(source.masks, name)))
        return None

    found = dict(zip(some, in_threads(lines, some), strict=True))
    with_lines = by_lines([*cameras.values()], [found.get(name) for name in cameras])
    return dict(zip(cameras, with_lines, strict=True))


@dataclass(frozen=True)
class PairChoice:
    """A way to choose pairs."""

    way: Way
    # sequential: largest distance in the sequence. auto: number of similar images for each image.
    number: int = 1

    def pairs(self, count: int) -> list[tuple[int, int]]:
        """The pairs (i, j), i < j, of `count` images; none for "auto", which needs similarities."""
        widest = {"exhaustive": count, "sequential": self.number, "auto": 0}[self.way]
        return [(i, j) for i in range(count) for j in range(i + 1, min(i + widest + 1, count))]


def parse_pair_choice(text: str) -> PairChoice:
    """Parse `exhaustive`, `sequential:W` or `auto:K`. Raises InputError for any other text."""
    if text == "exhaustive":
        return PairChoice("exhaustive")
    if match := re.fullmatch("(sequential|auto):([1-9][0-9]{0,8})", text):
        return PairChoice(cast(Way, match[1]), int(match[2]))
    allowed = f"must be exhaustive, sequential:W or auto:K, W and K from 1, not {text!r}"
    raise InputError(ArgumentName("pairs"), allowed)


@one_blas_thread()
def similarities(
    features: Sequence[np.ndarray], progress: Callable[[int, int], None] = lambda done, of: None
) -> np.ndarray:
    """Similarities (N, N) float32 of all pairs, from -1 to 1; the diagonal is 1.

    features: the coarsest features of each image, unit vectors (cells, C). progress: called with
    the number of compared pairs, and of all pairs.
    """
    cells = [feature.astype(np.float32) for feature in features]
    scores = np.eye(len(cells), dtype=np.float32)
    count = len(cells)
    for i in range(1, count):
        row = in_threads(partial(similarity, cells[i]), cells[:i])
        scores[i, :i] = scores[:i, i] = row
        progress(i * (i + 1) // 2, count * (count - 1) // 2)
    return scores


def similarity(cells1: np.ndarray, cells2: np.ndarray) -> float:
    """The similarity of two images, of unit vectors (cells, C): the largest cosine of a cell with
    the cells of the other image, averaged over the cells of both images."""
    cosines = cells1 @ cells2.T
    return float((cosines.max(0).sum() + cosines.max(1).sum()) / sum(cosines.shape))


def most_similar(scores: np.ndarray, most: int) -> list[tuple[int, int]]:
    """The pairs (i, j), i < j, of each image with its `most` most similar images. The pairs of a
    maximum spanning tree are added, so that all images are connected.

    scores: (N, N), symmetric, larger for more similar images; the diagonal is ignored.
    """
    count = len(scores)
    others = scores.astype(np.float64).copy()
    np.fill_diagonal(others, -np.inf)
    chosen = np.zeros((count, count), dtype=bool)
    nearest = np.argsort(-others, axis=1, kind="stable")[:, : min(most, count - 1)]
    chosen[np.arange(count)[:, None], nearest] = True
    for edge in _spanning_tree(others):
        chosen[edge] = True
    chosen |= chosen.T
    return [(int(i), int(j)) for i, j in zip(*np.nonzero(np.triu(chosen, 1)), strict=True)]


def _spanning_tree(scores: np.ndarray) -> Iterator[tuple[int, int]]:
    """The edges of the maximum spanning tree of scores (N, N) (Prim 1957)."""
    count = len(scores)
    outside = np.ones(count, dtype=bool)
    nearest = np.zeros(count, dtype=np.int64)
    outside[:1] = False
    best = scores[0].copy() if count else np.zeros(0)
    for _ in range(count - 1):
        node = int(np.where(outside, best, -np.inf).argmax())
        yield int(nearest[node]), node
        outside[node] = False
        closer = outside & (scores[node] > best)
        best[closer] = scores[node][closer]
        nearest[closer] = node
