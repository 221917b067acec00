"""The length of t, from depth maps, markers, the distance of the cameras or a distance in the
scene; and the size of markers in images with known cameras and poses."""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.formats.keyed import numbers
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.estimation.depth_length import (
    inverse_depths,
    length_by_depths,
    ray_probability,
    secants,
)
from dgc_pose.estimation.least_squares import DEVIATION
from dgc_pose.estimation.problem import cell_side
from dgc_pose.estimation.result import RelativePose
from dgc_pose.estimation.status import percent_text
from dgc_pose.geometry.epipolar import homogeneous
from dgc_pose.geometry.sampling import bilinear_at
from dgc_pose.images.depth import read_depth
from dgc_pose.images.image import Image
from dgc_pose.images.markers import find_markers
from dgc_pose.matches import Matches
from dgc_pose.system.options import check_options, option

_FORMS = {"baseline": "METRES[,STD]", "distance": "X1,Y1,X2,Y2,METRES"}
_CONTRADICTS = 3.0  # scatter of single lengths, in deviations, above which the depth is doubted
_SURE = 0.8  # probability of distances along the rays, above which depths are converted to z
_MIN_NEAR, _NEAREST = 3, 9  # least and largest number of inliers for the depth at a point
# A square's corners as shares of its middle and of two edges.
_CORNERS = np.array([[1, -0.5, -0.5], [1, 0.5, -0.5], [1, 0.5, 0.5], [1, -0.5, 0.5]])
_STEPS = 10  # of the fit of a square
_CORNER_PX = 0.2  # least error of a corner: print, blur and exposure move them together
_MAX_ERROR_PX, _MAX_ERROR = 2.0, 0.03  # of a square's corners: a constant plus a share of its side
_MAX_STD = 0.2  # relative, of a side
_MAX_RATIO, _DEVIATIONS = 1.05, 3.0  # of sides of one size: the larger of both is the limit
_source = partial(option, None, type=str, section="scale")
_Depth = str | Path | np.ndarray | None
_Numbers = str | tuple[float, ...] | None
# For an image: equations (4, 2, 4) of corners, pixels times depths; axis (4,) of depths; side, px.
_View = tuple[np.ndarray, np.ndarray, float]


@dataclass(frozen=True, eq=False)
class ScaleSource:
    """The source of the length of t: depth maps, or one of `baseline`, `distance`, `marker`.

    Raises InputError, naming the field, for a value out of range, and for two sources.

    Attributes:
        depth1: Depth map of image 1 or its file, see `dgc_pose.images.depth.read_depth`.
        depth2: Depth map of image 2 or its file, with or without `depth1`.
        depth_std: Relative standard deviation of depths: of each, and of their common scale.
        baseline: The length, metres, and optionally its standard deviation; or both as a text.
        distance: x1, y1, x2, y2, pixels of two points of the upright image 1, and the metres
            between them; or all as a text.
        marker: Side, metres, of the ArUco or AprilTag markers that both images show.
    """

    depth1: _Depth = _source("Depth map of image 1: PNG in mm; TIFF, .npy in m.", metavar="FILE")
    depth2: _Depth = _source("Depth map of image 2.", metavar="FILE")
    depth_std: float = option(
        0.02, "Relative deviation of depths.", metavar="STD", above=0, max=1, section="scale"
    )
    baseline: _Numbers = _source("Distance between the cameras.", metavar=_FORMS["baseline"])
    distance: _Numbers = _source("Distance of two points of image 1.", metavar=_FORMS["distance"])
    marker: float | None = _source(
        "Side of ArUco or AprilTag markers.", metavar="METRES", type=float, above=0
    )

    def __post_init__(self) -> None:
        check_options(self)
        names = [n for n in ("depth1", "depth2", *_FORMS, "marker") if getattr(self, n) is not None]
        if len(names) > 1 and names != ["depth1", "depth2"]:
            first, *_, last = map(ArgumentName, names)
            raise InputError(first, "and", last, "both determine the length of t: give only one")
        for name, counts, n in ("baseline", (1, 2), 0), ("distance", (5,), 4):
            value, values = getattr(self, name), numbers(getattr(self, name)) or [0.0]
            is_length = len(values) in counts and min(values[n:]) > 0 and np.isfinite(values).all()
            if value is not None and not is_length:
                form = f"must be {_FORMS[name]}, lengths above 0"
                raise InputError(ArgumentName(name), f"{form}, not {value!r}")
            if name == "distance" and value is not None and values[:2] == values[2:4]:
                raise InputError(ArgumentName(name), "has the same point twice")

    def maps(self, images: Sequence[Image]) -> list[np.ndarray | None]:
        """The depth maps of two images, by `read_depth`; None without a source."""
        sources = zip((self.depth1, self.depth2), ("depth1", "depth2"), images, strict=True)
        return [
            read_depth(source, name, image.size, image.exif.orientation)
            for source, name, image in sources
        ]

    def markers(self, images: Sequence[Image]) -> list[dict[str, np.ndarray]]:
        """The markers in two images, by `find_markers`; none without `marker`. Raises InputError,
        naming `marker`, if the images have no marker in common."""
        found = [find_markers(image.pixels) for image in images if self.marker]
        if found and not found[0].keys() & found[1].keys():
            shown = [", ".join(sorted(of)) or "none" for of in found]
            both = f"must be in both images: image 1 shows {shown[0]}, image 2 {shown[1]}"
            raise InputError(ArgumentName("marker"), both)
        return found


