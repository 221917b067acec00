"""The side of printed markers in images with known cameras and poses; and which markers the images
contradict, as those do that moved between the shots."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.geometry.epipolar import homogeneous

# A square's corners as shares of its middle and of two edges.
_CORNERS = np.array([[1, -0.5, -0.5], [1, 0.5, -0.5], [1, 0.5, 0.5], [1, -0.5, 0.5]])
_STEPS = 10  # of the fit of a square
_CORNER_PX = 0.2  # least error of a corner: print, blur and exposure move them together
_MAX_ERROR_PX = 2.0  # of a square's corners: this much
_MAX_ERROR = 0.03  # and this share of its side
_MAX_STD = 0.2  # relative, of a side
_SHOWN = 3  # markers that an error names
# Limits of sides of one size: the larger counts
_MAX_RATIO = 1.05
_DEVIATIONS = 3.0
_OTHER_SIZE = 1.5  # ratio above which markers have different sizes; below it, one has moved
# The points around a marker. It is in front of them or behind them if most differ from its plane to
# the same side. Chosen on a rendered scene.
_INNER = 0.65  # least distance from its middle, in sides
_OUTER = 4.0  # largest distance
_MIN_AROUND = 12  # least number
_NEAREST = 40  # number of the nearest ones in an image
_DIFFERS = 0.03  # share of the depth
_MOST = 0.75  # least share of the points


class _View(NamedTuple):
    """A marker in an image."""

    image: int
    equations: np.ndarray  # (4, 2, 4), of the corners: pixels times depths
    axis: np.ndarray  # (4,), of depths
    side_px: float


class _Fit(NamedTuple):
    """A marker as a square."""

    side: float
    std: float  # relative
    square: np.ndarray  # (9,), the middle and two edges
    views: list[_View]  # that agree


@dataclass(frozen=True)
class MarkerSide:
    """The side of markers, in the unit of the poses."""

    side: float
    std: float | None  # relative standard deviation; None if the points around contradict it
    images: Mapping[str, int]  # by marker, the number of images in which it was measured
    warnings: tuple[str, ...] = ()  # what contradicts a marker, for people


def marker_side(
    corners: Sequence[Mapping[str, np.ndarray]],
    cameras: Sequence[Camera],
    poses: Sequence[np.ndarray],
    around: Sequence[tuple[np.ndarray, np.ndarray]] = (),
) -> MarkerSide:
    """The side of the markers that two or more images show.

    corners: of each image, (4, 2) by marker, pixels. poses: cam_from_world (3, 4). around: of each
    image, normalised points (N, 2) and their depths (N,), unit of the poses. A marker counts if its
    corners are a square under the poses of most of its images, if it has the side of most markers,
    and if points around lie on its plane; a warning names any other. A marker in front of all
    points around counts if no other does, without a deviation: it may stand out or have moved. One
    behind them has moved.

    Raises InputError if no marker counts, or if markers differ in size.
    """
    views = defaultdict[str, list[_View]](list)
    for image, (shown, camera, pose) in enumerate(zip(corners, cameras, poses, strict=True)):
        for name, pixels in shown.items():
            points = camera.normalise(pixels)
            if np.isfinite(points).all():
                equations = camera.focal * (points[:, :, None] * pose[2] - pose[:2])
                side_px = float(np.linalg.norm(pixels - np.roll(pixels, 1, 0), axis=1).mean())
                views[name].append(_View(image, equations, pose[2], side_px))
    fits = dict[str, _Fit]()
    doubts = dict[str, str]()  # by marker: what contradicts it
    for name, seen in views.items():
        if len(seen) < 2:
            continue
        fit = _fit(seen)
        agreeing = 0 if fit is None else len(fit.views)
        if fit is not None and 2 * agreeing > len(seen):
            fits[name] = fit
        if agreeing < len(seen):
            doubts[name] = f"is a square under the poses of {agreeing} of its {len(seen)} images"
    off = {name: _off_around(fit, poses, around) for name, fit in fits.items()}
    for name, share in off.items():
        if share:
            where = "farther" if share > 0 else "nearer"
            doubts[name] = f"is {100 * abs(share):.0f} % {where} than the points around it"
    on_plane = {name: fit for name, fit in fits.items() if not off[name]}
    counted = on_plane or {name: fit for name, fit in fits.items() if off[name] < 0}
    if not counted:
        needed = f"needs a marker in two of the {len(corners)} images"
        why = "; ".join([f"{name} {doubt}" for name, doubt in doubts.items()][:_SHOWN])
        raise InputError(ArgumentName("marker"), f"{needed}: {why}" if why else needed)
    counted = _equally_large(counted, doubts)
    sides = np.array([fit.side for fit in counted.values()])
    information = np.array([fit.std for fit in counted.values()]) ** -2
    side = np.average(sides, weights=information)
    scatter = np.average((sides / side - 1) ** 2, weights=information) / max(1, len(sides) - 1)
    std = float(np.sqrt(max(1 / information.sum(), scatter))) if on_plane else None
    use = "it is used" if on_plane else "it is used, without a stated error"
    warnings = [
        f"marker {name} {doubt}: {use if name in counted else 'it is not used'}"
        for name, doubt in doubts.items()
    ]
    images = {name: len(fit.views) for name, fit in counted.items()}
    return MarkerSide(float(side), std, images, tuple(warnings))


def _equally_large(fits: Mapping[str, _Fit], doubts: dict[str, str]) -> dict[str, _Fit]:
    """The markers that have the side of most; adds the doubt about any other. Raises InputError if
    most differ, or if one has another size."""
    ordered = sorted(fits.items(), key=lambda item: item[1].side)
    middle_name, middle = ordered[(len(ordered) - 1) // 2]
    good = {}
    for name, fit in ordered:
        ratio = fit.side / middle.side
        doubt = _DEVIATIONS * float(np.hypot(fit.std, middle.std))
        if max(ratio, 1 / ratio) <= max(_MAX_RATIO, 1 + doubt):
            good[name] = fit
        else:
            doubts[name] = f"is {ratio:.3g} times as large as {middle_name}"
    smallest, low = ordered[0]
    largest, high = ordered[-1]
    ratio = high.side / low.side
    if 2 * len(good) <= len(fits) or (len(good) < len(fits) and ratio > _OTHER_SIZE):
        sizes = f"{largest} is {ratio:.3g} times as large as {smallest}"
        raise InputError(ArgumentName("marker"), f"needs markers of one size, and {sizes}")
    return good


def _off_around(
    fit: _Fit, poses: Sequence[np.ndarray], around: Sequence[tuple[np.ndarray, np.ndarray]]
) -> float:
    """Depth of a marker's plane over that of the points around it, less 1, their median; 0 unless
    the marker is in front of most points or behind them."""
    off = [np.empty(0)]
    for view in fit.views if around else ():
        pose = poses[view.image]
        points, depths = around[view.image]
        middle, u, v = fit.square.reshape(3, 3) @ pose[:, :3].T
        middle = middle + pose[:, 3]
        rays = homogeneous(points)
        normal = np.cross(u, v)
        with np.errstate(divide="ignore", invalid="ignore"):  # rays along the plane
            plane = (normal @ middle) / (rays @ normal)
            offset = rays * plane[:, None] - middle
            distance = np.abs(offset @ np.column_stack([u, v])).max(1) / (u @ u)
            usable = (plane > 0) & (distance > _INNER) & (distance < _OUTER)
        near = [k for k in np.argsort(distance) if usable[k]][:_NEAREST]
        off.append(plane[near] / depths[near] - 1)
    every = np.concatenate(off)
    one_side = max(np.mean(every > _DIFFERS), np.mean(every < -_DIFFERS)) if len(every) else 0.0
    is_off = len(every) >= _MIN_AROUND and one_side > _MOST
    return float(np.median(every)) if is_off else 0.0


def _fit(seen: list[_View]) -> _Fit | None:
    """A marker without the images whose corners are off; None if the corners are not a square."""
    while len(seen) > 1:
        square, std, errors = _square(seen)
        sides_px = np.array([view.side_px for view in seen])
        errors = errors / (_MAX_ERROR_PX + _MAX_ERROR * sides_px)
        if errors.max() <= 1:
            std = float(np.hypot(std, _CORNER_PX / sides_px.max()))
            side = float(np.linalg.norm(square[3:6]))
            return _Fit(side, std, square, seen) if std < _MAX_STD else None
        seen = [view for n, view in enumerate(seen) if n != errors.argmax()]
    return None


def _square(seen: Sequence[_View]) -> tuple[np.ndarray, float, np.ndarray]:
    """The square (9,) of least error, the relative deviation of its side, and the errors (V,) of
    the images: root mean squares in pixels, infinite behind a camera.

    x (9,) is the middle and two edges u and v. G x = 0 makes the edges equally long and
    perpendicular; G depends on x.
    """
    equations = np.stack([view.equations for view in seen])
    axes = np.stack([view.axis for view in seen])
    rows = np.einsum("ck,vcij->vcikj", _CORNERS, equations[..., :3]).reshape(-1, 4, 2, 9)
    x = np.zeros(9)
    z = np.ones((len(axes), 4))
    for _ in range(_STEPS):
        weights = 1 / np.where(z > 0, z, 1)[..., None]
        A = (rows * weights[..., None]).reshape(-1, 9)
        b = (equations[..., 3] * weights).ravel()
        inverse = np.linalg.pinv(A.T @ A)
        u, v = x[3:].reshape(2, 3)
        G = np.array([[0, 0, 0, *u, *-v], [0, 0, 0, *v, *u]])
        gain = inverse @ G.T @ np.linalg.pinv(G @ inverse @ G.T)
        free = -inverse @ A.T @ b
        x = free - gain @ G @ (free - x / 2)
        z = axes[:, :3] @ (_CORNERS @ x.reshape(3, 3)).T + axes[:, 3:]
    squares = (A @ x + b).reshape(-1, 8) ** 2
    side = np.linalg.norm(x[3:6])
    slope = np.array([0, 0, 0, *x[3:6], 0, 0, 0]) / side**2
    variance = max(squares.sum() / (squares.size - 7), _CORNER_PX**2)
    std = np.sqrt(variance * slope @ (inverse - gain @ G @ inverse) @ slope)
    errors = np.where((z > 0).all(1), np.sqrt(2 * squares.mean(1)), np.inf)
    return x, float(std), errors
