"""Dense maps, flows and matches that another program computed: a file for each pair.

A flow or map is defined on the pixels of image 2 and points into image 1. (For an optical flow
program image 2 is the first image.) A map of any size W x H is one over both images resized to
W x H. Formats:

- `.flo`: Middlebury's flow; components beyond 1e9 are unknown.
- `.png`: KITTI's 16-bit flow, (value - 2^15) / 64; the third channel is 0 if it is unknown.
- `.npy`: a flow (H, W, 2) or (2, H, W), x before y; NaN is unknown.
- `.npz`: `flow` as in .npy; or `map`, the points in image 1; either with `matchability` (H, W) in
  0 to 1 (or `certainty`), by default 1. With `grid` (H, W, 2), `map` and `grid` are in pixels of
  the images as stored, as `dgc-pose match` writes them. Or `points1` and `points2` (N, 2) alone, in
  pixels of the images as stored, with optional `confidence` (N,), `error_px`, and `key_points`,
  true if the matches are independent detections.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np

from dgc_pose.benchmarks.files import read_arrays
from dgc_pose.errors import ImageError, InputError, reason
from dgc_pose.files.arrays import ARRAY_BYTES, read_array
from dgc_pose.files.inputs import read_bytes
from dgc_pose.geometry.pixels import pixel_grid, rescale
from dgc_pose.images.image import Image, read_pixels
from dgc_pose.matches import Matches
from dgc_pose.matching.flow import scaled_map
from dgc_pose.matching.matcher import CorrespondenceMap, Matcher, MatchResult
from dgc_pose.matching.selection import MatchingOptions, select_matches

ENDINGS = (".flo", ".npz", ".npy", ".png")
_FLO_MAGIC = 202021.25
_FLO_UNKNOWN = 1e9
_ERROR_PX = 1.0  # of points without an error_px, pixels of the images as stored


class FileMatcher(Matcher):
    """The files of a program in a folder, by the names of the two images.

    stem: from the two `Image.name`s to the name of the pair's file without its ending.
    """

    def __init__(
        self,
        folder: str | Path,
        stem: Callable[[str, str], str],
        name: str | None = None,
        options: MatchingOptions | None = None,
    ) -> None:
        self.folder = Path(folder)
        self.stem = stem
        self.options = options or MatchingOptions()
        self.name = name or self.folder.name

    def selecting(self, options: MatchingOptions) -> FileMatcher:
        """The same files with other options of selection."""
        return FileMatcher(self.folder, self.stem, self.name, options)

    def require(self, names: Iterable[tuple[str, str]]) -> None:
        """Raise InputError, with the path, unless there is one file for each pair of image names;
        to be called before hours of work."""
        if not self.folder.is_dir():
            raise InputError(f"{self.folder}: no such folder of matches")
        for name1, name2 in names:
            self.path(name1, name2)

    def path(self, name1: str, name2: str) -> Path:
        """The file of a pair. Raises InputError if there is none, or more than one."""
        stem = self.folder / self.stem(name1, name2)
        paths = [path for end in ENDINGS if (path := Path(f"{stem}{end}")).is_file()]
        if len(paths) != 1:
            what = "no such file" if not paths else f"{len(paths)} files"
            raise InputError(
                f"{stem}: {what} with the ending {', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}; "
                "expected one for each pair of the list"
            )
        return paths[0]

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        """The stored map with the matches selected from it, or the stored points without a map; in
        pixels of the images.

        Raises InputError, with the path, if the file is missing or malformed.
        """
        path = self.path(image1.name, image2.name)
        with np.errstate(over="ignore", invalid="ignore"):  # of values out of any range
            arrays = _read(path)
            try:
                if "flow" in arrays or "map" in arrays:
                    stored = _map(arrays, image1, image2)
                    return MatchResult(select_matches(stored, self.options), stored)
                return MatchResult(_points(arrays, image1, image2), None)
            except InputError as error:
                raise InputError(f"{path}: {error}") from None
            except (TypeError, ValueError, OverflowError) as error:
                raise InputError(f"{path}: cannot be read ({reason(error)})") from None


def _read(path: Path) -> Mapping[str, np.ndarray]:
    """The arrays of a file by name, as the module's docstring has them."""
    if path.suffix == ".npz":
        return read_arrays(path)
    if path.suffix == ".npy":
        return {"flow": read_array(path)}
    return {"flow": read_flo(path) if path.suffix == ".flo" else read_kitti(path)}


