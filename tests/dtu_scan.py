"""A scan as DTU has it: grey images, and the calibration of views on an arc."""

import cv2
import numpy as np

from dgc_pose.cameras.camera import Camera

DEGREES = np.arange(49.0)  # of DTU's positions on an arc: views 1 and 2 differ by one degree
FIRST = [(24, 25), (28, 29), (3, 8)]  # pairs of scan65
SIZE = (160, 120)
# DTU's camera at a tenth of its size.
K = Camera(np.array([[2892.0, 0, 823], [0, 2883, 619], [0, 0, 1]]), (1600, 1200)).resized(SIZE).K


def write_scan(root, number=65, *, names="Rectified/scan{scan}/rect_{view:03d}_3_r5000.png"):
    """The calibration and the grey images of a scan, as DTU has them, of views that look at one
    point 650 mm away from `DEGREES` around it."""
    for view, angle in enumerate(np.radians(DEGREES), start=1):
        c, s = np.cos(angle), np.sin(angle)
        calibration = root / f"Calibration/cal18/pos_{view:03d}.txt"
        calibration.parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(calibration, K @ [[c, 0, -s, 0], [0, 1, 0, 0], [s, 0, c, 650]], fmt="%.17g")
        path = root / names.format(scan=number, view=view)
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), np.full((*SIZE[::-1], 3), 128, np.uint8))


def views_of(pairs):
    return [tuple(int(n.split("_")[1]) for n in (p.name1, p.name2)) for p in pairs]
