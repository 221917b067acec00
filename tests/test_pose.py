"""The whole pipeline, from paths, arrays and tensors to a pose and its verdict."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import dense_scene
import numpy as np
import PIL.Image
import pytest
import torch

import dgc_pose
from dgc_pose import (
    Camera,
    EstimationOptions,
    ImageError,
    InputError,
    RelativePose,
    estimate_pose,
    estimate_relative_pose,
    load_image,
    load_matcher,
    trace_relative_pose,
)
from dgc_pose.cameras.prior import auto_camera, auto_cameras
from dgc_pose.estimation import Alternative
from dgc_pose.matches import Matches
from dgc_pose.matching import MatchResult
from dgc_pose.matching.sift import SiftMatcher
from dgc_pose.metrics.pose import rotation_error_deg, translation_error_deg
from dgc_pose.pose import match_and_estimate, pose_of_result
from dgc_pose.synthesis.render.scene_pair import RenderedPair, render_scene_pair


@pytest.fixture(scope="module")
def pair() -> RenderedPair:
    return render_scene_pair(5, size1=(640, 480), size2=(560, 520), rotation_deg=12)


def test_arrays_tensors_and_paths_give_the_same_pose(pair: RenderedPair, tmp_path: Path) -> None:
    paths = []
    for index, image in enumerate((pair.image1, pair.image2)):
        paths.append(tmp_path / f"{index}.png")
        cv2.imwrite(str(paths[-1]), image[..., ::-1])
    tensors = [
        torch.from_numpy(i).permute(2, 0, 1).float() / 255 for i in (pair.image1, pair.image2)
    ]
    poses = [
        estimate_relative_pose(a, b, pair.K1, pair.K2, matcher=SiftMatcher())
        for a, b in ((pair.image1, pair.image2), paths, tensors)
    ]
    for pose in poses:
        assert pose.success and pose.status == "ok"
        assert rotation_error_deg(pose.R, pair.R) < 0.5
        assert translation_error_deg(pose.t, pair.t) < 2.0
        assert np.array_equal(pose.R, poses[0].R) and np.array_equal(pose.t, poses[0].t)
        assert set(pose.seconds) == {"load", "match", "estimate"}


def test_cameras_may_be_cameras_and_warnings_arrive(pair: RenderedPair) -> None:
    odd = pair.K2.copy()
    odd[0, 2] += 0.24 * 560  # far from the middle, as a crop's principal point may be
    trace = trace_relative_pose(
        pair.image1, pair.image2, Camera(pair.K1, (640, 480)), odd, matcher=SiftMatcher()
    )
    assert trace.correspondence_map is None and len(trace.matches) > 50
    assert any("principal point" in warning for warning in trace.pose.warnings)


def test_the_cameras_of_a_trace_are_those_of_its_pose(
    pair: RenderedPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    fitted = Camera(pair.K1, (640, 480), focal_std=0.01), Camera(pair.K2, (560, 520))

    def estimate(*arguments: Any, **options: Any) -> RelativePose:
        pose = estimate_pose(*arguments, **options)
        return replace(pose, camera1=fitted[0], camera2=fitted[1])

    monkeypatch.setattr("dgc_pose.pose.estimate_pose", estimate)
    trace = trace_relative_pose(pair.image1, pair.image2, matcher=SiftMatcher())
    assert (trace.camera1, trace.camera2) == fitted
    np.testing.assert_array_equal(trace.pose.K1, pair.K1)
    np.testing.assert_array_equal(trace.pose.K2, pair.K2)
    assert (trace.pose.focal_std1, trace.pose.focal_std2) == (0.01, 0)


NOISE = np.random.default_rng(0).integers(0, 256, (2, 240, 320, 3), dtype=np.uint8)
NOISE_K = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]])


@pytest.mark.parametrize(
    ("values", "known", "shared"),
    [
        ((), (False, False), True),
        (("auto:two",), (False, False), False),
        ((NOISE_K,), (True, True), True),
        ((NOISE_K, NOISE_K), (True, True), False),
        ((NOISE_K, "auto"), (True, False), False),
        (("auto", NOISE_K), (False, True), False),
    ],
)
def test_what_is_known_of_the_cameras(
    values: tuple[Any, ...], known: tuple[bool, bool], shared: bool
) -> None:
    trace = trace_relative_pose(*NOISE, *values, matcher=SiftMatcher())
    assert trace.pose.K1 is None and trace.pose.focal_std2 is None  # there is no pose
    cameras = trace.camera1, trace.camera2
    assert tuple(camera.focal_std == 0 for camera in cameras) == known
    assert (cameras[0].identity == cameras[1].identity) is shared


def test_an_orientation_that_is_not_applied_is_told_once_and_of_a_K_that_was_given(
    tmp_path: Path,
) -> None:
    photo, exif = PIL.Image.new("RGB", (80, 60)), PIL.Image.Exif()
    exif[0x0112] = 6
    paths = [tmp_path / "a.jpg", tmp_path / "b.jpg"]
    for path in paths:
        photo.save(path, exif=exif)
    first, second = map(load_image, paths)
    known = Camera(np.array([[70.0, 0, 35], [0, 70, 35], [0, 0, 1]]))
    cases = [
        ((known, known), 1),
        (auto_cameras(first, second), 0),
        ((auto_camera(first), known), 1),
    ]
    for cameras, count in cases:
        pose = match_and_estimate(first, second, *cameras, SiftMatcher()).pose
        told = [text for text in pose.warnings if "EXIF orientation 6 is not applied" in text]
        assert len(told) == count


@pytest.mark.parametrize(
    "values",
    [(), ("auto:shared",), ("auto:two",), (dense_scene.K, "auto"), ("auto", dense_scene.K)],
)
def test_the_matches_tell_the_focal_length_that_is_not_known(values: tuple[Any, ...]) -> None:
    matcher = dense_scene.MapMatcher(dense_scene.true_map(error_px=0.2))
    trace = trace_relative_pose(*dense_scene.pictures(), *values, matcher=matcher)
    pose, truth = trace.pose, dense_scene.K[0, 0]
    assert pose.success
    cameras = (trace.camera1, trace.camera2), (trace.prior1, trace.prior2)
    for camera, prior in zip(*cameras, strict=True):
        if prior.focal_std == 0:
            np.testing.assert_array_equal(camera.K, dense_scene.K)
            continue
        assert abs(prior.focal / truth - 1) > 0.15
        error = abs(camera.focal / truth - 1)
        assert error < 0.01 and error < 2 * camera.focal_std < 0.1
        assert camera.focal_source == "matches"
    error_90 = pose.rotation_error_90_deg
    assert error_90 is not None and rotation_error_deg(pose.R, dense_scene.R) < error_90 < 2


class _Searching(dense_scene.MapMatcher):
    """Half of the map's matches at first, and all of them after a search near lines."""

    searches = 0
    squeezes = 0

    def first(self) -> MatchResult:
        every = self.match(*PICTURES)
        return replace(every, matches=every.matches.subset(np.arange(len(every.matches)) % 2 == 0))

    def match_squeezed(self, image1: Any, image2: Any, result: MatchResult) -> MatchResult:
        self.squeezes += 1
        return result

    def match_near(self, *arguments: Any) -> MatchResult:
        self.searches += 1
        return self.match(*PICTURES)


