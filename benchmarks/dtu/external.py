"""Dense maps, flows and matches that another program computed: one file a pair.

The file of a pair is `scanN_A_B` and an ending: a flow or map lies on the pixels of view B and
points into view A, where A and B are the pair's first and second view. (To an optical flow program
view B is the first image.) A map of any size W x H counts as that of both views resized to W x H.

- `.flo`: Middlebury's flow; components beyond 1e9 are unknown.
- `.png`: KITTI's 16-bit flow, (value - 2^15) / 64, the third channel telling where it is known.
- `.npy`: a flow (H, W, 2) or (2, H, W), x before y; NaN is unknown.
- `.npz`: `flow` as in .npy; or `map`, the places themselves; either with `matchability` (H, W) in
  0 to 1 (`certainty` is taken as well), 1 everywhere without it. With `grid` (H, W, 2) beside it,
  `map` and `grid` are in pixels of the views as stored, as `dgc-pose match` writes them. Or
  `points1` and `points2` (N, 2) alone, in pixels of the views as stored, with `confidence` (N,)
  and `error_px`, where known, and `key_points`, true where each was found by itself.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path

import cv2
import numpy as np

from dgc_pose.benchmarks.dtu.flow import pixel_grid, scaled_map
from dgc_pose.benchmarks.dtu.protocols import ShownPair
from dgc_pose.errors import InputError
from dgc_pose.matches import Matches
from dgc_pose.matching import CorrespondenceMap

ENDINGS = (".flo", ".npz", ".npy", ".png")
_FLO_MAGIC = 202021.25
_FLO_UNKNOWN = 1e9
_ERROR_PX = 1.0  # of points without an error_px, pixels of the views as stored


class ExternalMatches:
    """The files of one program, in one folder."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    def require(self, pairs: Iterable[tuple[int, int, int]]) -> None:
        """Raise InputError, with the path, where the file of a (scene, view1, view2) is not there:
        better now than after an hour of work."""
        if not self.folder.is_dir():
            raise InputError(f"{self.folder}: no such folder of matches")
        for scene, view1, view2 in pairs:
            self.path(scene, view1, view2)

    def path(self, scene: int, view1: int, view2: int) -> Path:
        """The file of a pair. Raises InputError where there is none, or more than one."""
        stem = self.folder / f"scan{scene}_{view1}_{view2}"
        found = [path for end in ENDINGS if (path := Path(f"{stem}{end}")).is_file()]
        if len(found) != 1:
            what = "no such file" if not found else f"{len(found)} files"
            raise InputError(
                f"{stem}: {what} with the ending {', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}; "
                "expected one for each pair of the list"
            )
        return found[0]

    def find(self, shown: ShownPair) -> CorrespondenceMap | Matches:
        """The map of a pair, or its matches, in pixels of the images shown."""
        path = self.path(shown.scene, shown.view1, shown.view2)
        try:
            return _read(path, shown)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(f"{path}: cannot be read ({reason})") from None


def _read(path: Path, shown: ShownPair) -> CorrespondenceMap | Matches:
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as archive:
            return _from_arrays({key: archive[key] for key in archive.files}, shown)
    if path.suffix == ".npy":
        flow = _planes_last(np.load(path, allow_pickle=False), "flow")
    elif path.suffix == ".flo":
        flow = read_flo(path)
    else:
        flow = read_kitti(path)
    return _from_flow(flow, None, shown)


def read_flo(path: Path) -> np.ndarray:
    """Middlebury's flow (H, W, 2) float64, NaN where unknown."""
    data = path.read_bytes()
    if len(data) < 12 or np.frombuffer(data[:4], "<f4")[0] != np.float32(_FLO_MAGIC):
        raise InputError("not a .flo file: it does not begin with 202021.25")
    width, height = (int(side) for side in np.frombuffer(data[4:12], "<i4"))
    if width < 1 or height < 1 or len(data) != 12 + 8 * width * height:
        raise InputError(f"{len(data)} bytes are not those of a flow of {width} x {height}")
    flow = np.frombuffer(data[12:], "<f4").reshape(height, width, 2).astype(np.float64)
    flow[(np.abs(flow) > _FLO_UNKNOWN).any(-1)] = np.nan
    return flow


def read_kitti(path: Path) -> np.ndarray:
    """KITTI's flow (H, W, 2) float64, NaN where unknown."""
    stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if stored is None or stored.dtype != np.uint16 or stored.ndim != 3 or stored.shape[2] != 3:
        raise InputError("expected a PNG of three 16-bit channels, as KITTI stores flow")
    known, y, x = np.moveaxis(stored.astype(np.float64), -1, 0)  # OpenCV turns RGB round
    flow = (np.stack([x, y], -1) - 2**15) / 64
    flow[known == 0] = np.nan
    return flow


