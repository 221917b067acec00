"""A textured plane seen in images of several sizes, written in the layouts of known pair sets."""

from pathlib import Path

import cv2
import numpy as np

SIZE1 = (320, 240)  # width, height of image 1
SIZE2 = (300, 260)  # of every other
# x2 ~ H x1 in pixels: rotation, scale and some perspective.
H = np.array([[0.95, 0.15, 10.0], [-0.12, 1.02, 25.0], [2e-4, -1e-4, 1.0]])


def texture() -> np.ndarray:
    """A random picture (H, W, 3) uint8 that is smooth enough to be sampled anywhere."""
    noise = np.random.default_rng(0).random((*SIZE1[::-1], 3)).astype(np.float32)
    blurred = sum(cv2.GaussianBlur(noise, (0, 0), sigma) * sigma for sigma in (2.5, 8.0))
    return cv2.normalize(blurred, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def write_sequence(folder: Path) -> None:
    """HPatches: 1.ppm to 6.ppm with H_1_2 and on, all of them `H`."""
    for k in range(2, 7):
        _write(folder / "1.ppm", folder / f"{k}.ppm", folder / f"H_1_{k}")


def write_vgg(folder: Path) -> None:
    """VGG: img1.png to img3.png with H1to2p and H1to3p."""
    for k in (2, 3):
        _write(folder / "img1.png", folder / f"img{k}.png", folder / f"H1to{k}p")


def write_annotated(folder: Path, *names: str) -> None:
    """Pairs NAME_A.png, NAME_B.png, NAME_H.txt."""
    for name in names:
        _write(*(folder / f"{name}_{end}" for end in ("A.png", "B.png", "H.txt")))


def _write(image1: Path, image2: Path, matrix: Path) -> None:
    image1.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(image1), texture())
    cv2.imwrite(str(image2), cv2.warpPerspective(texture(), H, SIZE2, flags=cv2.INTER_LINEAR))
    np.savetxt(matrix, H)
