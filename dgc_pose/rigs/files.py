"""The files of a rig of fixed cameras, and the cameras that moved since an older calibration."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.formats.rigs import CALIBRATION, rig_texts
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.estimation.result import plain
from dgc_pose.geometry.rotation import aligning_rotation, camera_centres, rotation_angle_deg
from dgc_pose.localization.location import Location
from dgc_pose.system.files import write_text
from dgc_pose.system.texts import json_text

RIG = "rig.json"
FILES = (CALIBRATION, "camera_array.toml", "rig_config.json", "stereo.yml", RIG)
_FACTOR = 3.0  # a change above this times the expected error is a motion
_LEAST_ANGLE_DEG = 0.05  # smaller changes do not count
_LEAST_SHIFT = 1e-3  # over extent; smaller changes do not count


def write_rig(
    folder: Path,
    cameras: Mapping[str, Location],
    metric: Mapping[str, Any],
    warnings: Sequence[str] = (),
) -> list[Path]:
    """Write the files of `rig_texts` and rig.json, each completely or not at all; return the paths.

    rig.json names calibration.toml, which has K, lens and pose of each camera, and adds the
    expected errors and deviations, why other cameras have no pose, the warnings, and the names of
    the files. cameras: by name; the located ones have a camera with a size. metric: the unit of the
    positions, and facts about it; empty up to scale. Raises as `rig_texts`; OSError, with the path.
    """
    placed = {name: location for name, location in cameras.items() if location.success}
    views = {name: location.camera for name, location in placed.items() if location.camera}
    texts: dict[str, str] = {}
    if views:
        stated = (placed[name].cam_from_world for name in views)
        poses = np.stack([pose for pose in stated if pose is not None])
        texts = rig_texts(views, poses, metric.get("unit", ""))
    data = {
        "unit": "",
        **metric,
        "calibration": CALIBRATION if views else None,
        "cameras": {name: _facts(placed[name], camera) for name, camera in views.items()},
        "not_placed": {name: cameras[name].reason for name in cameras if name not in placed},
        "warnings": [*warnings],
        "files": [*texts, RIG],
    }
    texts[RIG] = json_text(data)
    for name, text in texts.items():
        write_text(folder / name, text)
    return [folder / name for name in texts]


def _facts(location: Location, camera: Camera) -> dict[str, Any]:
    """What rig.json has of a camera."""
    return {
        "centre": plain(location.centre),
        "rotation_error_90_deg": location.rotation_error_90_deg,
        "position_error_90": location.position_error_90,
        "covariance": plain(location.covariance),
        "probability": location.probability,
        **camera.deviations,
    }


@dataclass(frozen=True)
class CameraChange:
    """The change of a camera between two calibrations."""

    name: str
    angle_deg: float  # between its rotations
    angle_error_deg: float  # expected error of the new calibration; 0 if unknown
    distance: float  # between its centres, in the new calibration's unit
    distance_error: float  # expected error of the new calibration; 0 if unknown
    moved: bool  # by more than three times the error, and 0.05 degrees or 0.1 % of the extent
    focal_change: float | None  # percent; None if the older focal length is unknown
    relative_to: str | None  # the other camera if there are only two: either may have moved
    # The camera that was where this one is now, and the other way round; the change is from there.
    place_of: str | None = None

    def text(self, unit: str) -> str:
        """The change in one line. unit: of length, or "" if unknown."""
        focal = "" if self.focal_change is None else f", focal length {self.focal_change:+.2f} %"
        turn = f"{self.angle_deg:.3f} +- {self.angle_error_deg:.3f} deg"
        shift = f"{self.distance:.3g} +- {self.distance_error:.2g} {unit or 'units of the new rig'}"
        change = f"{turn} and {shift}{focal}"
        if self.place_of is not None:
            swapped = "the two, or their pictures, changed places"
            return f"{self.name} is where {self.place_of} was, to {change}: {swapped}"
        verdict = "moved" if self.moved else "has not moved"
        other = f" relative to {self.relative_to}" if self.relative_to else ""
        return f"{self.name} {verdict}{other}: by {change}"


def compared(
    start: Mapping[str, np.ndarray],
    cameras: Mapping[str, Location],
    start_cameras: Mapping[str, Camera],
) -> list[CameraChange]:
    """The changes of the cameras that two calibrations have in common, in the order of `cameras`.

    start: cam_from_world (3, 4) of the older calibration, by name, in any frame and unit;
    start_cameras: its cameras. cameras: located. A similarity aligns the frames: the best one from
    two cameras, refitted to all cameras that agree with it. Two cameras that agree only in each
    other's place are compared there. If there are only two common cameras, the second is compared
    relative to the first, up to the distance between them. Raises InputError for fewer.
    """
    names = [name for name in cameras if name in start]
    if len(names) < 2:
        count = f"has {len(names)} of the {len(cameras)} cameras, and two are needed"
        raise InputError(ArgumentName("start"), count)
    located = [cameras[name] for name in names]
    old = np.stack([start[name] for name in names])
    new = np.stack([pose for place in located if (pose := place.cam_from_world) is not None])
    expected = [
        (place.rotation_error_90_deg or 0, place.position_error_90 or 0) for place in located
    ]
    errors = np.array(expected, dtype=float)  # (N, 2)
    extent = max(float(np.linalg.norm(a - b)) for a, b in combinations(camera_centres(new), 2))
    first = names[0] if len(names) == 2 else None
    if first:
        errors[1] = np.linalg.norm(errors, axis=0)
    limits = np.maximum(_FACTOR * errors, (_LEAST_ANGLE_DEG, _LEAST_SHIFT * extent))
    places = _places(old, new, limits)
    changes = _aligned_changes(old[places], new, limits)
    found = []
    for number, (name, location) in enumerate(zip(names, located, strict=True)):
        before = names[places[number]]
        known = start_cameras.get(before)
        angle, distance = changes[number].tolist()
        focal = None
        if location.camera and known:
            focal = 100 * (location.camera.focal / known.focal - 1)
        place_of = before if before != name else None
        change = CameraChange(
            name=name,
            angle_deg=angle,
            angle_error_deg=errors[number, 0],
            distance=distance,
            distance_error=errors[number, 1],
            moved=place_of is not None or bool((changes[number] > limits[number]).any()),
            focal_change=focal,
            relative_to=first,
            place_of=place_of,
        )
        found.append(change)
    return found[1:] if first else found


def _places(old: np.ndarray, new: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """The old camera (N,) in whose place each new one is: itself, but for two that changed places.
    These are within the limits (N, 2) there alone, and more cameras are than without the change."""
    itself = np.arange(len(old))
    best = itself
    agree = np.all(_aligned_changes(old, new, limits) <= limits, axis=1)
    most = int(np.sum(agree))
    # The first of two cameras is the frame, and always agrees.
    may_change = itself if len(old) == 2 else np.flatnonzero(~agree)
    for pair in combinations(may_change.tolist(), 2):
        places = itself.copy()
        places[[*pair]] = places[[*pair[::-1]]]
        agree = np.all(_aligned_changes(old[places], new, limits) <= limits, axis=1)
        count = int(np.sum(agree))
        if np.all(agree[[*pair]]) and count > most:
            best = places
            most = count
    return best


def _aligned_changes(old: np.ndarray, new: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """The `_changes` after the alignment to the cameras that did not move; of two cameras, to the
    first."""
    still = [0] if len(old) == 2 else _unmoved(old, new, limits)
    return _changes(old, new, still)


def _unmoved(old: np.ndarray, new: np.ndarray, limits: np.ndarray) -> list[int]:
    """The cameras that agree with the best similarity from two of them."""
    pairs = [[*pair] for pair in combinations(range(len(old)), 2)]
    offs = [(_changes(old, new, pair) / limits).max(1) for pair in pairs]
    best = min(range(len(pairs)), key=lambda n: np.minimum(offs[n], 1).sum())
    agree: list[int] = np.flatnonzero(offs[best] <= 1).tolist()
    return agree if len(agree) > 1 else pairs[best]


def _changes(old: np.ndarray, new: np.ndarray, still: Sequence[int]) -> np.ndarray:
    """Angle in degrees and distance (N, 2) between the poses (N, 3, 4) of two calibrations, aligned
    by a similarity of the cameras `still`. With a single one, all cameras determine the scale."""
    before = camera_centres(old)
    after = camera_centres(new)
    scaled = still if len(still) > 1 else range(len(old))
    spread = [np.linalg.norm(at[scaled] - at[scaled].mean(0)) for at in (before, after)]
    W = aligning_rotation(*(poses[still, :, :3].reshape(-1, 3) for poses in (old, new)))
    expected = spread[1] / (spread[0] or 1.0) * (before - before[still].mean(0)) @ W.T
    shifts = np.linalg.norm(after - after[still].mean(0) - expected, axis=1)
    turns = new[:, :, :3] @ W @ old[:, :, :3].transpose(0, 2, 1)
    return np.column_stack([[rotation_angle_deg(turn) for turn in turns], shifts])
