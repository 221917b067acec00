"""Pictures of a box whose faces have rectangles on them, by a pinhole with square pixels."""

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

_COUNT = 14  # rectangles of a face
_FRACTION_BITS = 4  # of the coordinates of what is drawn


def box_picture(
    focal: float,
    turn_deg: tuple[float, float, float] = (30.0, 20.0, 3.0),
    size: tuple[int, int] = (960, 720),
    seed: int = 1,
) -> np.ndarray:
    """(H, W, 3) uint8. focal: over the longer side. turn_deg: of the box about y, x and z; the box
    fills about as much of the picture with any."""
    rng = np.random.default_rng(seed)
    picture = np.full(size[::-1], 128, np.uint8)
    R = Rotation.from_euler("yxz", turn_deg, degrees=True).as_matrix()
    centre = np.array([0, 0, max(3.0 * focal, 2.2)])  # of the box, whose sides are 2
    for axis, towards in enumerate(-R.T @ centre):
        low = rng.uniform(-0.95, 0.6, (_COUNT, 2))
        high = np.minimum(low + rng.uniform(0.15, 0.5, (_COUNT, 2)), 0.95)
        for (a, b), (c, d) in [((-1, -1), (1, 1)), *zip(low, high, strict=True)]:
            face = np.insert([[a, b], [c, b], [c, d], [a, d]], axis, np.sign(towards), axis=1)
            corners = face @ R.T + centre
            pixels = focal * max(size) * corners[:, :2] / corners[:, 2:]
            pixels += (np.array(size) - 1) / 2
            shade = int(rng.integers(256))
            if (corners[:, 2] > 0.05).all():
                drawn = np.round(pixels * 2**_FRACTION_BITS).astype(np.int32)
                cv2.fillPoly(picture, [drawn], shade, cv2.LINE_AA, _FRACTION_BITS)
    return grey(picture)


def grey(levels: np.ndarray) -> np.ndarray:
    """(H, W, 3) of levels (H, W) uint8."""
    return np.ascontiguousarray(np.broadcast_to(levels[..., None], (*levels.shape, 3)))
