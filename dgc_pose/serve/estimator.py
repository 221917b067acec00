"""Estimate a pose, and describe it for the page."""

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dgc_pose.cameras.calibration import pair_cameras, parse_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.geometry.epipolar import fundamental_from_essential
from dgc_pose.images.image import Image, load_image, picture_url
from dgc_pose.matching import CorrespondenceMap, Matcher
from dgc_pose.pose import PairResult, solve_pair
from dgc_pose.viz.figure import warp_image
from dgc_pose.viz.model_page import pose_scene

SHOWN_MATCHES = 3000  # more would slow the page down
SHOWN_CELLS = 96  # most cells of the map along a side, for the point under the pointer
_COVERED = 0.01  # smallest share of image 2 that the map must cover to be shown
_MAX_TEXT = 300  # characters of a K


@dataclass(frozen=True)
class StoredImage:
    """A readable image that a client has sent."""

    path: Path
    name: str  # from the client; only shown, never opened


@dataclass(frozen=True)
class Estimator:
    """Estimates poses with a loaded matcher, and describes them for the page."""

    matcher: Matcher
    weights: str | None  # value of --weights; None for the default

    def estimate(
        self,
        report: Callable[[str], None],
        stored1: StoredImage,
        stored2: StoredImage,
        camera: object,
    ) -> dict[str, Any]:
        """The pose and everything that the page shows with it, as values of JSON.

        report: called with a text for people before each step; an exception from it ends the work.
        camera: `data` of `requested_cameras`.
        """
        report("reading the images")
        image1, image2 = (
            replace(load_image(stored.path), name=stored.name) for stored in (stored1, stored2)
        )
        cameras, texts = requested_cameras(camera, image1, image2)
        report("matching and estimating the pose")
        result = solve_pair(image1, image2, cameras, self.matcher)
        report("drawing")
        F = None  # fundamental matrix for pixels of the pinhole cameras
        if (E := result.pose.E) is not None:
            matrix = fundamental_from_essential(E, result.camera1.K, result.camera2.K)
            F = (matrix / np.abs(matrix).max()).tolist()
        names = (stored1.name, stored2.name)
        weights = [] if self.weights is None else ["--weights", self.weights]
        return {
            "pose": result.pose.to_dict(),
            "reason": result.pose.reason,
            "names": list(names),
            "sizes": [list(image1.size), list(image2.size)],
            "F": F,
            "matches": _matches(result),
            "scene": None if result.pose.t is None else pose_scene(result),
            "map": None if result.correspondence_map is None else _map(result),
            "correspondences": _correspondences(result.correspondence_map),
            "command": command(names, texts, weights),
            "python": python_text(names, texts, "".join(map(repr, weights[1:]))),
        }


def _matches(result: PairResult) -> dict[str, list[Any]]:
    """At most `SHOWN_MATCHES` matches: points to 0.01 pixels, whether they are inliers, confidence,
    and residual in pixels or null. Inliers come before outliers, each in random order, so that the
    first few spread over the images."""
    matches = result.matches
    pose = result.pose
    residuals = result.residuals_px
    points = np.hstack([matches.points1, matches.points2])
    chosen = np.flatnonzero(np.isfinite(points).all(1))
    chosen = np.random.default_rng(0).permutation(chosen)
    chosen = chosen[np.argsort(~pose.inliers[chosen], kind="stable")][:SHOWN_MATCHES]
    return {
        "points": points[chosen].round(2).tolist(),
        "inlier": pose.inliers[chosen].tolist(),
        "confidence": matches.confidence[chosen].round(3).tolist(),
        "residual": [round(v, 3) if np.isfinite(v) else None for v in residuals[chosen].tolist()],
    }


