"""DTU as it was prepared for IDR and NeuS: `scanN/{image/000000.png, cameras.npz}`, one light.

`world_mat_i` (4x4) of `cameras.npz` is the projection, world (mm) to pixel, of image i, from 0;
`scale_mat_i` normalises the object and has no part in a pose.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dgc_pose.benchmarks.dtu.calibration import View, decompose
from dgc_pose.benchmarks.dtu.scene import SceneReader, numbered_folders
from dgc_pose.errors import InputError
from dgc_pose.files.array_files import read_arrays

EXPECTED = "scan24/cameras.npz and scan24/image/000000.png"
_FOLDER = r"(?:dtu_)?scan(\d+)"
_MOST_VIEWS = 64  # of a scene
_CALIBRATIONS = ("cameras.npz", "cameras_sphere.npz")  # IDR's name, NeuS's


@dataclass(frozen=True)
class NeusReader(SceneReader):
    folders: Mapping[int, Path]  # by scene
    _matrices: dict[int, Mapping[str, np.ndarray]] = field(default_factory=dict)

    def numbers(self) -> list[int]:
        return sorted(self.folders)

    def image_stem(self, scene: int, position: int) -> Path:
        return self._folder(scene) / "image" / f"{position - 1:06d}"

    def view(self, scene: int, position: int) -> View | None:
        path = _calibration(self._folder(scene))
        if path is None:
            return None
        if scene not in self._matrices:
            self._matrices[scene] = _read(path)
        world_mat = self._matrices[scene].get(_key(position))
        if world_mat is None:
            return None
        name = f"{path}: {_key(position)}"
        if np.shape(world_mat) != (4, 4) or world_mat.dtype.kind not in "fiu":
            raise InputError(f"{name}: expected 4x4 numbers, found shape {np.shape(world_mat)}")
        return decompose(world_mat[:3].astype(np.float64), name)

    def calibration_name(self, scene: int, position: int) -> str:
        folder = self._folder(scene)
        return f"{_calibration(folder) or folder / _CALIBRATIONS[0]}: {_key(position)}"

    def _folder(self, scene: int) -> Path:
        return self.folders.get(scene, self.root / f"scan{scene}")


def find(root: Path, light: str) -> NeusReader | None:
    """A reader, or None if `root` is of another layout. There is no choice of light."""
    found = {
        number: folder
        for number, folder in numbered_folders(root, _FOLDER).items()
        if _calibration(folder) is not None
    }
    return NeusReader(root, found) if found else None


def _calibration(folder: Path) -> Path | None:
    return next((folder / name for name in _CALIBRATIONS if (folder / name).is_file()), None)


def _key(position: int) -> str:
    return f"world_mat_{position - 1}"


def _read(path: Path) -> Mapping[str, np.ndarray]:
    """The projections of a file by their names."""
    try:
        found = read_arrays(path, [_key(position) for position in range(1, _MOST_VIEWS + 1)])
    except InputError as error:
        raise InputError(f"{path}: expected an .npz with world_mat_0 and so on") from error
    return found
