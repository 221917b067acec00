"""A textured plane seen in images of several sizes, written in the layouts of known pair sets."""

from pathlib import Path

import cv2
import numpy as np

SIZE1 = (320, 240)  # width, height of image 1
SIZE2 = (300, 260)  # of every other
# x2 ~ H x1 in pixels: rotation, scale and some perspective.
H = np.array([[0.95, 0.15, 10.0], [-0.12, 1.02, 25.0], [2e-4, -1e-4, 1.0]])


def texture(size: tuple[int, int] = SIZE1, seed: int = 0) -> np.ndarray:
    """A random picture (H, W, 3) uint8 that is smooth enough to be sampled anywhere."""
    noise = np.random.default_rng(seed).random((size[1], size[0], 3)).astype(np.float32)
    blurred = sum(cv2.GaussianBlur(noise, (0, 0), sigma) * sigma for sigma in (2.5, 8.0))
    return cv2.normalize(blurred, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def seen(image1: np.ndarray, homography: np.ndarray = H) -> np.ndarray:
    """Image 2 of the plane that image 1 shows."""
    return cv2.warpPerspective(image1, homography, SIZE2, flags=cv2.INTER_LINEAR)


def write_sequence(folder: Path, count: int = 6) -> Path:
    """HPatches: 1.ppm to `count`.ppm with H_1_2 and on, all of them `H`."""
    folder.mkdir(parents=True)
    cv2.imwrite(str(folder / "1.ppm"), texture())
    for k in range(2, count + 1):
        cv2.imwrite(str(folder / f"{k}.ppm"), seen(texture()))
        np.savetxt(folder / f"H_1_{k}", H)
    return folder


def write_vgg(folder: Path) -> Path:
    """VGG: img1.png to img3.png with H1to2p and H1to3p."""
    folder.mkdir(parents=True)
    cv2.imwrite(str(folder / "img1.png"), texture())
    for k in (2, 3):
        cv2.imwrite(str(folder / f"img{k}.png"), seen(texture()))
        np.savetxt(folder / f"H1to{k}p", H)
    return folder


def write_annotated(folder: Path, *names: str) -> Path:
    """Pairs NAME_A.png, NAME_B.png, NAME_H.txt."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        cv2.imwrite(str(folder / f"{name}_A.png"), texture())
        cv2.imwrite(str(folder / f"{name}_B.png"), seen(texture()))
        np.savetxt(folder / f"{name}_H.txt", H)
    return folder
