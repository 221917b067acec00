"""Tiny scans of one scene, rendered or grey, written as DTU is."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import multi_view
import numpy as np

from dgc_pose.benchmarks.dtu.calibration import DtuView
from dgc_pose.cameras.camera import Camera

SIZE = (160, 120)
# DTU's camera at a tenth of its size.
K = Camera(np.array([[2892.0, 0, 823], [0, 2883, 619], [0, 0, 1]]), (1600, 1200)).resized(SIZE).K
DISTANCE = 650.0  # mm from the object that all views look at
LOOK_AT = (0.0, 0.2, 4.6)  # units of the rendered scene
MM_PER_UNIT = DISTANCE / LOOK_AT[2]


@dataclass(frozen=True)
class Scan:
    """A scan as it is written: the files of every layout hold these matrices."""

    views: Mapping[int, DtuView]
    images: Mapping[int, np.ndarray]  # (H, W, 3) uint8, RGB
    depths: Mapping[int, np.ndarray]  # (H, W) mm; none of a grey scan


def arc(degrees: Sequence[float] | np.ndarray) -> Mapping[int, DtuView]:
    """Views numbered from 1 that look at one point from these angles around it."""
    views = {}
    for number, angle in enumerate(np.radians(degrees), start=1):
        c, s = np.cos(angle), np.sin(angle)
        R = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
        views[number] = DtuView(K, R, np.array([0.0, 0.0, DISTANCE]))
    return views


def grey_scan(degrees: Sequence[float] | np.ndarray) -> Scan:
    """Views on an arc, with nothing in their images."""
    views = arc(degrees)
    grey = np.full((SIZE[1], SIZE[0], 3), 128, np.uint8)
    return Scan(views, dict.fromkeys(views, grey), {})


@lru_cache(maxsize=4)
def rendered_scan(degrees: tuple[float, ...] = (-20.0, -8.0, 0.0, 7.0, 18.0)) -> Scan:
    """The scene of `multi_view` from an arc around its middle."""
    textures = multi_view.draw_textures()
    views, images, depths = {}, {}, {}
    for number, on_arc in arc(degrees).items():
        view = DtuView(K, on_arc.R, on_arc.t - on_arc.R @ (np.array(LOOK_AT) * MM_PER_UNIT))
        centre = -view.R.T @ view.t / MM_PER_UNIT
        views[number] = view
        images[number] = multi_view.render(view.R, centre, textures, K, SIZE, fine=4)[0]
        depths[number] = multi_view.render(view.R, centre, textures, K, SIZE, 1)[1] * MM_PER_UNIT
    return Scan(views, images, depths)


def write_raw(
    root: Path,
    scan: Scan,
    *,
    number: int = 65,
    extension: str = "png",
    light: str = "3",
    kind: str = "Rectified",
) -> None:
    """`Calibration/cal18` and `Rectified` or `Cleaned/scanN`."""
    name = {"Rectified": "rect", "Cleaned": "clean"}[kind]
    for position, view in scan.views.items():
        _write_text(root / f"Calibration/cal18/pos_{position:03d}.txt", _rows(_projection(view)))
        file = f"{name}_{position:03d}_{_light(light)}.{extension}"
        write_image(root / kind / f"scan{number}" / file, scan.images[position])


def write_image(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), pixels[:, :, ::-1])


def _extrinsic(view: DtuView) -> np.ndarray:
    extrinsic = np.eye(4)
    extrinsic[:3, :3], extrinsic[:3, 3] = view.R, view.t
    return extrinsic


def _projection(view: DtuView) -> np.ndarray:
    return view.K @ _extrinsic(view)[:3]


def _rows(matrix: np.ndarray) -> str:
    """All digits, so that the numbers read back are the same to the bit."""
    return "".join(" ".join(repr(float(value)) for value in row) + "\n" for row in matrix)


def _light(light: str) -> str:
    return light if light == "max" else f"{light}_r5000"


def _write_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
