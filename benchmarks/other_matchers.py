"""Matchers to compare the network with: dense optical flow, and maps, flows and matches computed by
another program, one file for each pair.

A stored flow or map is defined on the pixels of image 2 and points into image 1. A map may have any
size W x H; it holds for both images resized to W x H. docs/paper.md describes the formats.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from dgc_pose.cameras.pair_list import Pair
from dgc_pose.errors import InputError, reason
from dgc_pose.geometry.pixels import pixel_grid, rescale
from dgc_pose.geometry.sampling import bilinear
from dgc_pose.images.image import Image, resize
from dgc_pose.matches import Matches
from dgc_pose.matching.correspondence_map import CorrespondenceMap, MatchingOptions, select_matches
from dgc_pose.matching.matcher import Matcher, MatchResult
from dgc_pose.system.arrays import ARRAY_BYTES, read_array, read_arrays
from dgc_pose.system.files import read_as, read_bytes

FLOW = "dis"  # name of the method
LONGEST_SIDE = 640  # pixels; the flow of larger images is computed at this size
_LEAST_SIDE = 16  # pixels


class FlowMatcher(Matcher):
    """Dense inverse search (Kroeger et al., ECCV 2016; OpenCV's DIS) from image 2 to image 1."""

    name = FLOW

    def __init__(self, options: MatchingOptions | None = None) -> None:
        self.options = options or MatchingOptions()

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        """The map over the pixels of image 2, or of its shrunk copy, and the matches selected.

        Both images are resized to one size. Matchability is 1 where the forward and the backward
        flow agree (see `agreement`), and 0 elsewhere.
        """
        share = min(1.0, LONGEST_SIDE / max(image2.size))
        width, height = (max(round(share * side), _LEAST_SIDE) for side in image2.size)
        grey1, grey2 = (
            cv2.cvtColor(resize(image.pixels, (width, height)), cv2.COLOR_RGB2GRAY)
            for image in (image1, image2)
        )
        dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        forward, backward = (
            dis.calc(*greys, np.zeros((height, width, 2), np.float32))
            for greys in ((grey2, grey1), (grey1, grey2))
        )
        correspondence_map = scaled_map(
            pixel_grid((width, height)) + forward,
            agreement(forward, backward),
            image1.size,
            image2.size,
        ).masked(image1, image2)
        return MatchResult(select_matches(correspondence_map, self.options), correspondence_map)


def agreement(forward: np.ndarray, backward: np.ndarray) -> np.ndarray:
    """Whether a flow (H, W, 2) and the backward flow at its end points cancel: (H, W) float32.

    1 if |f + b|^2 < 0.01 (|f|^2 + |b|^2) + 0.5, in pixels (Sundaram et al. 2010, equation 5), and
    the flow stays in the image; else 0.
    """
    height, width = forward.shape[:2]
    ends = (pixel_grid((width, height)) + forward).astype(np.float32)
    returned = bilinear(backward.astype(np.float32), ends)
    error = ((forward + returned) ** 2).sum(-1)
    agrees = error < 0.01 * ((forward**2).sum(-1) + (returned**2).sum(-1)) + 0.5
    inside = ((ends >= -0.5) & (ends <= np.array([width, height]) - 0.5)).all(-1)
    return (agrees & inside).astype(np.float32)


def scaled_map(
    points1: np.ndarray, matchability: np.ndarray, size1: tuple[int, int], size2: tuple[int, int]
) -> CorrespondenceMap:
    """Convert a map between images resized to W x H to a map between images of sizes 1 and 2.

    points1: (H, W, 2) pixels of image 1 at W x H, one for each pixel of image 2 at W x H.
    """
    size = (points1.shape[1], points1.shape[0])
    return CorrespondenceMap(
        map=rescale(points1, size, size1).astype(np.float32),
        grid=rescale(pixel_grid(size), size, size2).astype(np.float32),
        matchability=np.asarray(matchability, dtype=np.float32),
        size1=size1,
        size2=size2,
    )


Names = tuple[str, str]  # `Image.name`s of a pair

_ENDINGS = (".flo", ".npz", ".npy")
_FLO_MAGIC = 202021.25
_FLO_UNKNOWN = 1e9
_ERROR_PX = 1.0  # default of error_px of stored points, pixels of the images as stored


def pair_files(folder: Path, pairs: Sequence[Pair]) -> dict[Names, Path]:
    """The file of each pair of a list, by the paths of its images: `a-1.png_a-2.png.flo` for
    `a/1.png a/2.png`. Raises InputError, with the path, if a pair has no file or several.
    """
    files = {}
    for pair in pairs:
        stem = f"{pair.name1}_{pair.name2}".replace("/", "-")
        paths = [path for end in _ENDINGS if (path := folder / f"{stem}{end}").is_file()]
        if len(paths) != 1:
            raise InputError(
                f"{folder / stem}: {len(paths) or 'no'} files with the ending "
                f"{', '.join(_ENDINGS)}; expected one for each pair of the list"
            )
        files[str(pair.path1), str(pair.path2)] = paths[0]
    return files


class FileMatcher(Matcher):
    """Reads the matches from another program's files (see `pair_files`)."""

    def __init__(self, name: str, files: Mapping[Names, Path], options: MatchingOptions) -> None:
        self.name = name
        self.files = files
        self.options = options

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        """The stored map and the matches selected from it, or the stored points and no map, in
        pixels of the images.

        Raises InputError, with the path, if the file is malformed.
        """
        path = self.files[image1.name, image2.name]
        with read_as("a map, a flow or matches", path):
            if path.suffix == ".npz":
                arrays = read_arrays(path)
            else:
                arrays = {"flow": read_array(path) if path.suffix == ".npy" else _read_flo(path)}
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # values may overflow
                if "flow" in arrays or "map" in arrays:
                    stored = _map(arrays, image1, image2)
                    return MatchResult(select_matches(stored, self.options), stored)
                return MatchResult(_points(arrays, image1, image2), None)
        except (InputError, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"{path}: {reason(error)}") from None


def _read_flo(path: Path) -> np.ndarray:
    """Read Middlebury's flow: (H, W, 2) float64, NaN if unknown."""
    data = read_bytes(path, ARRAY_BYTES // 2)
    if np.frombuffer(data[:4], "<f4") != np.float32(_FLO_MAGIC):
        raise ValueError("a .flo begins with 202021.25")
    width, height = np.frombuffer(data[4:12], "<i4").tolist()
    flow = np.frombuffer(data[12:], "<f4").reshape(height, width, 2).astype(np.float64)
    flow[~(np.abs(flow) <= _FLO_UNKNOWN).all(-1)] = np.nan
    return flow


def _map(arrays: Mapping[str, np.ndarray], image1: Image, image2: Image) -> CorrespondenceMap:
    if "flow" in arrays:
        flow = _planes(arrays["flow"])
        points1 = pixel_grid((flow.shape[1], flow.shape[0])) + flow
    else:
        points1 = _planes(arrays["map"])
    known = np.isfinite(points1).all(-1)
    points1 = np.where(known[..., None], points1, -np.inf)
    matchability = np.asarray(
        arrays.get("matchability", np.ones(known.shape)), np.float32
    ).squeeze()
    sound = ((matchability >= 0) & (matchability <= 1)).all()
    if matchability.shape != known.shape or not sound:
        raise ValueError(f"matchability must have shape {known.shape} and lie in 0 to 1")
    matchability = np.where(known, matchability, np.float32(0))
    if "map" in arrays and "grid" in arrays:
        grid = _planes(arrays["grid"])
        if grid.shape != points1.shape:
            raise ValueError(f"map has shape {points1.shape}, grid {grid.shape}")
        stored = CorrespondenceMap(
            map=_from_stored(points1, image1).astype(np.float32),
            grid=_from_stored(grid, image2).astype(np.float32),
            matchability=matchability,
            size1=image1.size,
            size2=image2.size,
        )
    else:
        stored = scaled_map(points1, matchability, image1.size, image2.size)
    # The map is no finer than the pixels of image 2.
    shares = np.divide(known.shape[::-1], image2.size)
    return stored.thinned(max(1, *(round(share) for share in shares.tolist())))


def _points(arrays: Mapping[str, np.ndarray], image1: Image, image2: Image) -> Matches:
    if "points1" not in arrays or "points2" not in arrays:
        names = ", ".join(sorted(arrays)) or "nothing"
        raise ValueError(f"expected flow, map, or points1 and points2, found {names}")
    points1, points2 = (np.asarray(arrays[key], np.float64) for key in ("points1", "points2"))
    scale = np.sqrt(np.prod(np.divide(image1.size, image1.stored_size or image1.size)))
    return Matches(
        _from_stored(points1, image1),
        _from_stored(points2, image2),
        np.asarray(arrays.get("confidence", np.ones(len(points1)))),
        float(arrays.get("error_px", _ERROR_PX)) * float(scale),
        bool(arrays.get("key_points", False)),
    )


def _from_stored(points: np.ndarray, image: Image) -> np.ndarray:
    """Convert points from pixels of an image as stored to pixels of the image as read."""
    return rescale(points, image.stored_size or image.size, image.size)


def _planes(array: np.ndarray) -> np.ndarray:
    """Check the shape (H, W, 2); return float64."""
    if array.ndim != 3 or array.shape[-1] != 2 or array.size == 0:
        raise ValueError(f"expected the shape (H, W, 2), not {array.shape}")
    return array.astype(np.float64)
