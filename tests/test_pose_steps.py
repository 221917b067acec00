"""The steps of the search for a pose: which are done, and what each is estimated from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import dense_scene
import numpy as np
import pytest
from good_evidence import GOOD_EVIDENCE

from dgc_pose import (
    Camera,
    EstimationOptions,
    Image,
    RelativePose,
    estimate_pose,
    estimate_relative_pose,
    load_image,
    load_matcher,
)
from dgc_pose.cameras.pair_list import bundled_photographs, rendered_pair
from dgc_pose.estimation.hypothesis import Hypothesis
from dgc_pose.estimation.options import Effort
from dgc_pose.matchers import MatcherCaches
from dgc_pose.matches import Matches
from dgc_pose.matching import MatchResult, PairSearch
from dgc_pose.pose import pose_of_pair


class _Stepwise(PairSearch):
    """The map's matches: every fourth of them by a quick pass, every third by the fine one, every
    second by the whole, and all by the search for more. Of the mirror image of image 2 every fourth
    or none."""

    has_quick, of_mirror_image = True, False

    def __init__(self, matcher: _Steps, image1: Image, image2: Image) -> None:
        super().__init__(matcher, image1, image2)
        self.steps, self.views = matcher.steps, None

    def every(self, step: str, count: int) -> MatchResult:
        self.steps.append(step)
        result = self.matcher._match(*PICTURES)
        rows = np.arange(len(result.matches)) % count == 0
        self.result = replace(result, matches=result.matches.subset(rows))
        return self.result

    def quick(self) -> MatchResult | None:
        is_mirrored = self.image2 is not PICTURES[1]
        result = self.every("mirrored" if is_mirrored else "quick", 4)
        return result if (self.of_mirror_image if is_mirrored else self.has_quick) else None

    def fine(self) -> MatchResult:
        return self.every("fine", 3)

    def whole(self) -> MatchResult:
        return self.every("match", 2)

    def more(self, hypotheses: Any) -> MatchResult:
        self.views = hypotheses
        return self.every("more", 1)


class _Steps(dense_scene.MapMatcher):
    """The matcher of such searches, and the steps that they did."""

    def __init__(self) -> None:
        super().__init__(dense_scene.true_map(error_px=0.2))
        self.steps: list[str] = []

    def search(self, image1: Image, image2: Image) -> _Stepwise:
        return _Stepwise(self, image1, image2)


PICTURES = tuple(map(load_image, dense_scene.pictures()))
EXACT = Camera(dense_scene.K, dense_scene.SIZE)
OPTIONS = EstimationOptions(runs=1)


def _with(monkeypatch: pytest.MonkeyPatch, *answers: Mapping[str, Any]) -> list[Matches]:
    """Poses in turn with these values in place of their own, the last for all further ones. The
    list fills with the matches that each is estimated from."""
    estimated: list[Matches] = []

    def estimate(matches: Matches, *arguments: Any, **options: Any) -> RelativePose:
        pose = estimate_pose(matches, *arguments, **options)
        estimated.append(matches)
        return replace(pose, **answers[min(len(estimated), len(answers)) - 1])

    monkeypatch.setattr("dgc_pose.pose.estimate_pose", estimate)
    return estimated


# Inliers that do not agree closely, as of a scene that is nearly its mirror image.
LOOSELY = {"evidence": replace(GOOD_EVIDENCE, residual=0.2)}


def _doubt(probability: float | None, others: float = 0.0) -> dict[str, Any]:
    if probability is None:
        return {"probability": None, "any_probability": None} | LOOSELY
    total = probability + others
    values = {"probability": probability, "any_probability": total}
    return values | {"hypotheses": (_of_share(probability / total),)} | LOOSELY


def _of_share(share: float) -> Hypothesis:
    inliers, in_front = np.ones((2, 9), dtype=bool)
    return Hypothesis(np.eye(3), np.array([1.0, 0, 0]), inliers, in_front, share=share)


CERTAIN: dict[str, Any] = {
    "probability": 0.995,
    "any_probability": 0.995,
    "hypotheses": (_of_share(1.0),),
}
ROTATION = _doubt(0.0, 0.5) | {"status": "rotation_only"}
LOOSE, LOOSER = (CERTAIN | {"covariance": variance * np.eye(6)} for variance in (1e-4, 1e-2))
SEARCHED = ["mirrored", "more"]


@pytest.mark.parametrize(
    ("effort", "answers", "steps"),
    [
        ("auto", [CERTAIN], ["quick"]),
        ("auto", [CERTAIN | LOOSELY], ["quick", "mirrored"]),
        ("fast", [CERTAIN | _doubt(0.96)], ["quick", "mirrored"]),
        ("fast", [CERTAIN | {"any_probability": 0.89}], ["quick", "mirrored"]),
        ("fast", [CERTAIN | {"any_probability": 0.91}], ["quick"]),
        ("auto", [_doubt(0.9), CERTAIN], ["quick", "match"]),
        ("auto", [LOOSE], ["quick", "fine"]),  # certain, but not accurate
        ("auto", [LOOSE, _doubt(0.9), CERTAIN], ["quick", "fine", "match"]),
        ("auto", [LOOSER], ["quick", "fine", *SEARCHED[1:]]),
        ("auto", [_doubt(None)], ["quick", "match"]),  # nothing to compare the mirror image with
        ("auto", [_doubt(0.5)], ["quick", "match", *SEARCHED]),
        ("auto", [_doubt(0.0, 0.9)], ["quick", "match", *SEARCHED]),  # an ambiguous pair
        ("auto", [ROTATION | {"hypotheses": (_of_share(0.8),)}], ["quick", "match", *SEARCHED[1:]]),
        ("auto", [ROTATION | {"hypotheses": (_of_share(1.0),)}], ["quick", "match"]),
        ("auto", [_doubt(0.8)], ["quick", "match", *SEARCHED]),
        ("auto", [_doubt(0.5, 0.495)], ["quick", "match", *SEARCHED]),  # one of two is right
        ("auto", [_doubt(0.96, 0.035)], ["quick", "mirrored"]),
        ("auto", [_doubt(0.001)], ["quick", "match", "mirrored"]),  # hopeless
        ("fast", [_doubt(0.5)], ["quick", "mirrored"]),
        ("fast", [LOOSE], ["quick"]),
        ("thorough", [CERTAIN], ["match"]),
        ("thorough", [LOOSE, CERTAIN], ["match", *SEARCHED[1:]]),
        ("thorough", [_doubt(0.5)], ["match", *SEARCHED]),
    ],
)
def test_steps_are_done_as_long_as_they_may_change_the_answer(
    monkeypatch: pytest.MonkeyPatch, effort: Effort, answers: Any, steps: list[str]
) -> None:
    estimated = _with(monkeypatch, *answers)
    search = _Steps().search(*PICTURES)
    pose = pose_of_pair(search, EXACT, EXACT, replace(OPTIONS, effort=effort))
    poses = [step for step in steps if step != "mirrored"]
    assert search.steps == steps and list(pose.seconds) == [*poses, "estimate"]
    last = search.last.matches
    assert len(estimated) == len(poses)
    assert last is estimated[-1] and len(pose.inliers) == len(last)
    expected = {"quick": 4, "fine": 3, "match": 2, "more": 1}[poses[-1]]
    assert len(last) == -(-len(search.matcher._match(*PICTURES).matches) // expected)


def test_a_quick_pass_is_not_enough_to_tell_a_wrong_k(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rendered scene whose matches tell the focal length."""
    wrong = Camera(np.diag([1.15, 1.15, 1]) @ dense_scene.K, dense_scene.SIZE)
    for camera, steps in ((EXACT, ["quick"]), (wrong, ["quick", "fine"])):
        _with(monkeypatch, CERTAIN)
        search = _Steps().search(*PICTURES)
        pose_of_pair(search, camera, camera, OPTIONS)
        assert search.steps[:2] == steps