def with_length(
    pose: RelativePose,
    matches: Matches,
    scale: ScaleSource,
    maps: Sequence[np.ndarray | None],
    markers: Sequence[Mapping[str, np.ndarray]] = (),
) -> RelativePose:
    """The pose with the length of its t; unchanged without a pose or a source.

    The length is the median, over the inliers, of the known depth divided by the depth for a unit
    t; `distance` and `marker` work in the same way. matches: of the pose. maps, markers: from
    `scale`. Depths that the matches show to be distances along the rays are converted, with a
    warning; `length_std` covers the doubt. A warning states that the matches contradict the depths,
    that depths or inliers near a point of `distance` are too few, or that markers are not squares
    of one size.
    """
    if pose.R is None or pose.t is None or pose.camera1 is None or pose.camera2 is None:
        return pose
    baseline, distance = numbers(scale.baseline), numbers(scale.distance)
    if baseline:
        return replace(pose, length=baseline[0], length_std=[*baseline, None][1])
    if not distance and not markers and all(of is None for of in maps):
        return pose
    cameras = pose.camera1, pose.camera2
    points = matches.points1[pose.inliers], matches.points2[pose.inliers]
    rays = cameras[0].normalise(points[0]), cameras[1].normalise(points[1])
    deviating, warnings = _deviating(pose), pose.warnings
    if distance:
        measure = partial(_by_distance, rays, cameras[0], distance)
    elif markers:
        measure = partial(_by_marker, markers, cameras, scale.marker or 0.0)
    else:
        z = np.array([_depths_at(*pair) for pair in zip(maps, points, strict=True)])
        likely = ray_probability(rays, z, scale.depth_std, (pose.R, pose.t), deviating)
        doubt = likely
        if likely > _SURE:
            z = z / secants(rays)
            doubt = 1 - likely
            kind = "the depths are distances along the rays, not z along the optical axis"
            warnings += (f"{kind}, with a probability of {percent_text(likely)}: converted to z",)
        measure = partial(length_by_depths, rays, z, scale.depth_std, doubt)
    try:
        length, own, scatter = measure(pose.R, pose.t)
        moved = [measure(R, t)[0] - length for R, t in deviating]
    except InputError as error:
        warning = f"the length of t is not known: {error}"
        return replace(pose, warnings=(*warnings, warning))
    # The focal lengths scale the angles that depths are triangulated from.
    stds = own, *moved, *(length * camera.focal_std for camera in cameras)
    if scatter > _CONTRADICTS:
        off = f"lengths scatter by {scatter:.1f} times their deviations"
        warnings += (f"the matches contradict the depth map: {off}",)
    sure = pose.covariance is not None and scatter <= _CONTRADICTS
    std = math.hypot(*stds) if sure else None
    return replace(pose, length=length, length_std=std, warnings=warnings)


def _depths_at(inverse: np.ndarray | None, points: np.ndarray) -> np.ndarray:
    """Depths (N,) at points (N, 2) of an image, from its inverse depths; NaN if unknown."""
    if inverse is None:
        return np.full(len(points), np.nan)
    known: np.ndarray = 1 / bilinear_at(inverse, *points.T[:, :, None])[:, 0]
    return known


def _deviating(pose: RelativePose) -> list[tuple[np.ndarray, np.ndarray]]:
    """R and unit t one standard deviation off the pose, in each direction except along t."""
    if pose.covariance is None:
        return []
    values, vectors = np.linalg.eigh(pose.covariance)
    poses = []
    for step in (vectors * np.sqrt(values.clip(min=0))).T[1:]:
        t = pose.t + step[3:]
        poses.append((cv2.Rodrigues(step[:3])[0] @ pose.R, t / np.linalg.norm(t)))
    return poses


