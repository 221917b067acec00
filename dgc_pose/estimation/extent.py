"""Whether the points of matches can be pixels of the image that their camera is of."""

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.estimation.problem import image_size

_SLACK = 1.4  # of the image's sides, where its size is that of a principal point in the middle
_MOST_OUTSIDE = 0.05  # share of the points
_LEAST_REACH = 0.5  # of the sides, along one of them; of 172 real pairs 0.63 and more
_MIN_POINTS = 20  # fewer are no pose


def odd_extent(points: np.ndarray, camera: Camera, number: int) -> tuple[str, ...]:
    """A warning if points (N, 2), pixels, lie beyond the image of camera 1 or 2 or reach a small
    part of it alone. Raises InputError if more than a few lie outside the camera's size."""
    points = points[np.isfinite(points).all(1)]
    size = np.array(image_size(camera))
    if len(points) < _MIN_POINTS or size.min() <= 1:
        return ()
    (left, top), (right, bottom) = points.min(0), points.max(0)
    by, slack = ("", 1.0) if camera.size else (", by 2 cx + 1 and 2 cy + 1", _SLACK)
    # Half a pixel beyond an edge may be another convention.
    outside = (np.abs(points - (size - 1) / 2) > (slack * size + 1) / 2).any(1)
    reach = (
        f"points{number} have x from {left:.0f} to {right:.0f} and y from {top:.0f} to {bottom:.0f}"
    )
    pixels = f"the {size[0]:.0f} x {size[1]:.0f} pixels of camera{number}{by}"
    if outside.mean() > _MOST_OUTSIDE:
        text = f"{reach}: {outside.sum()} of {len(points)} lie outside {pixels}"
        if camera.size:
            raise InputError(text)
        return (text,)
    if max((right, bottom) / size) < _LEAST_REACH:
        return (f"{reach}: less than half of {pixels} along both sides",)
    return ()
