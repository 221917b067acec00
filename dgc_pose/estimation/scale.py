"""The length of t, from depth maps, markers or the distance of the cameras."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.formats.keyed import numbers
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.estimation.depth_length import (
    Rays,
    length_by_depths,
    ray_probability,
    secants,
)
from dgc_pose.estimation.marker_side import marker_side
from dgc_pose.estimation.result import RelativePose
from dgc_pose.estimation.status import percent_text
from dgc_pose.geometry.epipolar import depths
from dgc_pose.geometry.sampling import bilinear_at
from dgc_pose.images.depth import read_depth
from dgc_pose.images.image import Image
from dgc_pose.images.markers import MAX_SIDE, shared_markers
from dgc_pose.matches import Matches
from dgc_pose.system.options import check_options, option

_BASELINE = "METRES[,STD]"
_CONTRADICTS = 3.0  # scatter of single lengths, in deviations, above which the depth is doubted
_SURE = 0.8  # probability of distances along the rays, above which depths are converted to z
_source = partial(option, None, type=str, section="scale")
_Depth = str | Path | np.ndarray | None
_Numbers = str | tuple[float, ...] | None


@dataclass(frozen=True, eq=False)
class ScaleSource:
    """The source of the length of t: depth maps, `baseline` or `marker`.

    Raises InputError, naming the field, for a value out of range, and for two sources.

    Attributes:
        depth1: Depth map of image 1 or its file, see `dgc_pose.images.depth.read_depth`.
        depth2: Depth map of image 2 or its file, with or without `depth1`.
        depth_std: Relative standard deviation of depths: of each, and of their common scale.
        baseline: The length, metres, and optionally its standard deviation; or both as a text.
        marker: Side, metres, of the ArUco or AprilTag markers that both images show.
    """

    depth1: _Depth = _source("Depth map of image 1: PNG in mm; TIFF, .npy in m.", metavar="FILE")
    depth2: _Depth = _source("Depth map of image 2.", metavar="FILE")
    depth_std: float = option(
        0.02, "Relative deviation of depths.", metavar="STD", above=0, max=1, section="scale"
    )
    baseline: _Numbers = _source("Distance between the cameras.", metavar=_BASELINE)
    marker: float | None = _source(
        "Side of ArUco or AprilTag markers.",
        metavar="METRES",
        type=float,
        above=0,
        max=MAX_SIDE,
        unit=" metres",
    )

    def __post_init__(self) -> None:
        check_options(self)
        sources = ("depth1", "depth2", "baseline", "marker")
        names = [name for name in sources if getattr(self, name) is not None]
        if len(names) > 1 and names != ["depth1", "depth2"]:
            first, *_, last = map(ArgumentName, names)
            raise InputError(first, "and", last, "both determine the length of t: give only one")
        if self.baseline is None:
            return
        lengths = numbers(self.baseline) or [0.0]
        if len(lengths) > 2 or min(lengths) <= 0 or not np.isfinite(lengths).all():
            form = f"must be {_BASELINE}, lengths above 0"
            raise InputError(ArgumentName("baseline"), f"{form}, not {self.baseline!r}")

    def maps(self, images: Sequence[Image]) -> list[np.ndarray | None]:
        """The depth maps of two images, by `read_depth`; None without a source."""
        sources = zip((self.depth1, self.depth2), ("depth1", "depth2"), images, strict=True)
        return [
            read_depth(source, name, image.size, image.exif.orientation)
            for source, name, image in sources
        ]

    def markers(self, images: Sequence[Image]) -> list[dict[str, np.ndarray]]:
        """The markers in two images, by `shared_markers`; none without `marker`."""
        if not self.marker:
            return []
        named = {f"image {number}": image.pixels for number, image in enumerate(images, start=1)}
        return [*shared_markers(named).values()]


def with_length(
    pose: RelativePose,
    matches: Matches,
    scale: ScaleSource,
    maps: Sequence[np.ndarray | None],
    markers: Sequence[Mapping[str, np.ndarray]] = (),
) -> RelativePose:
    """The pose with the length of its t; unchanged without a pose or a source.

    The length is the median, over the inliers, of the known depth divided by the depth for a unit
    t; `marker` works in the same way. matches: of the pose. maps, markers: from `scale`. Depths
    that the matches show to be distances along the rays are converted, with a warning; `length_std`
    covers the doubt. A warning states that the matches contradict the depths, that depths are too
    few, or that the images contradict a marker, see `marker_side`.
    """
    if pose.R is None or pose.t is None or pose.camera1 is None or pose.camera2 is None:
        return pose
    baseline = numbers(scale.baseline)
    if baseline:
        return replace(pose, length=baseline[0], length_std=[*baseline, None][1])
    if not markers and all(inverse is None for inverse in maps):
        return pose
    cameras = pose.camera1, pose.camera2
    points = matches.points1[pose.inliers], matches.points2[pose.inliers]
    rays = cameras[0].normalise(points[0]), cameras[1].normalise(points[1])
    deviating = _deviating(pose)
    warnings = pose.warnings
    try:
        if markers:
            source = _marker_source(rays, cameras, markers, scale.marker or 0.0, pose.R, pose.t)
        else:
            z = np.array([_depths_at(*pair) for pair in zip(maps, points, strict=True)])
            source = _depth_source(rays, z, scale.depth_std, (pose.R, pose.t), deviating)
        warnings += source.warnings
        length, own, scatter = source.measure(pose.R, pose.t)
        moved = [source.measure(R, t)[0] - length for R, t in deviating]
    except InputError as error:
        return replace(pose, warnings=(*warnings, f"the length of t is not known: {error}"))
    # The focal lengths scale the angles that depths are triangulated from.
    stds = own, *moved, *(length * camera.focal_std for camera in cameras)
    if scatter > _CONTRADICTS:
        off = f"lengths scatter by {scatter:.1f} times their deviations"
        warnings += (f"the matches contradict the depth map: {off}",)
    is_sure = source.is_sure and pose.covariance is not None and scatter <= _CONTRADICTS
    std = math.hypot(*stds) if is_sure else None
    return replace(pose, length=length, length_std=std, warnings=warnings)


class _Source(NamedTuple):
    """What gives the length."""

    # Of R and t: the length, its deviation, and the scatter of single lengths in their deviations.
    measure: Callable[[np.ndarray, np.ndarray], tuple[float, float, float]]
    warnings: tuple[str, ...] = ()
    is_sure: bool = True  # whether the deviation is known


def _depth_source(
    rays: Rays,
    z: np.ndarray,
    depth_std: float,
    pose: tuple[np.ndarray, np.ndarray],
    deviating: Sequence[tuple[np.ndarray, np.ndarray]],
) -> _Source:
    """Depths (2, N) of the inliers, NaN if unknown; converted to z if they are distances along the
    rays."""
    likely = ray_probability(rays, z, depth_std, pose, deviating)
    if likely <= _SURE:
        return _Source(partial(length_by_depths, rays, z, depth_std, likely))
    kind = "the depths are distances along the rays, not z along the optical axis"
    warning = f"{kind}, with a probability of {percent_text(likely)}: converted to z"
    along_axis = z / secants(rays)
    return _Source(partial(length_by_depths, rays, along_axis, depth_std, 1 - likely), (warning,))


def _marker_source(
    rays: Rays,
    cameras: Sequence[Camera],
    markers: Sequence[Mapping[str, np.ndarray]],
    metres: float,
    R: np.ndarray,
    t: np.ndarray,
) -> _Source:
    """The markers that the inliers do not contradict. Raises InputError if there are none."""
    poses = np.eye(3, 4), np.column_stack([R, t])
    around = [*zip(rays, depths(*rays, R, t), strict=True)]
    found = marker_side(markers, cameras, poses, around)
    used = [{name: shown[name] for name in found.images} for shown in markers]
    measure = partial(_by_marker, used, cameras, metres)
    return _Source(measure, found.warnings, found.std is not None)


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


def _by_marker(
    markers: Sequence[Mapping[str, np.ndarray]],
    cameras: Sequence[Camera],
    metres: float,
    R: np.ndarray,
    t: np.ndarray,
) -> tuple[float, float, float]:
    """The measure of the side of markers."""
    found = marker_side(markers, cameras, (np.eye(3, 4), np.column_stack([R, t])))
    return metres / found.side, metres / found.side * (found.std or 0.0), 0.0