@pytest.mark.parametrize("uncertain", [1, 2])
def test_focal_lengths_that_are_not_known_need_all_the_matches(
    monkeypatch: pytest.MonkeyPatch, uncertain: int
) -> None:
    _with(monkeypatch, _doubt(0.5))
    cameras = [replace(EXACT, focal_std=0.02 if n + 1 == uncertain else 0.0) for n in range(2)]
    search = _Steps().search(*PICTURES)
    pose_of_pair(search, *cameras, OPTIONS)
    assert search.steps == ["match", "mirrored"]


@pytest.mark.parametrize(
    ("own", "answer", "status"),
    [
        (_doubt(0.5), _doubt(0.91), "mirrored"),
        (_doubt(0.5), _doubt(0.89), "ok"),
        (_doubt(0.97), _doubt(0.98), "mirrored"),
        (_doubt(0.98), _doubt(0.97), "ok"),
        (_doubt(0.0, 0.98), _doubt(0.97), "ok"),  # two poses, one of which is right
        (_doubt(0.5), _doubt(None), "ok"),
    ],
)
def test_a_likely_pose_of_the_mirror_image_ends_the_search(
    monkeypatch: pytest.MonkeyPatch, own: Mapping[str, Any], answer: Mapping[str, Any], status: str
) -> None:
    """If it is more probable than that of the image as it is."""
    monkeypatch.setattr(_Stepwise, "of_mirror_image", True)
    estimated = _with(monkeypatch, own, own, answer)
    search = _Steps().search(*PICTURES)
    pose = pose_of_pair(search, EXACT, EXACT, OPTIONS)
    steps, last = ["quick", "match", "mirrored"], search.last
    assert search.steps == (steps if status == "mirrored" else [*steps, "more"])
    assert pose.status == status and len(pose.inliers) == len(last.matches)
    if status == "mirrored":
        assert last.matches is estimated[1] and not pose.success and "mirror image" in pose.reason
        assert pose.R is None and pose.probability == 0 and not pose.inliers.any()


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_photograph_is_recognised(axis: int) -> None:
    """The bundled pair: the second image as selfie cameras store it, and upside down."""
    pair = rendered_pair()
    second = load_image(pair.path2)
    K2 = pair.camera2.K.copy()
    K2[axis, 2] = second.size[axis] - 1 - K2[axis, 2]
    mirrored = np.ascontiguousarray(np.flip(second.pixels, 1 - axis))
    pose = estimate_relative_pose(pair.path1, mirrored, pair.camera1, K2)
    assert pose.status == "mirrored", pose