def _correspondences(dense_map: CorrespondenceMap | None) -> dict[str, Any] | None:
    """The map on a grid of at most `SHOWN_CELLS` cells a side, row by row: points in image 1 to 0.1
    pixels, and matchability; and the pixels of the first and last cell in image 2."""
    if dense_map is None:
        return None
    thin = dense_map.thinned(-(-max(dense_map.matchability.shape) // SHOWN_CELLS))
    rows, columns = thin.matchability.shape
    return {
        "columns": columns,
        "rows": rows,
        "first": thin.grid[0, 0].tolist(),
        "last": thin.grid[-1, -1].tolist(),
        "points": thin.map.reshape(-1, 2).astype(float).round(1).tolist(),
        "matchability": thin.matchability.ravel().astype(float).round(2).tolist(),
    }


def _map(result: PairResult) -> dict[str, Any]:
    """The share of image 2 that the map covers. From `_COVERED` on, also pictures: image 1 warped
    onto image 2, transparent where matchability is low, and the matchability."""
    dense_map = result.correspondence_map
    assert dense_map is not None
    warped = warp_image(result.image1.pixels, dense_map.map, result.image2.size)
    size = warped.shape[1::-1]
    matchability = cv2.resize(dense_map.matchability.astype(np.float32), size)
    inside = (dense_map.map >= -0.5) & (dense_map.map <= np.array(dense_map.size1) - 0.5)
    known = cv2.resize(np.asarray(inside.all(-1), np.float32), size) * matchability
    covered = float((known > 0.5).mean())
    if covered < _COVERED:
        return {"covered": covered}
    alpha, shade = (
        (255 * np.clip(share, 0, 1)).astype(np.uint8) for share in (known, matchability)
    )
    coloured = cv2.applyColorMap(shade, cv2.COLORMAP_VIRIDIS)[..., ::-1]
    pictures = {"warp": (warped, alpha), "matchability": (coloured, np.full_like(alpha, 255))}
    urls = {
        name: picture_url(np.dstack(channels), "webp", cv2.IMWRITE_WEBP_QUALITY, 85)
        for name, channels in pictures.items()
    }
    return {"covered": covered, **urls}


def requested_cameras(
    data: object, image1: Image, image2: Image
) -> tuple[tuple[Camera, Camera], tuple[str, str]]:
    """The cameras of both images that a client requests, checked, and each as a value of --K. Paths
    from a client are never opened.

    data: the client's JSON with a `kind`: "auto"; "k" with texts `k1` and `k2`, the second empty if
    one camera took both images; or "fov" with `fov`, the horizontal field of view of both images in
    degrees. Raises InputError for anything else.
    """
    request = data if isinstance(data, Mapping) else {}
    match request.get("kind"):
        case "auto":
            return pair_cameras(None, None, image1, image2), ("auto", "auto")
        case "fov":
            if request.get("fov") is None:
                raise InputError("give the field of view in degrees")
            cameras = pair_cameras(None, None, image1, image2, fov=request["fov"])
            Ks = (camera.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist() for camera in cameras)
            K1, K2 = (",".join(map(repr, K)) for K in Ks)
            return cameras, (K1, K2)
        case "k":
            k1 = _text(request.get("k1", ""))
            k2 = _text(request.get("k2", "")) or k1
            if not k1:
                raise InputError("give K: fx,fy,cx,cy in pixels, or a COLMAP camera")
            names = ("K", "K") if k1 == k2 else ("K1", "K2")
            first, second = (
                k if k == "auto" else parse_camera(k, name, files=False)
                for k, name in zip((k1, k2), names, strict=True)
            )
            return pair_cameras(first, second, image1, image2, names), (k1, k2)
    raise InputError("camera must have a kind: auto, fov, k")


def _text(value: object) -> str:
    if not isinstance(value, str) or len(value) > _MAX_TEXT:
        raise InputError(f"K must be a text of at most {_MAX_TEXT} characters")
    return value.strip()


def command(names: tuple[str, str], cameras: tuple[str, str], weights: list[str]) -> str:
    """The command that gives the same pose. cameras: values of --K."""
    files = [f"./{name}" if name.startswith("-") else name for name in names]
    k1, k2 = cameras
    flags = ["--K", k1] if k1 == k2 else ["--K1", k1, "--K2", k2]
    return shlex.join(["dgc-pose", "estimate", *files, *flags, *weights])


def python_text(names: tuple[str, str], cameras: tuple[str, str], matcher: str) -> str:
    """The Python code that gives the same pose."""
    k1, k2 = cameras
    ks = f"K1={k1!r}" if k1 == k2 else f"K1={k1!r},\n    K2={k2!r}"
    return (
        "from dgc_pose import estimate_relative_pose, load_matcher\n\n"
        f"pose = estimate_relative_pose(\n"
        f"    {names[0]!r},\n    {names[1]!r},\n    {ks},\n"
        f"    matcher=load_matcher({matcher}),\n)\n"
        f"print(pose.status, pose.R, pose.t)\n"
    )
