"""Matches of many pairs in one HDF5 file, in hloc's layout.

A group `name1/name2` ("/" inside a name becomes "-") holds `keypoints0`, `keypoints1` (N, 2)
float32, pixels of the images, (0, 0) the centre of the top-left pixel, `scores` (N,) float32, and
`inliers` (N,) bool, which hloc passes over. Where the pose can be estimated again, with another
camera, there is a group `again` with what that needs besides: the attributes `error_px` and
`key_points`, and of a matcher with a map its even sample: `keypoints0`, `keypoints1`, `scores`, and
the attribute `map_error_px`. A pair that its cameras are fitted to has the attribute `cameras`,
JSON, and `camera_covariance` (12, 12).
"""

import io
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from dgc_pose.cameras.calibration import camera_data, parse_camera_data
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.files.arrays import ARRAY_BYTES
from dgc_pose.files.inputs import read_as, require_regular
from dgc_pose.files.outputs import writing
from dgc_pose.matches import Matches
from dgc_pose.pair_result import PairResult


@dataclass(frozen=True, eq=False)
class FittedCameras:
    """The cameras of a pair as they are fitted to it alone."""

    cameras: tuple[Camera, Camera]
    covariance: np.ndarray  # (12, 12) float64, see `RelativePose.camera_covariance`


@dataclass(frozen=True, eq=False)
class PoseInputs:
    """Values that a pose is estimated from beside its matches' points and scores."""

    error_px: float  # expected error of a good match, pixels of the originals
    key_points: bool  # whether the matches are independent detections
    map_matches: Matches | None  # even sample of the map, float32; None without a map


@dataclass(frozen=True, eq=False)
class PairMatches:
    """The matches of one pair, pixels of the original images."""

    points1: np.ndarray  # (N, 2) float32
    points2: np.ndarray  # (N, 2) float32
    scores: np.ndarray  # (N,) float32, confidence in [0, 1]
    inliers: np.ndarray  # (N,) bool, of the pose
    pose_inputs: PoseInputs | None = None  # None if the pose is not to be estimated again
    fitted: FittedCameras | None = None  # None without a pose, and of cameras that are not fitted

    def estimable(self, weights: str | None) -> tuple[Matches, Matches | None]:
        """The matches and the sample of the map to estimate a pose from; needs `pose_inputs`.

        weights: fingerprint of the network that all are of.
        """
        assert self.pose_inputs is not None
        facts = (self.pose_inputs.error_px, self.pose_inputs.key_points, weights)
        matches = Matches(self.points1, self.points2, self.scores, *facts)
        return matches, self.pose_inputs.map_matches


def pair_matches(result: PairResult, *, estimable: bool) -> PairMatches:
    """The matches of a pair as they are stored, without inliers yet.

    estimable: whether the pose is to be estimated again from them.
    """
    matches, dense, sample = result.matches, result.correspondence_map, None
    if estimable and dense is not None:
        sample = dense.sample
        sample = Matches(*_rounded(sample), sample.error_px)
    return PairMatches(
        *_rounded(matches),
        np.zeros(len(matches), dtype=bool),
        PoseInputs(matches.error_px, matches.key_points, sample) if estimable else None,
    )


def _rounded(matches: Matches) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    points1, points2, scores = (
        array.astype(np.float32) for array in (matches.points1, matches.points2, matches.confidence)
    )
    return points1, points2, scores


_NO_POINTS = np.zeros((0, 2), np.float32)
NO_MATCHES = PairMatches(_NO_POINTS, _NO_POINTS, _NO_POINTS[:, 0], np.zeros(0, bool))
_POINTS = {"keypoints0": "points1", "keypoints1": "points2"}
_DATASETS = {**_POINTS, "scores": "scores", "inliers": "inliers"}
_MAP = {**_POINTS, "scores": "confidence"}
_INPUTS_GROUP, _CAMERAS, _COVARIANCE = "again", "cameras", "camera_covariance"


def group_name(name1: str, name2: str) -> str:
    """The group of a pair in hloc's layout."""
    return "/".join(name.replace("/", "-") for name in (name1, name2))


def write_matches(group: h5py.Group, matches: PairMatches) -> None:
    """The matches of a pair, as datasets of its group."""
    for dataset, field in _DATASETS.items():
        group.create_dataset(dataset, data=getattr(matches, field))
    if matches.fitted is not None:
        cameras = [camera_data(camera) for camera in matches.fitted.cameras]
        group.attrs[_CAMERAS] = json.dumps(cameras)
        group[_COVARIANCE] = matches.fitted.covariance
    if matches.pose_inputs is None:
        return
    inputs, sample = group.create_group(_INPUTS_GROUP), matches.pose_inputs.map_matches
    inputs.attrs["error_px"] = matches.pose_inputs.error_px
    inputs.attrs["key_points"] = matches.pose_inputs.key_points
    if sample is not None:
        inputs.attrs["map_error_px"] = sample.error_px
        for dataset, field in _MAP.items():
            inputs.create_dataset(dataset, data=getattr(sample, field).astype(np.float32))