def test_a_scene_that_is_nearly_its_mirror_image_has_the_pose_of_the_likelier_of_both() -> None:
    """The bundled photographs: each way round they have a likely pose. Features are kept of the two
    images alone."""
    first, second = map(load_image, bundled_photographs())
    mirrored = load_image(np.ascontiguousarray(second.pixels[:, ::-1]))
    caches = MatcherCaches()
    matcher = load_matcher(caches=caches)
    assert estimate_relative_pose(first, second, matcher=matcher).success
    for cache in (caches.features, caches.native):
        assert len({key[0] for key in cache._kept}) == 2
    assert estimate_relative_pose(first, mirrored, matcher=matcher).status == "mirrored"


@pytest.mark.parametrize("effort", ["fast", "auto"])
def test_a_quick_pass_without_an_answer_is_followed_by_the_whole(
    monkeypatch: pytest.MonkeyPatch, effort: Effort
) -> None:
    estimated = _with(monkeypatch, CERTAIN)
    search = _Steps().search(*PICTURES)
    search.has_quick = False
    pose = pose_of_pair(search, EXACT, EXACT, replace(OPTIONS, effort=effort))
    assert search.steps == ["quick", "match"] and len(estimated) == 1
    assert list(pose.seconds) == ["match", "estimate"]


def test_a_search_is_near_the_lines_of_all_hypotheses(monkeypatch: pytest.MonkeyPatch) -> None:
    _with(monkeypatch, {"probability": 0.5, "any_probability": 0.5})
    search = _Steps().search(*PICTURES)
    before = estimate_pose(search.every("before", 2).matches, EXACT, EXACT, OPTIONS)
    pose_of_pair(search, EXACT, EXACT, OPTIONS)
    assert len(search.views) == len(before.hypotheses) > 0
    for views, hypothesis in zip(search.views, before.hypotheses, strict=True):
        assert (views.camera1, views.camera2) == (EXACT, EXACT)
        np.testing.assert_allclose(views.R, hypothesis.R, atol=0.01)
        np.testing.assert_allclose(views.t, hypothesis.t, atol=0.05)
