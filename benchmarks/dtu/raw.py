"""DTU as DTU ships it: `Calibration/cal18/pos_NNN.txt`, and `Rectified` or `Cleaned/scanN`.

The sample set has all of it in a folder `MVS Data`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dgc_pose.benchmarks.dtu.calibration import DtuView, read_projection
from dgc_pose.benchmarks.dtu.scene import SceneReader, light_suffix, numbered_folders

EXPECTED = "Calibration/cal18/pos_001.txt and Rectified/scan1/rect_001_3_r5000.png"
_KINDS = {"Rectified": "rect", "Cleaned": "clean"}  # folder: how its images' names begin


@dataclass(frozen=True)
class RawReader(SceneReader):
    light: str  # one of LIGHTS

    def numbers(self) -> list[int]:
        folders = [numbered_folders(self.root / kind, r"scan(\d+)") for kind in _KINDS]
        return sorted(set().union(*folders))

    def image_stem(self, scene: int, position: int) -> Path:
        folders = {kind: self.root / kind / f"scan{scene}" for kind in _KINDS}
        kind = next((kind for kind, folder in folders.items() if folder.is_dir()), "Rectified")
        return folders[kind] / f"{_KINDS[kind]}_{position:03d}_{light_suffix(self.light)}"

    def view(self, scene: int, position: int) -> DtuView | str:
        path = self.root / "Calibration" / "cal18" / f"pos_{position:03d}.txt"
        return self.calibration(path, read_projection)


def find(root: Path, light: str) -> RawReader | None:
    """A reader, or None if `root` is of another layout."""
    for folder in (root, root / "MVS Data"):
        if (folder / "Calibration" / "cal18").is_dir():
            return RawReader(folder, light)
    return None
