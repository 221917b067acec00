"""Whether an image is mirrored, as selfie cameras, webcams and scanned slides store them."""

from __future__ import annotations

import cv2
import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions, RelativePose, estimate_pose
from dgc_pose.estimation.status import Status
from dgc_pose.geometry.pixels import exif_turn
from dgc_pose.images.image import Image, flipped
from dgc_pose.matches import Matches
from dgc_pose.matching import Matcher

_EXPLAINED = 0.8  # share of the matches that are inliers from which nobody asks
# Share of mirrored triangles below which nobody asks, and the longest side of such triangles, over
# the longer side of the image.
_FEW_TRIANGLES = 0.012
_SMALL = 0.15
_SURE = 0.9  # least probability of the mirror image's pose where the image itself has none
# Matches that agree of the mirror image over those of the image, in coarse passes, above which the
# image is mirrored; below the inverse it is not (docs/experiments.md).
_RATIO = 1.25


def if_mirrored(
    image1: Image,
    image2: Image,
    cameras: tuple[Camera, Camera],
    matcher: Matcher,
    options: EstimationOptions,
    matches: Matches,
    pose: RelativePose,
    coarse: RelativePose | None,
) -> RelativePose | None:
    """The verdict that image 2 is mirrored, or that it may be, as in a scene that is its own mirror
    image; None for neither. pose: of the matches. coarse: the pose after a coarse pass, if it gave
    matches.

    A pose is not questioned if hardly a triangle of its inliers is mirrored, or if it explains most
    matches and the coarse pass gave some; and where the matches contradict K, nobody is called
    mirrored. The mirror image is flipped left to right; if the pose is upside down, also top to
    bottom.
    """
    if pose.contradicts_K or pose.status in ("same_picture", "panorama"):
        return None
    without_coarse_step = options.effort == "thorough"
    if pose.R is not None:
        is_explained = pose.num_inliers >= _EXPLAINED * pose.num_matches
        if is_explained and (coarse is not None or without_coarse_step):
            return None
        if mirrored_triangles(matches.subset(pose.inliers), image1.size) < _FEW_TRIANGLES:
            return None
    flips = bool(pose.hypotheses) and pose.hypotheses[0].R[1, 1] < 0
    mirrored = 0
    for axis in (1, 0) if flips else (1,):
        try:
            image, camera = mirror_image(image2, cameras[1], axis)
        except InputError:
            return None
        other = _coarse_pose(image1, image, (cameras[0], camera), matcher, options)
        matcher.cache.forget(image)  # no other pair uses it
        if other is not None and _is_likely(other, _SURE if pose.R is None else 0.0):
            mirrored = max(mirrored, _agreeing(other))
    if not mirrored:
        return None
    if without_coarse_step:
        coarse = _coarse_pose(image1, image2, cameras, matcher, options)
    # A coarse pass gives no matches of images that differ much in scale or are rotated.
    own = _agreeing(pose if coarse is None and pose.R is not None else coarse)
    counts = f"{mirrored} matches that agree, and image 2 has {own}"
    status: Status
    if mirrored > _RATIO * own:
        status = "mirrored"
        reason = f"the mirror image of image 2 has {counts}"
    elif pose.success and own < _RATIO * mirrored:
        status = "ambiguous"
        reason = f"image 2 may be mirrored: its mirror image has {counts}"
    else:
        return None
    none = np.zeros_like(pose.inliers)
    return RelativePose(status, reason, none, pose.num_matches, warnings=pose.warnings)


def _is_likely(pose: RelativePose, least: float) -> bool:
    """Whether a mirror image has a pose of this probability, or is the other image."""
    if pose.status == "same_picture":
        return True
    probability = pose.one_place_probability
    return pose.success and (probability is None or probability >= least)


def _agreeing(pose: RelativePose | None) -> int:
    if pose is None:
        return 0
    return pose.num_matches if pose.status == "same_picture" else pose.num_inliers


def mirrored_triangles(matches: Matches, size: tuple[int, int]) -> float:
    """The share of the small triangles of neighbouring matches in image 1, of this size (width,
    height), that are mirrored in image 2; 0 without any."""
    if not len(matches):
        return 0.0
    low = matches.points1.min(axis=0).astype(int)
    high = matches.points1.max(axis=0).astype(int)
    rows = {
        tuple(point): row for row, point in enumerate(matches.points1.astype(np.float32).tolist())
    }
    mesh = cv2.Subdiv2D((*(low - 2).tolist(), *(high - low + 5).tolist()))
    for point in rows:
        mesh.insert(point)
    triangles = np.asarray(mesh.getTriangleList()).reshape(-1, 3, 2).tolist()
    corners = [[rows.get(tuple(point), -1) for point in triangle] for triangle in triangles]
    corners = [triangle for triangle in corners if min(triangle) >= 0]  # not of the mesh's own
    if not corners:
        return 0.0
    closed = np.array(corners)[:, [0, 1, 2, 0]]
    sides1, sides2 = (
        np.diff(points[closed], axis=1) for points in (matches.points1, matches.points2)
    )  # (T, 3, 2)
    is_small = np.linalg.norm(sides1, axis=2).max(axis=1) < _SMALL * max(size)
    turns = np.linalg.det(sides1[is_small, :2]) * np.linalg.det(sides2[is_small, :2])
    return float((turns < 0).mean()) if len(turns) else 0.0


def mirror_image(image: Image, camera: Camera, axis: int) -> tuple[Image, Camera]:
    """The mirror image, see `flipped`, and its camera. Raises InputError if the camera cannot be
    mirrored, see `Camera.turned`."""
    return flipped(image, axis), camera.turned(exif_turn(2 if axis else 4), image.size)


def _coarse_pose(
    image1: Image,
    image2: Image,
    cameras: tuple[Camera, Camera],
    matcher: Matcher,
    options: EstimationOptions,
) -> RelativePose | None:
    found = matcher.coarse(image1, image2)
    if found is None:
        return None
    return estimate_pose(found.matches, *cameras, options, map_matches=found.map_matches)
