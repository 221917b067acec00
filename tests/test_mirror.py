"""Whether an image is mirrored: by the inliers of coarse passes of it and of its mirror image."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import dense_scene
import numpy as np
import pytest
from results import GOOD_EVIDENCE

from dgc_pose import (
    Camera,
    EstimationOptions,
    Image,
    RelativePose,
    estimate_pose,
    estimate_relative_pose,
    load_image,
)
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.cameras.pair_list import rendered_pair
from dgc_pose.estimation.problem import Hypothesis
from dgc_pose.images.cache import ImageCache
from dgc_pose.matches import Matches
from dgc_pose.matching import MatchResult
from dgc_pose.mirror import if_mirrored, mirrored_triangles

_FIRST, _SECOND = dense_scene.pictures()
FIRST, SECOND = load_image(_FIRST), load_image(_SECOND)
EXACT = Camera(dense_scene.K, dense_scene.SIZE)
OPTIONS = EstimationOptions(runs=1)
TRUE = dense_scene.MapMatcher(dense_scene.true_map(error_px=0.2))._match(FIRST, SECOND)
_ROWS = np.arange(len(TRUE.matches))
# Some of the matches moved, as where a mirror image matches by chance.
NEARLY = replace(
    TRUE.matches,
    points2=TRUE.matches.points2 + 30 * (_ROWS % 8 == 0)[:, None],
)


class _Coarse(dense_scene.MapMatcher):
    """A coarse pass that gives so many of the true matches of image 2, and of its mirror image."""

    def __init__(self, own: int, mirrored: int) -> None:
        super().__init__(dense_scene.true_map())
        self.counts = {"own": own, "mirrored": mirrored}
        self.asked: list[str] = []
        self.cache = ImageCache()

    def part(self, which: str) -> int:
        return len(TRUE.matches) // self.counts[which]

    def coarse(self, image1: Image, image2: Image) -> MatchResult | None:
        which = "own" if image2 is SECOND else "mirrored"
        self.asked.append(which)
        if not self.counts[which]:
            return None
        matches = TRUE.matches.subset(_ROWS % self.part(which) == 0)
        if which == "mirrored":
            x, y = matches.points2.T
            flipped = np.column_stack([dense_scene.SIZE[0] - 1 - x, y])
            return MatchResult(replace(matches, points2=flipped), None)
        return MatchResult(matches, None)


@cache
def _estimated(part: int) -> RelativePose:
    """The pose of every so many of the true matches."""
    return estimate_pose(TRUE.matches.subset(_ROWS % part == 0), EXACT, EXACT, OPTIONS)


def _pose(share: float, **changes: Any) -> RelativePose:
    """The pose of all true matches, this share of which count as inliers."""
    pose = _estimated(1)
    inliers = np.arange(pose.num_matches) < share * pose.num_matches
    return replace(pose, inliers=inliers, **changes)


def _verdict(
    matcher: _Coarse, pose: RelativePose, camera2: Camera = EXACT, effort: Any = "auto"
) -> RelativePose | None:
    options = replace(OPTIONS, effort=effort)
    has_coarse = effort != "thorough" and matcher.counts["own"]
    coarse = _estimated(matcher.part("own")) if has_coarse else None
    cameras = EXACT, camera2
    return if_mirrored(FIRST, SECOND, cameras, matcher, options, NEARLY, pose, coarse)


FAILED: Mapping[str, Any] = {"status": "improbable", "R": None, "t": None, "covariance": None}
OTHER_K = FAILED | {"evidence": replace(GOOD_EVIDENCE, camera_model="focal")}


@pytest.mark.parametrize(
    ("share", "changes", "own", "mirrored", "effort", "status", "asked"),
    [
        (0.6, {}, 200, 600, "auto", "mirrored", ["mirrored"]),
        (0.6, {}, 300, 300, "auto", "ambiguous", ["mirrored"]),
        (0.6, {}, 600, 200, "auto", None, ["mirrored"]),
        (0.6, {}, 200, 0, "auto", None, ["mirrored"]),
        (0.01, {}, 0, 600, "auto", "mirrored", ["mirrored"]),
        (0.6, {}, 0, 600, "auto", None, ["mirrored"]),  # a full pass has more
        (0.0, FAILED, 200, 600, "auto", "mirrored", ["mirrored"]),
        (0.0, FAILED, 300, 300, "auto", None, ["mirrored"]),  # has no pose in any case
        (0.9, {}, 200, 600, "auto", None, []),  # most matches are explained
        (0.9, {}, 0, 600, "auto", None, ["mirrored"]),  # but a coarse pass found none
        (0.0, FAILED, 0, 600, "auto", "mirrored", ["mirrored"]),
        (0.0, FAILED | {"status": "panorama"}, 0, 600, "auto", None, []),
        (0.6, {"status": "rotation_only", "t": None}, 200, 600, "auto", "mirrored", ["mirrored"]),
        (0.9, {"status": "rotation_only", "t": None}, 200, 600, "auto", None, []),
        (0.0, OTHER_K, 200, 600, "auto", None, []),  # the camera is what is wrong
        (0.0, {"status": "same_picture"}, 200, 600, "auto", None, []),
        (0.6, {}, 200, 600, "thorough", "mirrored", ["mirrored", "own"]),
        (0.6, {}, 600, 200, "thorough", None, ["mirrored", "own"]),
        (0.9, {}, 200, 600, "thorough", None, []),
    ],
)
def test_the_image_with_far_more_inliers_is_as_it_was_taken(
    share: float,
    changes: Mapping[str, Any],
    own: int,
    mirrored: int,
    effort: str,
    status: str | None,
    asked: list[str],
) -> None:
    matcher, pose = _Coarse(own, mirrored), _pose(share, **changes)
    verdict = _verdict(matcher, pose, effort=effort)
    assert matcher.asked == asked
    assert (verdict and verdict.status) == status
    if verdict is not None:
        assert not verdict.success and "mirror image" in verdict.reason
        assert verdict.R is None and verdict.probability == 0
        assert len(verdict.inliers) == pose.num_matches and not verdict.inliers.any()


def test_a_pose_without_mirrored_triangles_is_not_questioned() -> None:
    matcher, pose = _Coarse(0, 600), _pose(0.6)
    cameras = EXACT, EXACT
    verdict = if_mirrored(FIRST, SECOND, cameras, matcher, OPTIONS, TRUE.matches, pose, None)
    assert verdict is None and not matcher.asked


def test_the_share_of_mirrored_triangles() -> None:
    points = np.random.default_rng(0).uniform(0, 100, (300, 2))
    turned = points @ [[0.0, 2.0], [-2.0, 0.0]]
    half = np.where(points[:, :1] < 50, turned, turned * [1, -1])
    for points2, least, most in (
        (turned, 0.0, 0.0),
        (turned * [1, -1], 1.0, 1.0),
        (half, 0.4, 0.7),
    ):
        matches = Matches(points, points2, np.ones(300), 1.0, True)
        assert least <= mirrored_triangles(matches, (100, 80)) <= most
        assert mirrored_triangles(matches, (1, 1)) == 0  # no triangle is as small
    line = Matches(points * [1, 0], turned, np.ones(300), 1.0, True)
    assert mirrored_triangles(line, (100, 80)) == 0
    assert mirrored_triangles(line.subset(np.zeros(300, bool)), (100, 80)) == 0


@pytest.mark.parametrize("upside_down", [False, True])
def test_the_mirror_image_is_that_of_the_camera_turned_likewise(
    monkeypatch: pytest.MonkeyPatch, upside_down: bool
) -> None:
    """Left to right; of a pose that is upside down, also top to bottom."""
    cameras: list[Camera] = []

    def estimate(matches: Any, *arguments: Any, **options: Any) -> RelativePose:
        cameras.append(arguments[1])
        return _pose(1.0)

    R = np.diag([-1.0, -1.0, 1.0]) if upside_down else np.eye(3)
    inliers, in_front = np.ones((2, 9), dtype=bool)
    hypotheses = (Hypothesis(R, np.array([1.0, 0, 0]), inliers, in_front),)
    lens = Distortion("OPENCV", (-0.1, 0.02, 0.01, -0.02))
    camera = Camera(np.array([[300.0, 0, 170], [0, 290, 110], [0, 0, 1]]), dense_scene.SIZE, lens)
    pose, matcher = _pose(0.6, hypotheses=hypotheses), _Coarse(0, 200)
    monkeypatch.setattr("dgc_pose.mirror.estimate_pose", estimate)
    _verdict(matcher, pose, camera)
    mirrored = cameras[-1]
    assert len(cameras) == 1 + upside_down
    assert mirrored.size == camera.size
    flip = np.array([1, -1]) if upside_down else np.array([-1, 1])
    offset = np.where(flip < 0, np.array(dense_scene.SIZE) - 1, 0)
    rays = np.random.default_rng(0).uniform(-0.3, 0.3, (20, 2))
    seen = offset + flip * camera.project(rays)
    np.testing.assert_allclose(mirrored.project(flip * rays), seen, atol=1e-6)


def test_a_lens_without_a_mirror_image_is_not_mirrored() -> None:
    lens = Distortion("THIN_PRISM_FISHEYE", (0.01,) * 8)
    matcher = _Coarse(0, 200)
    assert _verdict(matcher, _pose(0.6), replace(EXACT, distortion=lens)) is None
    assert not matcher.asked


def test_a_mirrored_photograph_is_recognised() -> None:
    """The bundled pair, with the second image as selfie cameras store it; and one photograph beside
    its own mirror image."""
    pair = rendered_pair()
    second = load_image(pair.path2)
    K2 = pair.camera2.K.copy()
    K2[0, 2] = second.size[0] - 1 - K2[0, 2]
    mirrored = np.ascontiguousarray(np.flip(second.pixels, 1))
    pose = estimate_relative_pose(pair.path1, mirrored, pair.camera1, K2)
    assert pose.status == "mirrored", pose
    fast = EstimationOptions(effort="fast")
    pose = estimate_relative_pose(pair.path2, mirrored, pair.camera2, K2, options=fast)
    assert pose.status == "mirrored", pose
