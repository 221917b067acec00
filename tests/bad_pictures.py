"""Pictures that cannot be used, one of each kind, as they turn up among others in a list."""

from pathlib import Path

import cv2
import numpy as np

# By name, a word of the reason. MISSING is not written.
MISSING = "missing.jpg"
BAD_PICTURES = {
    "cut.jpg": "cannot be decoded",
    "header.jpg": "is corrupt",
    "text.jpg": "not an image of a known format",
    "empty.jpg": "empty",
    "clear.png": "alpha 0 everywhere",
    "tiny.png": "the picture has 3 x 3 pixels",
    "grey.png": "the grey levels differ by 0.00 (standard deviation), and 2 are needed",
    MISSING: "No such file or directory",
}


def write_bad_pictures(folder: Path, size: tuple[int, int] = (240, 180)) -> list[Path]:
    """Write the bad pictures. size: (width, height) of those that have one. Returns their paths,
    also that of the missing one."""
    noise = np.random.default_rng(0).integers(0, 256, (size[1] // 8, size[0] // 8, 3), np.uint8)
    pixels = cv2.resize(noise, size, interpolation=cv2.INTER_CUBIC)
    whole = cv2.imencode(".jpg", pixels)[1].tobytes()
    clear = np.dstack([pixels, 0 * pixels[:, :, :1]])
    contents = {
        "cut.jpg": whole[: len(whole) // 3],
        "header.jpg": whole[:100],
        "text.jpg": b"not a picture\n",
        "empty.jpg": b"",
        "clear.png": cv2.imencode(".png", clear)[1].tobytes(),
        "tiny.png": cv2.imencode(".png", pixels[:3, :3])[1].tobytes(),
        "grey.png": cv2.imencode(".png", np.full_like(pixels, 128))[1].tobytes(),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in contents.items():
        (folder / name).write_bytes(data)
    return [folder / name for name in BAD_PICTURES]
