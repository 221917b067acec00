"""The length of t, by depth maps, markers, the distance of the cameras or one in the scene."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.formats.keyed import numbers
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.estimation.least_squares import (
    DEVIATION,
    EFFICIENT,
    SHIFTS,
    block_sums,
    cauchy_curvature,
)
from dgc_pose.estimation.markers import marker_side
from dgc_pose.estimation.problem import cell_side
from dgc_pose.estimation.result import RelativePose
from dgc_pose.geometry.epipolar import depths, essential_from_pose, homogeneous, sampson_distance
from dgc_pose.geometry.sampling import bilinear_at
from dgc_pose.images.depth import read_depth
from dgc_pose.images.image import Image
from dgc_pose.images.markers import find_markers
from dgc_pose.matches import Matches
from dgc_pose.system.options import check_options, option

_FORMS = {"baseline": "METRES[,STD]", "distance": "X1,Y1,X2,Y2,METRES"}
_MIN_DEPTHS = 10  # inliers of known depth that a length needs
_CONTRADICTS = 3.0  # scatter of single lengths, in deviations, above which the depth is doubted
_CORRELATED = 30.0  # neighbouring depths: so many are worth one beside the pose's covariance
_MIN_NEAR, _NEAREST = 3, 9  # inliers that determine the depth at a point
_STEPS = 30  # of reweighted least squares
_UNKNOWN = np.full((1, 1), np.nan, np.float32)  # in place of a depth map
_source = partial(option, None, type=str, section="scale")
_Depth = str | Path | np.ndarray | None
_Numbers = str | tuple[float, ...] | None


@dataclass(frozen=True, eq=False)
class ScaleSource:
    """What determines the length of t: depth maps, or one of `baseline`, `distance`, `marker`.

    Raises InputError, naming the field, for a value out of range, and for two of them.

    Attributes:
        depth1: Depth map of image 1 or its file, see `dgc_pose.images.depth.read_depth`.
        depth2: Of image 2, with the other or alone.
        depth_std: Relative standard deviation of depths: of each, and of all in common.
        baseline: The length, metres, and its standard deviation if it is known, or a text of both.
        distance: x1, y1, x2, y2, pixels of two points of image 1 as the pose is of it, and the
            metres between them, or a text.
        marker: Side, metres, of the ArUco or AprilTag markers that both images show.
    """

    depth1: _Depth = _source("Depth map of image 1: PNG in mm; TIFF, .npy in m.", metavar="FILE")
    depth2: _Depth = _source("Depth map of image 2.", metavar="FILE")
    depth_std: float = option(
        0.02, "Relative deviation of depths.", metavar="STD", above=0, max=1, section="scale"
    )
    baseline: _Numbers = _source("Distance between the cameras.", metavar=_FORMS["baseline"])
    distance: _Numbers = _source("That of two points of image 1.", metavar=_FORMS["distance"])
    marker: float | None = _source(
        "Side of ArUco or AprilTag markers.", metavar="METRES", type=float, above=0
    )

    def __post_init__(self) -> None:
        check_options(self)
        names = [n for n in ("depth1", "depth2", *_FORMS, "marker") if getattr(self, n) is not None]
        if len(names) > 1 and names != ["depth1", "depth2"]:
            first, *_, last = map(ArgumentName, names)
            raise InputError(first, "and", last, "both tell the length of t, and one is needed")
        for name, counts, n in ("baseline", (1, 2), 0), ("distance", (5,), 4):
            value, values = getattr(self, name), numbers(getattr(self, name)) or [0.0]
            is_length = len(values) in counts and min(values[n:]) > 0 and np.isfinite(values).all()
            if value is not None and not is_length:
                form = f"must be {_FORMS[name]}, METRES and STD above 0"
                raise InputError(ArgumentName(name), f"{form}, not {value!r}")

    def maps(self, images: Sequence[Image]) -> list[np.ndarray | None]:
        """By `read_depth`, of two images."""
        sources = zip((self.depth1, self.depth2), ("depth1", "depth2"), images, strict=True)
        return [
            read_depth(source, name, image.size, image.exif.orientation)
            for source, name, image in sources
        ]

    def markers(self, images: Sequence[Image]) -> list[dict[str, np.ndarray]]:
        """By `find_markers`, of two images; none without `marker`. Raises InputError, naming it, if
        both images have no marker in common."""
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
    """The pose with the length of its t; as it is without a pose or a source.

    matches: those that the pose is of. maps, markers: of `scale`. A warning states depths that the
    matches contradict, and too few of them, too few inliers near a point of `distance`, or markers
    that are no squares of one size.
    """
    if pose.R is None or pose.t is None or pose.camera1 is None or pose.camera2 is None:
        return pose
    baseline, distance = numbers(scale.baseline), numbers(scale.distance)
    if baseline:
        return replace(pose, length=baseline[0], length_std=[*baseline, None][1])
    if not distance and not markers and all(inverse is None for inverse in maps):
        return pose
    points = matches.points1[pose.inliers], matches.points2[pose.inliers]
    x1, x2 = pose.camera1.normalise(points[0]), pose.camera2.normalise(points[1])
    E = essential_from_pose(pose.R, pose.t)
    error = DEVIATION * float(np.median(sampson_distance(x1, x2, E)))
    poses = [(pose.R, pose.t)]  # and those a deviation off, in each direction but along t
    if pose.covariance is not None:
        values, vectors = np.linalg.eigh(pose.covariance)
        for step in (vectors * np.sqrt(values.clip(min=0))).T[1:]:
            t = pose.t + step[3:]
            poses.append((cv2.Rodrigues(step[:3])[0] @ pose.R, t / np.linalg.norm(t)))
    inverse, of_match = _inverse_depths(x1, x2, poses, error)
    scatter, warnings = 0.0, pose.warnings
    if distance or markers:
        if distance:
            by_length = _by_distance(x1, inverse, of_match, pose.camera1, distance)
        else:
            cameras = pose.camera1, pose.camera2
            by_length = _by_marker(markers, cameras, poses, scale.marker or 0.0)
        if isinstance(by_length, str):
            return replace(pose, warnings=(*warnings, by_length))
        length, variance = by_length
    else:
        of_2 = _inverse_depths(x2, x1, [(R.T, -R.T @ t) for R, t in poses], error)
        seen = zip([_UNKNOWN if of is None else of for of in maps], points, strict=True)
        z = [1 / bilinear_at(of, *at.T[:, :, None])[:, 0].astype(np.float64) for of, at in seen]
        known = np.isfinite(z).ravel()
        if known.sum() < _MIN_DEPTHS:
            warnings += (f"the length of t is not known: {known.sum()} inliers have a depth",)
            return replace(pose, warnings=warnings)
        single = np.hstack([inverse * z[0], of_2[0] * z[1]])[:, known]
        of_match = np.hstack([of_match * z[0], of_2[1] * z[1]])[known]
        points2, count = np.vstack([x2, x2])[known], int(np.isfinite(z).any(1).sum())
        length, variance, scatter = _by_depth(single, of_match, points2, scale.depth_std, count)
    # The focal lengths scale the angles that depths are triangulated from.
    depth_std = 0 if distance or markers else scale.depth_std
    shares = depth_std, pose.camera1.focal_std, pose.camera2.focal_std
    std = math.hypot(math.sqrt(variance), *(share * length for share in shares))
    if scatter > _CONTRADICTS:
        off = f"the lengths that inliers tell scatter by {scatter:.1f} times their deviations"
        warnings += (f"the matches contradict the depth: {off}",)
    sure = pose.covariance is not None and scatter <= _CONTRADICTS
    return replace(pose, length=length, length_std=std if sure else None, warnings=warnings)


def _by_marker(
    markers: Sequence[Mapping[str, np.ndarray]],
    cameras: Sequence[Camera],
    poses: Sequence[tuple[np.ndarray, np.ndarray]],
    metres: float,
) -> tuple[float, float] | str:
    """The length and its variance by the side of markers; a warning if they have none."""
    try:
        found = [marker_side(markers, cameras, (np.eye(3, 4), np.column_stack(of))) for of in poses]
    except InputError as error:
        return f"the length of t is not known: {error}"
    length, *others = (metres / of.side for of in found)
    return length, sum((of - length) ** 2 for of in others) + (found[0].std * length) ** 2


def _inverse_depths(
    x1: np.ndarray, x2: np.ndarray, poses: Sequence[tuple[np.ndarray, np.ndarray]], error: float
) -> tuple[np.ndarray, np.ndarray]:
    """1 / depth (P, N) in camera 1 under each pose, unit 1 / |t|, and its deviation (N,) by the
    error of matches: points in image 2 move along epipolar lines with it."""
    inverse = np.stack([1 / depths(x1, x2, R, t)[0] for R, t in poses])
    R, t = poses[0]
    ratio = homogeneous(x1) @ R[2] + inverse[0] * t[2]  # of the depths in cameras 2 and 1
    moved = np.linalg.norm(t[:2] - t[2] * x2, axis=1) / np.abs(ratio)
    return inverse, math.sqrt(2) * error / moved


def _by_depth(
    single: np.ndarray, by_match: np.ndarray, points2: np.ndarray, depth_std: float, maps: int
) -> tuple[float, float, float]:
    """The length, its variance, and the scatter of single lengths in their deviations.

    single: (P, N), by each inlier under each pose. The length and the pose's change, of which its
    covariance is the prior, minimise a Cauchy loss. by_match: deviations (N,) by errors of matches.
    points2: (N, 2), as errors of neighbours are correlated. maps: number of depth maps.
    """
    design = np.column_stack([np.ones(single.shape[1]), *(single[0] - single[1:])])
    prior = _CORRELATED * maps * np.diag([0.0, *np.ones(len(single) - 1)])
    fit = np.median(single[0]) * (np.diag(prior) == 0)
    for _ in range(_STEPS):
        off = single[0] - design @ fit
        std = np.hypot(by_match, depth_std * fit[0])
        scatter = float(DEVIATION * np.median(np.abs(off) / std))
        std *= max(scatter, 1)
        off /= EFFICIENT * std
        weighted = design / (std**2 * (1 + off**2))[:, None]
        fit = np.linalg.solve(weighted.T @ design + prior, weighted.T @ single[0])
    curvature = cauchy_curvature(off, 1.0) / std**2
    inverse = np.linalg.inv((design * curvature[:, None]).T @ design + prior)[0]
    moves = EFFICIENT * std * off * (weighted @ inverse)
    sums = [block_sums(moves[:, None], points2, shift) for shift in SHIFTS]
    by_blocks = np.mean([(1 - 1 / len(of_block)) * (of_block**2).sum() for of_block in sums])
    return float(fit[0]), float(by_blocks + ((inverse @ prior) ** 2).sum()), scatter


def _by_distance(
    x1: np.ndarray, inverse: np.ndarray, std: np.ndarray, camera1: Camera, distance: Sequence[float]
) -> tuple[float, float] | str:
    """The length and its variance by a distance in the scene, see `ScaleSource`; a warning if few
    inliers are near one of its points."""
    rays, radius = camera1.normalise(np.reshape(distance[:4], (2, 2))), cell_side(camera1)
    at, off = np.ones((2, len(inverse))), np.ones(2)
    for n, away in enumerate(np.linalg.norm(x1 - ray, axis=1) for ray in rays):
        near = [k for k in np.argsort(away)[:_NEAREST] if away[k] < radius]
        if len(near) < _MIN_NEAR:
            point = f"({distance[2 * n]:g}, {distance[2 * n + 1]:g})"
            count = f"{len(near)} inliers are within {radius * camera1.focal:.0f} pixels of {point}"
            return f"the length of t is not known: {count}"
        at[n] = np.median(inverse[:, near], axis=1)
        spread = np.median(np.abs(inverse[0, near] - at[n, 0]))
        off[n] = DEVIATION * spread + np.median(std[near])
    at = np.hstack([at, at[:, :1] + np.diag(off)])  # under each pose, and each point off
    ends = homogeneous(rays)[:, :, None] / at[:, None]
    lengths = distance[4] / np.linalg.norm(ends[0] - ends[1], axis=0)
    return float(lengths[0]), float(((lengths - lengths[0]) ** 2).sum())
