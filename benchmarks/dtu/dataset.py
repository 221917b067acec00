"""DTU on a user's disk, in any of its layouts.

- `raw`, as DTU ships it: `Calibration/cal18/pos_NNN.txt`, and `Rectified` or `Cleaned/scanN`; the
  sample set has all of it in a folder `MVS Data`.
- `mvsnet`, as prepared for MVSNet. Training: `Cameras/NNNNNNNN_cam.txt` for images of 1600x1200,
  `Rectified/scanN` with such images and `Rectified/scanN_train` with their half-size crops, names
  from 1 and cameras from 0; of both, the full size is taken. Test: `scanN/{images,cams}`, both from
  0, one light, K in pixels of the images.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from dgc_pose.benchmarks.dtu.calibration import DtuView, read_cam, read_projection
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.checks import checked_camera
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.images.image import image_size

Layout = Literal["raw", "mvsnet"]
Light = Literal["0", "1", "2", "3", "4", "5", "6", "max"]  # as in the names of images
Reader = Callable[[Path], DtuView]

_EXPECTED: dict[Layout, str] = {
    "raw": "Calibration/cal18/pos_001.txt and Rectified/scan1/rect_001_3_r5000.png",
    "mvsnet": "Cameras/00000000_cam.txt and Rectified/scan1, or scan1/cams/00000000_cam.txt",
}
FULL_SIZE, HALF_SIZE = (1600, 1200), (800, 600)  # width, height, pixels
CROP_SIZE = (640, 512)
CROP_CORNER = (80, 44)  # x, y in the half-size image of the crop's top-left pixel: its middle part


@dataclass(frozen=True)
class DtuScene:
    """The views of a scene that have both an image and a calibration."""

    number: int
    views: Mapping[int, DtuView]  # by DTU's position, from 1; in pixels of `size`
    images: Mapping[int, Path]  # by position
    size: tuple[int, int]  # (width, height) of every image; (0, 0) without any

    @property
    def name(self) -> str:
        return f"scan{self.number}"

    @property
    def missing(self) -> int:
        """How many of DTU's positions lack an image or a calibration."""
        return number_of_views(self.number) - len(self.views)


@dataclass(frozen=True)
class Dataset:
    """The scenes that have two views or more."""

    root: Path  # what the names of images are relative to
    layout: Layout
    scenes: tuple[DtuScene, ...]  # by number, ascending
    left_out: tuple[int, ...]  # numbers of scenes with a folder, but fewer than two views

    def scene(self, number: int) -> DtuScene:
        """A scene by its number. Raises InputError if it is missing."""
        for scene in self.scenes:
            if scene.number == number:
                return scene
        raise InputError(f"scan{number} is none of the {len(self.scenes)} scans of {self.root}")


def open_dataset(
    root: str | Path,
    *,
    layout: Layout | None = None,
    scenes: Sequence[int] | None = None,
    light: Light = "3",
) -> Dataset:
    """Find scenes and their views; without `scenes`, their numbers, all that are there.

    light: test sets of MVSNet hold one light alone. Raises InputError, with the path and what was
    expected, if the layout or one of `scenes` is missing or a calibration is malformed; ImageError
    for a file that is no image; OSError.
    """
    root = Path(root)
    if not root.is_dir():
        raise InputError(f"{root}: no such folder; expected DTU there")
    layout = _layout(root, layout)
    if layout == "raw" and not (root / "Calibration/cal18").is_dir():
        root = root / "MVS Data"
    known: dict[tuple[Path, Reader], DtuView] = {}
    numbers = _numbers(root) if scenes is None else sorted(set(scenes))
    opened = [_read_scene(root, layout, number, light, known) for number in numbers]
    if not opened:
        raise InputError(f"{root}: no scene, expected {_EXPECTED[layout]}")
    short = [scene for scene in opened if len(scene.views) < 2]
    if short and (scenes is not None or len(short) == len(opened)):
        scene = short[0]
        raise InputError(
            f"{root}: {scene.name} has {len(scene.views)} views with image (light {light}) and "
            f"calibration in the {layout} layout, and two are needed, such as {_EXPECTED[layout]}"
        )
    return Dataset(
        root=root,
        layout=layout,
        scenes=tuple(scene for scene in opened if scene not in short),
        left_out=tuple(scene.number for scene in short),
    )


def number_of_views(scene: int) -> int:
    """How many positions DTU took a scene from."""
    return 49 if scene <= 77 else 64