@contextmanager
def new_file(path: Path) -> Iterator[Any]:
    """An HDF5 file that is made in memory and written at once: HDF5 cannot bear a full disk."""
    with h5py.File(path.name, "w", driver="core", backing_store=False) as file:
        yield file
        file.flush()
        image = file.id.get_file_image()
    with writing(path):
        path.write_bytes(image)


def pack(matches: PairMatches) -> bytes:
    """The matches of a pair as an HDF5 file of their own."""
    with h5py.File("pair", "w", driver="core", backing_store=False) as file:
        write_matches(file.create_group("pair"), matches)
        file.flush()
        return bytes(file.id.get_file_image())


def unpack(data: bytes, where: str) -> PairMatches:
    """The matches that were packed. Raises InputError, with `where`, if they are not whole."""
    with read_as("matches", where), h5py.File(io.BytesIO(data), "r") as file:
        return read_matches(file, "pair", where)


@contextmanager
def open_matches(path: Path) -> Iterator[Any]:
    """An HDF5 file to read. Raises InputError, with the path, if it is cut short or of another
    kind; OSError, with the path, if it cannot be opened."""
    require_regular(path)
    with read_as("an HDF5 file", path):
        file = h5py.File(path, "r")
    with file:
        yield file


def read_matches(file: Any, name: str, where: str | None = None) -> PairMatches:
    """The matches of the group `name` of an open file. Raises InputError, with the path or `where`,
    if there are none, or if they are not whole.

    Links to other files and places are not followed: they could lead anywhere.
    """
    where = where or f"{file.filename}: {name}"
    try:
        group = file
        for part in name.split("/"):
            group = _member(group, part, h5py.Group)
        arrays = {field: _array(group, dataset) for dataset, field in _DATASETS.items()}
        inputs = fitted = None
        if _CAMERAS in group.attrs:
            first, second = map(parse_camera_data, json.loads(group.attrs[_CAMERAS]))
            fitted = FittedCameras((first, second), _array(group, _COVARIANCE))
            if fitted.covariance.shape != (12, 12) or not np.isfinite(fitted.covariance).all():
                raise ValueError("no covariance of two cameras")
        if _INPUTS_GROUP in group:
            inputs = _read_pose_inputs(_member(group, _INPUTS_GROUP, h5py.Group))
    except Exception:  # of HDF5, for damaged files almost any
        raise InputError(f"{where}: no whole matches") from None
    count = len(arrays["scores"])
    shapes = [arrays[name].shape for name in _DATASETS.values()]
    if shapes != [(count, 2), (count, 2), (count,), (count,)]:
        raise InputError(f"{where}: datasets of different lengths")
    if not all(np.isfinite(array).all() for array in arrays.values()):
        raise InputError(f"{where}: numbers that are not finite")
    return PairMatches(**arrays, pose_inputs=inputs, fitted=fitted)


def _read_pose_inputs(group: Any) -> PoseInputs:
    """Raises anything for a group that is not whole."""
    sample = None
    if "map_error_px" in group.attrs:
        points1, points2, scores = (_array(group, dataset) for dataset in _MAP)
        if not all(np.isfinite(array).all() for array in (points1, points2, scores)):
            raise ValueError("numbers that are not finite")
        sample = Matches(points1, points2, scores, float(group.attrs["map_error_px"]))
    error_px = float(group.attrs["error_px"])
    if not error_px > 0:
        raise ValueError("no error of a match")
    return PoseInputs(error_px, bool(group.attrs["key_points"]), sample)


def _member(group: Any, name: str, kind: type) -> Any:
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise ValueError("a link, or nothing")
    if not isinstance(group[name], kind):
        raise ValueError("something else")
    return group[name]


def _array(group: Any, name: str) -> np.ndarray:
    """A data set of numbers of this file itself, not too large; raises anything else."""
    data = _member(group, name, h5py.Dataset)
    kind = "b" if name == "inliers" else "f"
    if data.external or data.is_virtual or data.dtype.kind != kind or data.nbytes > ARRAY_BYTES:
        raise ValueError("not numbers of this file")
    return np.asarray(data[()])
