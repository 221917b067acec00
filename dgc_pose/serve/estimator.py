"""A pose, estimated and described for the page."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from dgc_pose.geometry.epipolar import fundamental_from_essential
from dgc_pose.images.image import load_image, picture_url
from dgc_pose.matching import CorrespondenceMap, Matcher
from dgc_pose.pair_result import PairResult
from dgc_pose.pose import solve_pair
from dgc_pose.scene import pose_scene, warp_image
from dgc_pose.serve.cameras import command, python_text, requested_cameras
from dgc_pose.serve.images import StoredImage, shrunk

SHOWN_MATCHES = 3000  # more would slow the page down
SHOWN_CELLS = 96  # of the map along a side, for the point under the pointer
_COVERED = 0.01  # of image 2 that the map must cover, or there is nothing to see


@dataclass(frozen=True)
class Estimator:
    """A matcher that is loaded, and the poses by it described for the page."""

    matcher: Matcher
    weights: str | None  # as the command takes them; None for the default

    def estimate(
        self,
        report: Callable[[str], None],
        stored1: StoredImage,
        stored2: StoredImage,
        camera: object,
    ) -> dict[str, Any]:
        """The pose and what the page shows of it, as values of JSON.

        report: takes what is being done, for people; what it raises ends the work. camera: as of
        `requested_cameras`.
        """
        report("reading the images")
        image1, image2 = (
            replace(load_image(stored.path), name=stored.name) for stored in (stored1, stored2)
        )
        cameras, texts = requested_cameras(camera, image1, image2)
        report("matching and estimating the pose")
        result = solve_pair(image1, image2, cameras, self.matcher)
        report("drawing")
        F = None  # for pixels, of the pinhole cameras
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
    """At most `SHOWN_MATCHES` matches, inliers before outliers, each in a random order, so that the
    first few are spread over the images: points to 0.01 pixels, whether they are inliers,
    confidence, and the residual in pixels or null."""
    matches, pose, residuals = result.matches, result.pose, result.residuals_px
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
    """The map at a grid of at most `SHOWN_CELLS` cells a side: row after row the points in image 1
    to 0.1 pixels and the matchability, and the pixels of image 2 of the first and the last cell."""
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
    """The share of image 2 that the map covers; unless that is next to nothing, image 1 warped onto
    image 2, as transparent as it is unmatchable, and the matchability."""
    dense_map = result.correspondence_map
    assert dense_map is not None
    height, width = shrunk(result.image2.pixels).shape[:2]
    warped = warp_image(result.image1.pixels, dense_map.map, (width, height))
    matchability = cv2.resize(dense_map.matchability.astype(np.float32), (width, height))
    inside = (dense_map.map >= -0.5) & (dense_map.map <= np.array(dense_map.size1) - 0.5)
    known = cv2.resize(np.asarray(inside.all(-1), np.float32), (width, height)) * matchability
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