PICTURES = tuple(map(load_image, dense_scene.pictures()))
EXACT = Camera(dense_scene.K, dense_scene.SIZE)
OPTIONS = EstimationOptions(runs=1)


@pytest.mark.parametrize(
    ("probability", "others", "uncertain", "searched"),
    [
        (0.5, (), 0, True),
        (0.0, (0.5, 0.4), 0, True),  # an ambiguous pair
        (0.6, (0.3, None), 0, True),
        (0.001, (), 0, False),  # hopeless
        (0.995, (), 0, False),  # certain
        (0.5, (0.495,), 0, False),
        (None, (), 0, False),
        (0.5, (), 1, False),
        (0.5, (), 2, False),
    ],
)
def test_a_pose_in_doubt_alone_is_searched(
    monkeypatch: pytest.MonkeyPatch,
    probability: float | None,
    others: tuple[float | None, ...],
    uncertain: int,
    searched: bool,
) -> None:
    poses: list[tuple[Matches, RelativePose]] = []

    def estimate(matches: Matches, *arguments: Any, **options: Any) -> RelativePose:
        pose = estimate_pose(matches, *arguments, **options)
        alternatives = tuple(Alternative(pose.R, pose.t, 9, other) for other in others)
        pose = replace(pose, probability=probability, alternatives=alternatives)
        poses.append((matches, pose))
        return pose

    monkeypatch.setattr("dgc_pose.pose.estimate_pose", estimate)
    matcher = _Searching(dense_scene.true_map(error_px=0.2))
    first = matcher.first()
    cameras = [replace(EXACT, focal_std=0.02 if n + 1 == uncertain else 0.0) for n in range(2)]
    pose, last = pose_of_result(matcher, *PICTURES, first, *cameras, OPTIONS)
    assert matcher.searches == matcher.squeezes == searched and len(poses) == 1 + searched
    assert (last is first) is not searched
    assert poses[-1][0] is last.matches and len(pose.inliers) == len(last.matches)
    if searched:
        assert len(last.matches) > 1.9 * len(first.matches)
        np.testing.assert_array_equal(pose.R, estimate_pose(last.matches, *cameras, OPTIONS).R)