def _from_arrays(
    arrays: Mapping[str, np.ndarray], shown: ShownPair
) -> CorrespondenceMap | Matches:
    confidence = arrays.get("matchability", arrays.get("certainty"))
    if "flow" in arrays:
        return _from_flow(_planes_last(arrays["flow"], "flow"), confidence, shown)
    if "map" in arrays:
        places = _planes_last(arrays["map"], "map")
        if "grid" not in arrays:
            return _from_map(places, confidence, shown)
        grid = _planes_last(arrays["grid"], "grid")
        return _from_grid(places, grid, confidence, shown)
    if "points1" in arrays and "points2" in arrays:
        return _from_points(arrays, shown)
    found = ", ".join(sorted(arrays)) or "nothing"
    raise InputError(f"expected flow, map, or points1 and points2, found {found}")


def _from_flow(
    flow: np.ndarray, confidence: np.ndarray | None, shown: ShownPair
) -> CorrespondenceMap:
    return _from_map(pixel_grid((flow.shape[1], flow.shape[0])) + flow, confidence, shown)


def _from_map(
    places: np.ndarray, confidence: np.ndarray | None, shown: ShownPair
) -> CorrespondenceMap:
    trust, places = _trusted(confidence, places)
    return _thinned(scaled_map(places, trust, shown.image1.size, shown.image2.size))


def _from_grid(
    places: np.ndarray, grid: np.ndarray, confidence: np.ndarray | None, shown: ShownPair
) -> CorrespondenceMap:
    if grid.shape != places.shape:
        raise InputError(f"map has shape {places.shape}, grid {grid.shape}")
    trust, places = _trusted(confidence, places)
    found = CorrespondenceMap(
        map=_shown(places, shown.size1, shown.image1.size).astype(np.float32),
        grid=_shown(grid, shown.size2, shown.image2.size).astype(np.float32),
        matchability=trust,
        size1=shown.image1.size,
        size2=shown.image2.size,
    )
    return _thinned(found)


def _from_points(arrays: Mapping[str, np.ndarray], shown: ShownPair) -> Matches:
    points1, points2 = (np.asarray(arrays[key], np.float64) for key in ("points1", "points2"))
    if points1.ndim != 2 or points1.shape[1] != 2 or points1.shape != points2.shape:
        raise InputError(
            f"points1 and points2 must both be (N, 2), not {points1.shape} and {points2.shape}"
        )
    error = _single(arrays, "error_px", _ERROR_PX, "one number")
    key_points = _single(arrays, "key_points", False, "true or false")
    scale = np.sqrt(np.prod(np.divide(shown.image1.size, shown.size1)))
    return Matches(
        _shown(points1, shown.size1, shown.image1.size),
        _shown(points2, shown.size2, shown.image2.size),
        np.asarray(arrays.get("confidence", np.ones(len(points1)))),
        float(error) * float(scale),
        bool(key_points),
    )


def _single(arrays: Mapping[str, np.ndarray], name: str, default: float, what: str) -> np.ndarray:
    """The one value () of an array, or the default where there is none. `what`: that it must be."""
    value = np.asarray(arrays.get(name, default))
    if value.size != 1:
        raise InputError(f"{name} must be {what}, not {value.size} values")
    return value.reshape(())


def _shown(places: np.ndarray, stored: tuple[int, int], size: tuple[int, int]) -> np.ndarray:
    """Pixels of a view as stored, as those of the image shown."""
    return (places + 0.5) * np.divide(size, stored) - 0.5


def _thinned(found: CorrespondenceMap) -> CorrespondenceMap:
    """Every k-th cell of a map that is finer than the pixels of the image that it lies on."""
    rows, columns = found.matchability.shape
    step = max(1, round(columns / found.size2[0]), round(rows / found.size2[1]))
    if step == 1:
        return found
    cells = (slice(step // 2, None, step), slice(step // 2, None, step))
    return CorrespondenceMap(
        found.map[cells],
        found.grid[cells],
        found.matchability[cells],
        found.size1,
        found.size2,
    )


def _trusted(
    confidence: np.ndarray | None, places: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The matchability (H, W) float32, 1 where none is given, and the places (H, W, 2): where a
    place is unknown the one is 0 and the other infinite."""
    known = np.isfinite(places).all(-1)
    placed = np.where(known[..., None], places, -np.inf)
    if confidence is None:
        return known.astype(np.float32), placed
    given = np.asarray(confidence, dtype=np.float32).squeeze()
    if given.shape != known.shape:
        raise InputError(f"matchability has shape {given.shape}, the map {known.shape}")
    if not ((given >= 0) & (given <= 1)).all():
        raise InputError("matchability must lie in 0 to 1")
    return np.where(known, given, np.float32(0)), placed


def _planes_last(array: np.ndarray, name: str) -> np.ndarray:
    """(H, W, 2) float64 from that, from (2, H, W), or from a batch of one of either."""
    found = np.asarray(array)
    if found.dtype.kind not in "iuf":
        raise InputError(f"{name} must be numbers, not {found.dtype}")
    if found.ndim == 4 and found.shape[0] == 1:
        found = found[0]
    if found.ndim == 3 and found.shape[-1] != 2 and found.shape[0] == 2:
        found = np.moveaxis(found, 0, -1)
    if found.ndim != 3 or found.shape[-1] != 2 or found.size == 0:
        raise InputError(f"{name} must have shape (H, W, 2) or (2, H, W), not {array.shape}")
    return found.astype(np.float64)