def _by_distance(
    rays: tuple[np.ndarray, np.ndarray],
    camera1: Camera,
    distance: Sequence[float],
    R: np.ndarray,
    t: np.ndarray,
) -> tuple[float, float, float]:
    """As `length_by_depths`, from a distance in the scene, see `ScaleSource`. Raises InputError if
    too few inliers are near one of its points."""
    inverse, std = inverse_depths(*rays, R, t)
    ends, radius = camera1.normalise(np.reshape(distance[:4], (2, 2))), cell_side(camera1)
    points, off = homogeneous(ends), np.zeros((2, 3))
    for n, end in enumerate(ends):
        away = np.linalg.norm(rays[0] - end, axis=1)
        near = [k for k in np.argsort(away)[:_NEAREST] if away[k] < radius]
        if len(near) < _MIN_NEAR:
            point = f"({distance[2 * n]:g}, {distance[2 * n + 1]:g})"
            count = f"{len(near)} inliers are within {radius * camera1.focal:.0f} pixels of {point}"
            raise InputError(count)
        middle = np.median(inverse[near])
        spread = DEVIATION * np.median(np.abs(inverse[near] - middle)) + np.median(std[near])
        points[n] /= middle
        off[n] = points[n] * spread / middle
    apart = points[0] - points[1]
    length = distance[4] / float(np.linalg.norm(apart))
    share = off @ apart / (apart @ apart)  # of the distance, by a deviation of each depth
    return length, length * float(np.linalg.norm(share)), 0.0


def _by_marker(
    markers: Sequence[Mapping[str, np.ndarray]],
    cameras: Sequence[Camera],
    metres: float,
    R: np.ndarray,
    t: np.ndarray,
) -> tuple[float, float, float]:
    """The same from the side of markers."""
    found = marker_side(markers, cameras, (np.eye(3, 4), np.column_stack([R, t])))
    return metres / found.side, metres / found.side * found.std, 0.0


@dataclass(frozen=True)
class MarkerSide:
    """The side of markers, in the unit of the poses."""

    side: float
    std: float  # relative standard deviation
    images: Mapping[str, int]  # by marker, the number of images in which it was measured


def marker_side(
    corners: Sequence[Mapping[str, np.ndarray]],
    cameras: Sequence[Camera],
    poses: Sequence[np.ndarray],
) -> MarkerSide:
    """The side of the markers that two or more images show.

    corners: of each image, by `find_markers`. poses: cam_from_world (3, 4). A marker counts if its
    corners are a square under the poses; images that contradict the others are dropped. Raises
    InputError if no marker counts, or if markers differ in size.
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
        raise InputError(ArgumentName("marker"), f"needs {words}")
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
    """The side of a marker, its relative deviation and the number of images, without images whose
    corners are off; None if the corners are not a square."""
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

    x (9,) is the middle and two edges u and v. G x = 0 makes the edges equally long and
    perpendicular; G depends on x.
    """
    rows = np.einsum("ck,vcij->vcikj", _CORNERS, equations[..., :3]).reshape(-1, 4, 2, 9)
    x, z = np.zeros(9), np.ones((len(axes), 4))
    for _ in range(_STEPS):
        weights = 1 / np.where(z > 0, z, 1)[..., None]
        A, b = (rows * weights[..., None]).reshape(-1, 9), (equations[..., 3] * weights).ravel()
        inverse, (u, v) = np.linalg.pinv(A.T @ A), x[3:].reshape(2, 3)
        G = np.array([[0, 0, 0, *u, *-v], [0, 0, 0, *v, *u]])
        gain = inverse @ G.T @ np.linalg.pinv(G @ inverse @ G.T)
        free = -inverse @ A.T @ b
        x = free - gain @ G @ (free - x / 2)
        z = axes[:, :3] @ (_CORNERS @ x.reshape(3, 3)).T + axes[:, 3:]
    squares, side = (A @ x + b).reshape(-1, 8) ** 2, np.linalg.norm(x[3:6])
    slope = np.array([0, 0, 0, *x[3:6], 0, 0, 0]) / side**2
    variance = max(squares.sum() / (squares.size - 7), _CORNER_PX**2)
    std = np.sqrt(variance * slope @ (inverse - gain @ G @ inverse) @ slope)
    errors = np.where((z > 0).all(1), np.sqrt(2 * squares.mean(1)), np.inf)
    return float(side), float(std), errors
