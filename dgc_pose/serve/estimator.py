"""What the second worker does: estimate a pose, and describe it for the page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from dgc_pose.estimation import RelativePose
from dgc_pose.geometry.epipolar import fundamental_from_essential
from dgc_pose.images.image import Image, load_image
from dgc_pose.matching import CorrespondenceMap, Matcher, MatchResult
from dgc_pose.matching.warp import warp_image
from dgc_pose.metrics.epipolar import epipolar_residuals_px
from dgc_pose.pose import Trace, match_and_estimate
from dgc_pose.serve.cameras import CameraRequest, command, python_text
from dgc_pose.serve.decoder import data_url, shrunk, webp
from dgc_pose.serve.store import StoredImage
from dgc_pose.serve.worker import Report

SHOWN_MATCHES = 3000  # more would slow the page down


@dataclass(frozen=True)
class Estimator:
    """A matcher that is loaded, and what it finds described for the page."""

    matcher: Matcher
    describe: Callable[[RelativePose], dict[str, Any]]
    weights: str | None

    def ready(self, report: Report) -> None:
        """Nothing; that it answers says that the matcher is loaded."""

    def estimate(
        self, report: Report, first: StoredImage, second: StoredImage, request: CameraRequest
    ) -> dict[str, Any]:
        """The pose and what the page shows of it, as values of JSON."""
        report("reading the images")
        camera1, camera2 = request.resolve(first, second)
        image1, image2 = (_named(stored) for stored in (first, second))
        camera1, camera2 = (
            replace(camera, warnings=_renamed(camera.warnings, stored))
            for camera, stored in ((camera1, first), (camera2, second))
        )
        report("matching")
        trace = match_and_estimate(
            image1, image2, camera1, camera2, _Reporting(self.matcher, report)
        )
        report("drawing")
        names = (first.name, second.name)
        weights = [] if self.weights is None else ["--weights", self.weights]
        expressions = request.python((camera1, camera2), names)
        matcher = "" if self.weights is None else repr(self.weights)
        return {
            "pose": self.describe(trace.pose),
            "reason": trace.pose.reason,
            "names": list(names),
            "sizes": [list(image1.size), list(image2.size)],
            "K": [camera1.K.tolist(), camera2.K.tolist()],
            "F": _fundamental(trace),
            "matches": _matches(trace),
            "map": None if trace.correspondence_map is None else _map(trace),
            "command": command(names, request.flags((camera1, camera2)), weights),
            "python": python_text(names, expressions, matcher),
        }


class _Reporting(Matcher):
    """A matcher that says when it has matched."""

    def __init__(self, matcher: Matcher, report: Report) -> None:
        self._matcher, self._report = matcher, report

    @property
    def name(self) -> str:
        return self._matcher.name

    def _match(self, image1: Image, image2: Image) -> MatchResult:
        found = self._matcher.match(image1, image2)
        self._report(f"estimating the pose from {len(found.matches)} matches")
        return found


def _named(stored: StoredImage) -> Image:
    """The image under the client's name."""
    image = load_image(stored.path)
    return replace(image, name=stored.name, warnings=_renamed(image.warnings, stored))


def _renamed(texts: tuple[str, ...], stored: StoredImage) -> tuple[str, ...]:
    return tuple(text.replace(str(stored.path), stored.name) for text in texts)


def _fundamental(trace: Trace) -> list[list[float]] | None:
    """F for pixels, of the pinhole cameras; None without a pose."""
    if trace.pose.E is None:
        return None
    F = fundamental_from_essential(trace.pose.E, trace.camera1.K, trace.camera2.K)
    return (F / np.abs(F).max()).tolist()


def _matches(trace: Trace) -> dict[str, list[Any]]:
    """At most `SHOWN_MATCHES` matches, inliers before outliers, each in a random order, so that the
    first few are spread over the images: points to 0.01 pixels, whether they are inliers,
    confidence, and the residual in pixels or null."""
    matches, pose = trace.matches, trace.pose
    points = np.hstack([matches.points1, matches.points2])
    residuals = np.full(len(matches), np.nan)
    if pose.E is not None:
        residuals = epipolar_residuals_px(
            matches.points1, matches.points2, trace.camera1, trace.camera2, pose.E
        )
    chosen = np.flatnonzero(np.isfinite(points).all(1))
    chosen = np.random.default_rng(0).permutation(chosen)
    chosen = chosen[np.argsort(~pose.inliers[chosen], kind="stable")][:SHOWN_MATCHES]
    return {
        "points": points[chosen].round(2).tolist(),
        "inlier": pose.inliers[chosen].tolist(),
        "confidence": matches.confidence[chosen].round(3).tolist(),
        "residual": [round(v, 3) if np.isfinite(v) else None for v in residuals[chosen].tolist()],
    }


def _map(trace: Trace) -> dict[str, str]:
    """Image 1 warped onto image 2, as transparent as it is unmatchable, and the matchability."""
    found = trace.correspondence_map
    assert found is not None
    height, width = shrunk(trace.image2.pixels).shape[:2]
    warped = warp_image(trace.image1.pixels, found.map, (width, height))
    known = cv2.resize(_inside(found), (width, height)) * _smooth(found, (width, height))
    alpha = (255 * np.clip(known, 0, 1)).astype(np.uint8)
    shown = np.clip(_smooth(found, (width, height)), 0, 1)
    coloured = cv2.applyColorMap((255 * shown).astype(np.uint8), cv2.COLORMAP_VIRIDIS)[..., ::-1]
    opaque = np.full((height, width, 1), 255, np.uint8)
    return {
        "warp": data_url(webp(np.dstack([warped, alpha])), "image/webp"),
        "matchability": data_url(webp(np.dstack([coloured, opaque])), "image/webp"),
    }


def _smooth(found: CorrespondenceMap, size: tuple[int, int]) -> np.ndarray:
    return np.asarray(cv2.resize(found.matchability.astype(np.float32), size))


def _inside(found: CorrespondenceMap) -> np.ndarray:
    """1 for cells whose point lies in image 1, else 0; (H, W) float32."""
    inside = (found.map >= -0.5) & (found.map <= np.array(found.size1) - 0.5)
    return np.asarray(inside.all(-1), dtype=np.float32)