def read_flo(path: Path) -> np.ndarray:
    """Middlebury's flow (H, W, 2) float64, NaN if unknown. Raises InputError, with the path, if it
    is malformed."""
    data = read_bytes(path, ARRAY_BYTES // 2)
    if len(data) < 12 or np.frombuffer(data[:4], "<f4")[0] != np.float32(_FLO_MAGIC):
        raise InputError(f"{path}: not a .flo file: it does not begin with 202021.25")
    width, height = (int(side) for side in np.frombuffer(data[4:12], "<i4"))
    if width < 1 or height < 1 or len(data) != 12 + 8 * width * height:
        raise InputError(f"{path}: {len(data)} bytes are not those of a flow of {width} x {height}")
    flow = np.frombuffer(data, "<f4", offset=12).reshape(height, width, 2).astype(np.float64)
    flow[~(np.abs(flow) <= _FLO_UNKNOWN).all(-1)] = np.nan
    return flow


def read_kitti(path: Path) -> np.ndarray:
    """KITTI's flow (H, W, 2) float64, NaN if unknown. Raises InputError, with the path, if it is
    malformed."""
    try:
        stored = read_pixels(path)
    except ImageError as error:
        raise InputError(str(error)) from None
    if stored.dtype != np.uint16 or stored.ndim != 3 or stored.shape[2] != 3:
        raise InputError(f"{path}: expected a PNG of three 16-bit channels, as KITTI stores flow")
    known, y, x = np.moveaxis(stored.astype(np.float64), -1, 0)  # OpenCV gives BGR for RGB
    flow = (np.stack([x, y], -1) - 2**15) / 64
    flow[known == 0] = np.nan
    return flow


def _map(arrays: Mapping[str, np.ndarray], image1: Image, image2: Image) -> CorrespondenceMap:
    grid = None
    if "flow" in arrays:
        flow = _planes_last(arrays["flow"], "flow")
        points1 = pixel_grid((flow.shape[1], flow.shape[0])) + flow
    else:
        points1 = _planes_last(arrays["map"], "map")
        grid = None if "grid" not in arrays else _planes_last(arrays["grid"], "grid")
    known = np.isfinite(points1).all(-1)
    points1 = np.where(known[..., None], points1, -np.inf)
    matchability = np.where(known, _matchability(arrays, known.shape), np.float32(0))
    if grid is None:
        stored = scaled_map(points1, matchability, image1.size, image2.size)
    elif grid.shape != points1.shape:
        raise InputError(f"map has shape {points1.shape}, grid {grid.shape}")
    else:
        stored = CorrespondenceMap(
            map=_from_stored(points1, image1).astype(np.float32),
            grid=_from_stored(grid, image2).astype(np.float32),
            matchability=matchability,
            size1=image1.size,
            size2=image2.size,
        )
    # No finer than the pixels of image 2.
    shares = np.divide(known.shape[::-1], image2.size)
    return stored.thinned(max(1, *(round(share) for share in shares.tolist())))


def _matchability(arrays: Mapping[str, np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    """The matchability (H, W) float32 of a map of that shape; 1 if none is stored."""
    stored = arrays.get("matchability", arrays.get("certainty"))
    if stored is None:
        return np.ones(shape, np.float32)
    matchability = np.asarray(stored, dtype=np.float32).squeeze()
    if matchability.shape != shape:
        raise InputError(f"matchability has shape {matchability.shape}, the map {shape}")
    if not ((matchability >= 0) & (matchability <= 1)).all():
        raise InputError("matchability must lie in 0 to 1")
    return matchability


def _points(arrays: Mapping[str, np.ndarray], image1: Image, image2: Image) -> Matches:
    if "points1" not in arrays or "points2" not in arrays:
        names = ", ".join(sorted(arrays)) or "nothing"
        raise InputError(f"expected flow, map, or points1 and points2, found {names}")
    points1, points2 = (np.asarray(arrays[key], np.float64) for key in ("points1", "points2"))
    if points1.ndim != 2 or points1.shape[1] != 2 or points1.shape != points2.shape:
        raise InputError(
            f"points1 and points2 must both be (N, 2), not {points1.shape} and {points2.shape}"
        )
    error = _single(arrays, "error_px", _ERROR_PX, "one number")
    key_points = _single(arrays, "key_points", False, "true or false")
    scale = np.sqrt(np.prod(np.divide(image1.size, image1.stored_size or image1.size)))
    return Matches(
        _from_stored(points1, image1),
        _from_stored(points2, image2),
        np.asarray(arrays.get("confidence", np.ones(len(points1)))),
        float(error) * float(scale),
        bool(key_points),
    )


def _single(arrays: Mapping[str, np.ndarray], name: str, default: float, what: str) -> np.ndarray:
    """The only value () of an array, or the default if it is missing. `what`: it must be."""
    value = np.asarray(arrays.get(name, default))
    if value.size != 1:
        raise InputError(f"{name} must be {what}, not {value.size} values")
    return value.reshape(())


def _from_stored(points: np.ndarray, image: Image) -> np.ndarray:
    """Points in pixels of an image as stored, in pixels of the image itself."""
    return rescale(points, image.stored_size or image.size, image.size)


def _planes_last(array: np.ndarray, name: str) -> np.ndarray:
    """(H, W, 2) float64 from (H, W, 2), from (2, H, W), or from a batch of one of either."""
    planes = array[0] if array.ndim == 4 and array.shape[0] == 1 else array
    if planes.dtype.kind not in "iuf":
        raise InputError(f"{name} must be numbers, not {planes.dtype}")
    if planes.ndim == 3 and planes.shape[-1] != 2 and planes.shape[0] == 2:
        planes = np.moveaxis(planes, 0, -1)
    if planes.ndim != 3 or planes.shape[-1] != 2 or planes.size == 0:
        raise InputError(f"{name} must have shape (H, W, 2) or (2, H, W), not {array.shape}")
    return planes.astype(np.float64)
