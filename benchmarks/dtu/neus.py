"""DTU as it was prepared for IDR and NeuS: `scanN/{image/000000.png, cameras.npz}`, one light.

`world_mat_i` (4x4) of `cameras.npz` is the projection, world (mm) to pixel, of image i, from 0;
`scale_mat_i` normalises the object and has no part in a pose.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dgc_pose.benchmarks.dtu.calibration import DtuView, decompose
from dgc_pose.benchmarks.dtu.scene import SceneReader, numbered_folders
from dgc_pose.errors import InputError
from dgc_pose.files.arrays import read_arrays

EXPECTED = "scan24/cameras.npz and scan24/image/000000.png"
_FOLDER = r"(?:dtu_)?scan(\d+)"
_KEYS = [f"world_mat_{number}" for number in range(64)]  # by position - 1
_CALIBRATIONS = ("cameras.npz", "cameras_sphere.npz")  # IDR's name, NeuS's


@dataclass(frozen=True)
class NeusReader(SceneReader):
    folders: Mapping[int, Path]  # by scene
    _matrices: dict[Path, Mapping[str, np.ndarray]] = field(default_factory=dict)

    def numbers(self) -> list[int]:
        return sorted(self.folders)

    def image_stem(self, scene: int, position: int) -> Path:
        return self._folder(scene) / "image" / f"{position - 1:06d}"

    def view(self, scene: int, position: int) -> DtuView | str:
        folder, key = self._folder(scene), _KEYS[position - 1]
        path = _calibration(folder)
        if path is None:
            return f"{folder / _CALIBRATIONS[0]}: {key}"
        if path not in self._matrices:
            self._matrices[path] = _read(path)
        world_mat = self._matrices[path].get(key)
        if world_mat is None:
            return f"{path}: {key}"
        if world_mat.shape != (4, 4) or world_mat.dtype.kind not in "fiu":
            raise InputError(f"{path}: {key}: expected 4x4 numbers, found shape {world_mat.shape}")
        return decompose(world_mat[:3].astype(np.float64), f"{path}: {key}")

    def _folder(self, scene: int) -> Path:
        return self.folders.get(scene, self.root / f"scan{scene}")


def find(root: Path, light: str) -> NeusReader | None:
    """A reader, or None if `root` is of another layout. There is no choice of light."""
    folders = {
        n: folder for n, folder in numbered_folders(root, _FOLDER).items() if _calibration(folder)
    }
    return NeusReader(root, folders) if folders else None


def _calibration(folder: Path) -> Path | None:
    return next((folder / name for name in _CALIBRATIONS if (folder / name).is_file()), None)


def _read(path: Path) -> Mapping[str, np.ndarray]:
    """The projections of a file by their names."""
    try:
        return read_arrays(path, _KEYS)
    except InputError as error:
        raise InputError(f"{path}: expected an .npz with world_mat_0 and so on") from error
