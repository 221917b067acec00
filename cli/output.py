"""Write poses as text, and arrays as .npz."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.prior import SHARED
from dgc_pose.estimation import RelativePose
from dgc_pose.estimation.status import probability_text
from dgc_pose.geometry.rotation import rotation_angle_deg
from dgc_pose.system.files import naming_path

if TYPE_CHECKING:
    from dgc_pose.colmap.tracking import SharedMatches

SOURCES = {
    "given": "by the given K",
    "exif": "by EXIF data",
    "size": "by the size of the image",
    "lines": "by the lines of the image",
    "matches": "by the matches",
}


def pose_text(pose: RelativePose, priors: tuple[Camera, Camera] | None = None) -> str:
    """A pose for people. priors: the cameras before the estimation."""
    lines = [f"no pose ({pose.status}): {pose.reason}"]
    if pose.success:
        lines = ["pose of camera 2 from camera 1 (cam2_from_cam1: x2 = R x1 + t)"]
    if pose.R is not None:
        lines += _pose_lines(pose.R, pose.t, pose.length_text)
    lines += _camera_lines(pose, priors)
    if pose.num_inliers:
        inliers = "are inliers" if pose.success else "are inliers of the best essential matrix"
        share = f"{100 * pose.inlier_ratio:.1f} %"
        lines.append(f"{pose.num_inliers} of {pose.num_matches} matches {inliers} ({share})")
    angle = pose.median_triangulation_angle_deg
    if pose.t is not None and angle is not None:
        lines.append(f"median triangulation angle {angle:.2f} deg")
    if errors := pose.error_texts:
        what = "pose" if pose.success else "rotation"
        lines.append(
            f"expected error: {', '.join(errors)} in 90 % of cases, if the {what} is right"
        )
    if pose.t is not None:
        lines.append(probability_text(pose.probability, "that R and t are within 10 deg"))
        if pose.tested_matchers:
            names = ", ".join(pose.tested_matchers)
            lines.append(f"the probability of key points was tested for {names}")
    for number, alternative in enumerate(pose.alternatives, start=1):
        likely = probability_text(alternative.probability)
        lines.append(f"alternative {number}: {alternative.num_inliers} inliers, {likely}")
        lines += _pose_lines(alternative.R, alternative.t)
    return "\n".join([*lines, *closing_lines(pose.warnings, pose.seconds)])


def closing_lines(warnings: Iterable[str], seconds: Mapping[str, float]) -> list[str]:
    """Lines with the warnings, and a line with the seconds of each step."""
    times = ", ".join(f"{part} {value:.2f} s" for part, value in seconds.items())
    return [*(f"warning: {warning}" for warning in warnings), times]


def _pose_lines(R: np.ndarray, t: np.ndarray | None, length: str = "up to scale") -> list[str]:
    """R and t, a line for each row; t is None for a pure rotation. length: length of t, a text."""
    lines = [f"  R  {line}" for line in row_lines(*R)]
    lines.append(f"     rotation angle {rotation_angle_deg(R):.2f} deg")
    if t is None:
        return [*lines, "  t  undefined: the images show a pure rotation"]
    return [*lines, f"  t  {row_lines(t)[0]}  (translation {length})"]


def row_lines(*rows: np.ndarray) -> list[str]:
    """Rows of numbers in brackets, with six decimals."""
    # Rounding and adding 0.0 turn -0.0 into 0.0.
    texts = ([f"{round(value, 6) + 0.0:9.6f}" for value in row.tolist()] for row in rows)
    return [f"[{' '.join(text)}]" for text in texts]


def _camera_lines(pose: RelativePose, priors: tuple[Camera, Camera] | None) -> list[str]:
    """Lines for the cameras that are not exact; a single line if one camera took both images."""
    if pose.camera1 is None or pose.camera2 is None:
        return []
    cameras = pose.camera1, pose.camera2
    text1, text2 = map(camera_text, cameras, priors or cameras)
    if text1 == text2 and cameras[0].identity == cameras[1].identity is not None:
        assumed = priors is not None and priors[0].focal_prior and priors[0].identity != SHARED
        why = " (assumed: one size, and the same EXIF data or none)" if assumed else ""
        return [f"camera of both images{why}: {text1}"] if text1 else []
    return [f"camera {n}: {text}" for n, text in enumerate((text1, text2), start=1) if text]


def camera_text(camera: Camera, prior: Camera) -> str:
    """The numbers and deviations of a camera, and the f of its prior; empty if it is exact."""
    if camera.exact:
        return ""
    used, before = (
        f"{one.focal:.1f} +- {one.focal * one.focal_std:.1f} px {SOURCES[one.focal_source]}"
        for one in (camera, prior)
    )
    text = f"f = {used}"
    if camera.focal_source == "matches" and prior.focal_source in ("given", "exif"):
        text += f" ({before})"
    if camera.aspect_std:
        text += f"; fy / fx {camera.K[1, 1] / camera.K[0, 0]:.3f} +- {camera.aspect_std:.3f}"
    x, y = camera.K[:2, 2].tolist()
    text += f"; principal point ({x:.1f}, {y:.1f})"
    text += f" +- {camera.centre_std:.1f}" if camera.centre_std else ""
    if camera.lens_std and camera.distortion is not None:
        first, second = camera.distortion.radial
        kind = "lens" if camera.distortion.projection == "plane" else "fisheye"
        text += f"; {kind} k1 {first:.3f} +- {camera.lens_std:.3f}, k2 {second:.3f}"
    return text


def write_npz(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays to exactly this path (numpy would append .npz to a bare name)."""
    with naming_path(path), path.open("wb") as stream:
        np.savez_compressed(stream, **arrays)


def shared_text(shared: SharedMatches) -> str:
    """The contents of a written COLMAP database, in numbers."""
    images = sum(len(points) > 0 for points in shared.key_points.values())
    key_points, matches = (sum(map(len, m.values())) for m in (shared.key_points, shared.pairs))
    return f"{images} images, {key_points} key points, {len(shared.pairs)} pairs, {matches} matches"