def _layout(root: Path, asked: Layout | None) -> Layout:
    """The layout of a folder: the one that is asked for, or the only one that is there."""
    folders = ("Calibration/cal18", "MVS Data/Calibration/cal18")
    there: dict[Layout, bool] = {
        "raw": any((root / folder).is_dir() for folder in folders),
        "mvsnet": (root / "Cameras").is_dir() or any(root.glob("scan*/cams")),
    }
    layouts = [name for name, is_there in there.items() if is_there and asked in (None, name)]
    if len(layouts) > 1:
        names = " and ".join(layouts)
        raise InputError(f"{root}: DTU in the layouts {names}: choose by", ArgumentName("layout"))
    if not layouts:
        wanted = _EXPECTED if asked is None else {asked: _EXPECTED[asked]}
        expected = "; ".join(f"{name}: {files}" for name, files in wanted.items())
        raise InputError(f"{root}: DTU in none of the layouts that are read, expected {expected}")
    return layouts[0]


def _numbers(root: Path) -> list[int]:
    """The scenes that have a folder, ascending."""
    folders = (path for kind in ("Rectified", "Cleaned") for path in (root / kind).glob("scan*"))
    tests = (path.parent for path in root.glob("scan*/cams"))
    matches = (re.fullmatch(r"scan(\d+)(?:_train)?", path.name) for path in (*folders, *tests))
    return sorted({int(match[1]) for match in matches if match})


def _read_scene(
    root: Path,
    layout: Layout,
    number: int,
    light: Light,
    known: dict[tuple[Path, Reader], DtuView],
) -> DtuScene:
    """Find the views of a scene; those without an image or a calibration are left out.

    known: what is read of a calibration, which scenes may share. Raises InputError, with the path,
    for a calibration that is malformed or cannot belong to the image, and if images differ in size;
    ImageError for a file that is no image.
    """
    files = _raw_files if layout == "raw" else _mvsnet_files
    views: dict[int, DtuView] = {}
    images: dict[int, Path] = {}
    size: tuple[int, int] | None = None
    for position in range(1, number_of_views(number) + 1):
        stem, calibration, read = files(root, number, position, light)
        paths = (stem.with_name(stem.name + suffix) for suffix in (".png", ".jpg"))
        image = next((path for path in paths if path.is_file()), None)
        if image is None or not calibration.is_file():
            continue
        if (calibration, read) not in known:
            known[calibration, read] = read(calibration)
        view, actual = known[calibration, read], image_size(image)
        size = size or (CROP_SIZE if read is _read_cropped else actual)
        if actual != size:
            raise InputError(
                f"{image}: expected {size[0]} x {size[1]} pixels, found {actual[0]} x {actual[1]}"
            )
        # Its warning about the principal point is for cameras that a user gives.
        checked_camera(Camera(view.K), size, f"K of {image}")
        views[position], images[position] = view, image
    return DtuScene(number, views, images, size or (0, 0))


def _raw_files(root: Path, scene: int, position: int, light: Light) -> tuple[Path, Path, Reader]:
    """The image of a position without .png or .jpg, its calibration, and what reads that."""
    folder, cleaned = (root / kind / f"scan{scene}" for kind in ("Rectified", "Cleaned"))
    name = f"rect_{position:03d}_{_light(light)}"
    if cleaned.is_dir() and not folder.is_dir():
        folder, name = cleaned, f"clean_{position:03d}_{_light(light)}"
    return folder / name, root / f"Calibration/cal18/pos_{position:03d}.txt", read_projection


def _mvsnet_files(root: Path, scene: int, position: int, light: Light) -> tuple[Path, Path, Reader]:
    """As `_raw_files`."""
    test, number = root / f"scan{scene}", f"{position - 1:08d}"
    if (test / "cams").is_dir():
        return test / "images" / number, test / "cams" / f"{number}_cam.txt", read_cam
    full, cropped = (root / "Rectified" / f"scan{scene}{end}" for end in ("", "_train"))
    is_cropped = cropped.is_dir() and not full.is_dir()
    folder, read = (cropped, _read_cropped) if is_cropped else (full, read_cam)
    name = f"rect_{position:03d}_{_light(light)}"
    return folder / name, root / "Cameras" / f"{number}_cam.txt", read


def _light(light: Light) -> str:
    """How the name of a raw image ends: 3_r5000 for a light, max for all of them."""
    return light if light == "max" else f"{light}_r5000"


def _read_cropped(path: Path) -> DtuView:
    """The camera of an image of `FULL_SIZE` after it is halved and cropped for training."""
    view = read_cam(path)
    K = Camera(view.K, FULL_SIZE).resized(HALF_SIZE).K.copy()
    K[:2, 2] -= CROP_CORNER
    return replace(view, K=K)