def test_a_pose_that_squeezed_images_made_certain_is_not_searched_further(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    doubts = iter([True, False])
    monkeypatch.setattr("dgc_pose.pose.in_doubt", lambda *arguments: next(doubts))
    matcher = _Searching(dense_scene.true_map(error_px=0.2))
    every = matcher.match(*PICTURES)
    monkeypatch.setattr(_Searching, "match_squeezed", lambda *arguments: every)
    pose, last = pose_of_result(matcher, *PICTURES, matcher.first(), EXACT, EXACT, OPTIONS)
    assert last is every and len(pose.inliers) == len(every.matches) and matcher.searches == 0


def test_a_search_is_near_the_lines_of_all_hypotheses(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a matcher that does not search, the pose is that of the first matches."""
    monkeypatch.setattr("dgc_pose.pose.in_doubt", lambda *arguments: True)
    seen: list[Any] = []

    def search(self: _Searching, image1: Any, image2: Any, result: Any, views: Any) -> Any:
        seen.extend((image1, image2, views))
        return result

    monkeypatch.setattr(_Searching, "match_near", search)
    matcher = _Searching(dense_scene.true_map(error_px=0.2))
    first = matcher.first()
    pose, last = pose_of_result(matcher, *PICTURES, first, EXACT, EXACT, OPTIONS)
    assert last is first and len(pose.inliers) == len(first.matches)
    assert seen[:2] == list(PICTURES) and len(seen[2]) == len(pose.hypotheses) > 0
    np.testing.assert_array_equal(seen[2][0].R, pose.R)
    for views, hypothesis in zip(seen[2], pose.hypotheses, strict=True):
        assert (views.camera1, views.camera2) == (EXACT, EXACT)
        np.testing.assert_array_equal(views.t, hypothesis.model.t)


@pytest.mark.parametrize("kind", ["planar", "rotation_only", "forward"])
def test_verdicts_on_rendered_scenes(kind: str) -> None:
    scene = render_scene_pair(
        7,
        size1=(640, 480),
        size2=(640, 480),
        rotation_deg=8,
        kind=kind,  # type: ignore[arg-type]
    )
    pose = estimate_relative_pose(
        scene.image1, scene.image2, scene.K1, scene.K2, matcher=SiftMatcher()
    )
    assert pose.R is not None and rotation_error_deg(pose.R, scene.R) < 1.0
    if kind == "rotation_only":
        assert pose.status == "rotation_only" and not pose.success and pose.t is None
    else:
        assert pose.success and translation_error_deg(pose.t, scene.t) < 5.0
    if kind == "planar":
        assert pose.status == "planar" and any("plane" in w for w in pose.warnings)


def test_an_image_with_itself_has_no_translation(pair: RenderedPair) -> None:
    pose = estimate_relative_pose(pair.image1, pair.image1, pair.K1, matcher=SiftMatcher())
    assert pose.status == "rotation_only" and pose.t is None and pose.E is None
    assert pose.R is not None and rotation_error_deg(pose.R, np.eye(3)) < 0.01


def test_a_rotated_copy_is_a_rotation(pair: RenderedPair) -> None:
    K = np.array([[600.0, 0, 319.5], [0, 600, 239.5], [0, 0, 1]])
    rotated = np.rot90(pair.image1).copy()
    rotated_K = np.array([[600.0, 0, 239.5], [0, 600, 319.5], [0, 0, 1]])
    pose = estimate_relative_pose(pair.image1, rotated, K, rotated_K, matcher=SiftMatcher())
    expected = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # x2 = y1, y2 = -x1
    assert pose.status == "rotation_only" and pose.R is not None
    assert rotation_error_deg(pose.R, expected) < 0.1


def test_noise_gives_no_pose() -> None:
    pose = estimate_relative_pose(*NOISE, NOISE_K, matcher=SiftMatcher())
    assert not pose.success and pose.R is None and pose.t is None and pose.reason


IMAGE = np.zeros((40, 50, 3), np.uint8)
K = np.array([[50.0, 0, 24.5], [0, 50, 19.5], [0, 0, 1]])
SIFT = SiftMatcher()


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: estimate_relative_pose(IMAGE, IMAGE, K, matcher="sift"), "matcher"),
        (lambda: estimate_relative_pose(IMAGE, IMAGE, K, matcher=SIFT, options={}), "options"),
        (lambda: estimate_relative_pose(None, IMAGE, K, matcher=SIFT), "image1"),
        (lambda: estimate_relative_pose(IMAGE, np.zeros(7), K, matcher=SIFT), "image2"),
        (lambda: estimate_relative_pose("missing.png", IMAGE, K), "missing.png"),
        (lambda: estimate_relative_pose(IMAGE, IMAGE, "K", matcher=SIFT), "K1"),
        (lambda: estimate_relative_pose(IMAGE, IMAGE, np.eye(2), matcher=SIFT), "K1"),
        (lambda: estimate_relative_pose(IMAGE, IMAGE, K, 5 * K, matcher=SIFT), "K2"),
        (lambda: load_matcher(5), "name"),
        (lambda: load_matcher("sift", matching={}), "matching"),
        (lambda: load_matcher("sift", refinement="none"), "refinement"),
        (lambda: load_matcher("sift", device=0), "device"),
        (lambda: EstimationOptions(runs="5"), "runs"),
        (lambda: EstimationOptions(runs=2.5), "runs"),
        (lambda: EstimationOptions(seed=10**40), "seed"),
        (lambda: EstimationOptions(verdict=None), "verdict"),
        (lambda: EstimationOptions(refine="no"), "refine"),
    ],
)
def test_a_wrong_argument_is_named(call: Callable[[], object], named: str) -> None:
    with pytest.raises((InputError, ImageError), match=rf"^{named}\b"):
        call()


def test_every_public_name_is_there() -> None:
    for name in dgc_pose.__all__:
        assert getattr(dgc_pose, name) is not None
    with pytest.raises(AttributeError, match="nothing_such"):
        dgc_pose.nothing_such  # noqa: B018
