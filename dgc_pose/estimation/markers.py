"""The size of markers that images of known cameras and poses show."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import ArgumentName, InputError

# A square's corners as shares of its middle and of two edges.
_CORNERS = np.array([[1, -0.5, -0.5], [1, 0.5, -0.5], [1, 0.5, 0.5], [1, -0.5, 0.5]])
_STEPS = 10  # of the fit of a square
_CORNER_PX = 0.2  # least error of a corner: print, blur and exposure move them together
_MAX_ERROR_PX, _MAX_ERROR = 2.0, 0.03  # of corners of a square; and as a share of its side
_MAX_STD = 0.2  # relative, of a side
_MAX_RATIO, _DEVIATIONS = 1.05, 3.0  # of sides that are one size

# An image's equations (4, 2, 4) of the corners, pixels times depths; axis (4,) of depths; side, px.
_View = tuple[np.ndarray, np.ndarray, float]


@dataclass(frozen=True)
class MarkerSide:
    """The side of markers, in the unit of the poses."""

    side: float
    std: float  # relative standard deviation
    images: Mapping[str, int]  # by marker the number of images that it was measured in


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
                equations = camera.focal * (points[:, :, None] * pose[2] - pose[:2])
                side_px = float(np.linalg.norm(pixels - np.roll(pixels, 1, 0), axis=1).mean())
                views[name].append((equations, pose[2], side_px))
    fits = {name: fit for name, seen in views.items() if (fit := _fit(seen))}
    if not fits:
        both = f"a marker in two of the {len(corners)} images"
        seen_twice = any(len(seen) > 1 for seen in views.values())
        words = f"{both} that is a square under the poses" if seen_twice else both
        raise InputError(ArgumentName("marker"), f"needs {words}: there is none")
    names, (sides, stds, counts) = [*fits], np.array([*fits.values()]).T
    low, high = sides.argmin(), sides.argmax()
    ratio = sides[high] / sides[low]
    if ratio > max(_MAX_RATIO, 1 + _DEVIATIONS * np.hypot(stds[low], stds[high])):
        sizes = f"{names[high]} is {ratio:.3g} times as large as {names[low]}"
        raise InputError(ArgumentName("marker"), f"needs markers of one size, and {sizes}")
    side = np.average(sides, weights=stds**-2)
    scatter = np.average((sides / side - 1) ** 2, weights=stds**-2) / max(1, len(sides) - 1)
    std = np.sqrt(max(1 / (stds**-2).sum(), scatter))
    return MarkerSide(float(side), float(std), dict(zip(names, map(int, counts), strict=True)))


def _fit(seen: Sequence[_View]) -> tuple[float, float, int] | None:
    """The side of a marker, its relative deviation and the number of images, without those whose
    corners are off; None if the corners are no square."""
    while len(seen) > 1:
        equations, axes, sides_px = map(np.stack, zip(*seen, strict=True))
        side, std, errors = _square(equations, axes)
        errors = errors / (_MAX_ERROR_PX + _MAX_ERROR * sides_px)
        if errors.max() <= 1:
            std = float(np.hypot(std, _CORNER_PX / sides_px.max()))
            return (side, std, len(seen)) if std < _MAX_STD else None
        seen = [view for n, view in enumerate(seen) if n != errors.argmax()]
    return None


def _square(equations: np.ndarray, axes: np.ndarray) -> tuple[float, float, np.ndarray]:
    """The side of the square of least error, its relative deviation, and the errors (V,) of the
    images: root mean squares in pixels, infinite behind a camera. equations, axes: see `_View`.

    x (9,) is the middle and two edges u and v. G x = 0 makes these as long as each other, and
    perpendicular; G depends on x.
    """
    rows = np.einsum("ck,vcij->vcikj", _CORNERS, equations[..., :3]).reshape(-1, 4, 2, 9)
    x, depths = np.zeros(9), np.ones((len(axes), 4))
    for _ in range(_STEPS):
        weights = 1 / np.where(depths > 0, depths, 1)[..., None]
        A, b = (rows * weights[..., None]).reshape(-1, 9), (equations[..., 3] * weights).ravel()
        inverse, (u, v) = np.linalg.pinv(A.T @ A), x[3:].reshape(2, 3)
        G = np.array([[0, 0, 0, *u, *-v], [0, 0, 0, *v, *u]])
        gain = inverse @ G.T @ np.linalg.pinv(G @ inverse @ G.T)
        free = -inverse @ A.T @ b
        x = free - gain @ G @ (free - x / 2)
        depths = axes[:, :3] @ (_CORNERS @ x.reshape(3, 3)).T + axes[:, 3:]
    squares, side = (A @ x + b).reshape(-1, 8) ** 2, np.linalg.norm(x[3:6])
    slope = np.array([0, 0, 0, *x[3:6], 0, 0, 0]) / side**2
    variance = max(squares.sum() / (squares.size - 7), _CORNER_PX**2)
    std = np.sqrt(variance * slope @ (inverse - gain @ G @ inverse) @ slope)
    errors = np.where((depths > 0).all(1), np.sqrt(2 * squares.mean(1)), np.inf)
    return float(side), float(std), errors
