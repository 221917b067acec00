"""The size of markers that images of known cameras and poses show."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.geometry.square import fitted_square

_CORNER_PX = 0.2  # least error of a corner: print, blur and exposure move them together
_MAX_ERROR_PX, _MAX_ERROR = 2.0, 0.03  # of corners of a square; and as a share of its side
_MAX_STD = 0.2  # relative, of a side
_MAX_RATIO, _DEVIATIONS = 1.05, 3.0  # of sides that are one size


@dataclass(frozen=True)
class MarkerSide:
    """The side of markers, in the unit of the poses."""

    side: float
    std: float  # relative standard deviation
    images: Mapping[str, int]  # by marker the number of images that it was measured in


_View = tuple[np.ndarray, np.ndarray, float, float]  # corners (4, 2), pose, focal and side in px


def marker_side(
    corners: Sequence[Mapping[str, np.ndarray]],
    cameras: Sequence[Camera],
    poses: Sequence[np.ndarray],
) -> MarkerSide:
    """The side of the markers that two or more images show.

    corners: of each image, by `find_markers`. poses: cam_from_world (3, 4). A marker counts if its
    corners are a square under the poses; images that contradict the others are left out. Raises
    InputError if there is none, or if markers differ in size.
    """
    views = defaultdict[str, list[_View]](list)
    for of_image, camera, pose in zip(corners, cameras, poses, strict=True):
        for name, pixels in of_image.items():
            points = camera.normalise(pixels)
            if np.isfinite(points).all():
                side_px = np.linalg.norm(pixels - np.roll(pixels, 1, axis=0), axis=1).mean()
                views[name].append((points, pose, camera.focal, float(side_px)))
    fits = {name: fit for name, seen in views.items() if (fit := _fit(seen)) is not None}
    if not fits:
        count = sum(len(seen) > 1 for seen in views.values())
        shown = f"needs a marker, and two or more of the {len(corners)} images show {count}"
        squares = ", none a square under the poses" if count else ""
        raise InputError(ArgumentName("marker"), shown + squares)
    by_size = sorted(fits, key=lambda name: fits[name][0])
    small, large = by_size[0], by_size[-1]
    sides, stds, counts = map(np.array, zip(*fits.values(), strict=True))
    ratio = fits[large][0] / fits[small][0]
    if ratio > max(_MAX_RATIO, 1 + _DEVIATIONS * np.hypot(fits[large][1], fits[small][1])):
        sizes = f"{large} is {ratio:.3g} times as large as {small}"
        raise InputError(ArgumentName("marker"), f"needs markers of one size, and {sizes}")
    weights = stds**-2 / (stds**-2).sum()
    side = weights @ sides
    scatter = weights @ (sides / side - 1) ** 2 / max(1, len(sides) - 1)
    std = np.sqrt(max(1 / (stds**-2).sum(), scatter))
    return MarkerSide(float(side), float(std), dict(zip(fits, counts.tolist(), strict=True)))


def _fit(seen: Sequence[_View]) -> tuple[float, float, int] | None:
    """The side of a marker, its relative deviation and the number of images, without those whose
    corners are off; None if the corners are no square."""
    while len(seen) > 1:
        points, poses, focals, sides_px = map(np.stack, zip(*seen, strict=True))
        side, std, errors = fitted_square(points, poses, focals, _CORNER_PX)
        errors = errors / (_MAX_ERROR_PX + _MAX_ERROR * sides_px)
        if errors.max() <= 1:
            std = float(np.hypot(std, _CORNER_PX / sides_px.max()))
            return (side, std, len(seen)) if std < _MAX_STD else None
        seen = [view for n, view in enumerate(seen) if n != errors.argmax()]
    return None
