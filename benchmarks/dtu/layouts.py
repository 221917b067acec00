"""Where DTU's images and calibrations lie, in each of its layouts.

- Raw, as DTU ships it: `Calibration/cal18/pos_NNN.txt`, and `Rectified` or `Cleaned/scanN`; the
  sample set has all of it in a folder `MVS Data`.
- As prepared for MVSNet. Training: `Cameras/NNNNNNNN_cam.txt` for images of 1600x1200,
  `Rectified/scanN` with such images and `Rectified/scanN_train` with their half-size crops, names
  from 1 and cameras from 0; of both, the full size is taken. Test: `scanN/{images,cams}`, both from
  0, one light, K in pixels of the images.
"""

from dataclasses import dataclass, replace
from pathlib import Path

from dgc_pose.benchmarks.dtu.calibration import DtuView, read_cam, read_projection
from dgc_pose.benchmarks.dtu.scene import SceneReader, light_suffix, numbered_folders
from dgc_pose.cameras.camera import Camera

# What is expected of each layout.
RAW = "Calibration/cal18/pos_001.txt and Rectified/scan1/rect_001_3_r5000.png"
MVSNET = "Cameras/00000000_cam.txt and Rectified/scan1, or scan1/cams/00000000_cam.txt"
_KINDS = {"Rectified": "rect", "Cleaned": "clean"}  # folder: how its images' names begin
FULL_SIZE, HALF_SIZE = (1600, 1200), (800, 600)  # width, height, pixels
CROP_SIZE = (640, 512)
CROP_CORNER = (80, 44)  # x, y in the half-size image of the crop's top-left pixel: its middle part


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


def find_raw(root: Path, light: str) -> RawReader | None:
    """A reader, or None if `root` is of another layout."""
    for folder in (root, root / "MVS Data"):
        if (folder / "Calibration" / "cal18").is_dir():
            return RawReader(folder, light)
    return None


@dataclass(frozen=True)
class MvsnetReader(SceneReader):
    light: str  # one of LIGHTS; test sets have one light alone

    def numbers(self) -> list[int]:
        folder = self.root / "Rectified"
        return sorted({*self.test_scenes(), *numbered_folders(folder, r"scan(\d+)(?:_train)?")})

    def image_stem(self, scene: int, position: int) -> Path:
        if self._is_test(scene):
            return self.root / f"scan{scene}" / "images" / f"{position - 1:08d}"
        folder = f"scan{scene}_train" if self._is_cropped(scene) else f"scan{scene}"
        name = f"rect_{position:03d}_{light_suffix(self.light)}"
        return self.root / "Rectified" / folder / name

    def image_size(self, scene: int) -> tuple[int, int] | None:
        return CROP_SIZE if self._is_cropped(scene) else None

    def view(self, scene: int, position: int) -> DtuView | str:
        test = self.root / f"scan{scene}" / "cams"
        folder = test if self._is_test(scene) else self.root / "Cameras"
        path = folder / f"{position - 1:08d}_cam.txt"
        return self.calibration(path, _read_cropped if self._is_cropped(scene) else read_cam)

    def test_scenes(self) -> list[int]:
        """The scenes in the layout of the test sets."""
        return [n for n in numbered_folders(self.root, r"scan(\d+)") if self._is_test(n)]

    def _is_test(self, scene: int) -> bool:
        return (self.root / f"scan{scene}" / "cams").is_dir()

    def _is_cropped(self, scene: int) -> bool:
        folder = self.root / "Rectified"
        return (
            not self._is_test(scene)
            and not (folder / f"scan{scene}").is_dir()
            and (folder / f"scan{scene}_train").is_dir()
        )


def _read_cropped(path: Path) -> DtuView:
    """The camera of an image of `FULL_SIZE` after it is halved and cropped for training."""
    view = read_cam(path)
    K = Camera(view.K, FULL_SIZE).resized(HALF_SIZE).K.copy()
    K[:2, 2] -= CROP_CORNER
    return replace(view, K=K)


def find_mvsnet(root: Path, light: str) -> MvsnetReader | None:
    """A reader, or None if `root` is of another layout."""
    reader = MvsnetReader(root, light)
    return reader if (root / "Cameras").is_dir() or reader.test_scenes() else None
