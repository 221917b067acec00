"""The steps of the search for a pose: which are done, and what each is estimated from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
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
    load_matcher,
    solve_pair,
)
from dgc_pose.cameras.camera import TwoViews
from dgc_pose.cameras.pair_list import bundled_photographs, rendered_pair
from dgc_pose.estimation.hypothesis import Hypothesis
from dgc_pose.estimation.options import Effort
from dgc_pose.matches import Matches
from dgc_pose.matching import MatchResult
from dgc_pose.matching.cache import image_cache


class _Steps(dense_scene.MapMatcher):
    """The map's matches: every fourth of them by the coarse step, every third by the refined one,
    every second in full, and all with the guided ones. Of the mirror image of image 2 every fourth
    or none. It keeps the steps that were done."""

    def __init__(self, *, has_coarse: bool = True, of_mirror_image: bool = False) -> None:
        super().__init__(dense_scene.true_map(error_px=0.2))
        self.has_coarse, self.of_mirror_image = has_coarse, of_mirror_image
        self.steps: list[str] = []
        self.views: Sequence[TwoViews] = ()

    def every(self, step: str, count: int) -> MatchResult:
        self.steps.append(step)
        result = self._match(*PICTURES)
        rows = np.arange(len(result.matches)) % count == 0
        return replace(result, matches=result.matches.subset(rows))

    def coarse(self, image1: Image, image2: Image) -> MatchResult | None:
        is_mirrored = image2 is not PICTURES[1]
        result = self.every("mirrored" if is_mirrored else "coarse", 4)
        return result if (self.of_mirror_image if is_mirrored else self.has_coarse) else None

    def refined(self, image1: Image, image2: Image, result: MatchResult) -> MatchResult:
        return self.every("refine", 3)

    def match(self, image1: Image, image2: Image) -> MatchResult:
        return self.every("full", 2)

    def guided(
        self, image1: Image, image2: Image, result: MatchResult, hypotheses: Sequence[TwoViews]
    ) -> MatchResult:
        self.views = hypotheses
        return self.every("guided", 1)


_FIRST, _SECOND = dense_scene.pictures()
PICTURES = load_image(_FIRST), load_image(_SECOND)
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
SEARCHED = ["mirrored", "guided"]


@pytest.mark.parametrize(
    ("effort", "answers", "steps"),
    [
        ("auto", [CERTAIN], ["coarse"]),
        ("auto", [CERTAIN | LOOSELY], ["coarse", "mirrored"]),
        ("fast", [CERTAIN | _doubt(0.96)], ["coarse", "mirrored"]),
        ("fast", [CERTAIN | {"any_probability": 0.89}], ["coarse", "mirrored"]),
        ("fast", [CERTAIN | {"any_probability": 0.91}], ["coarse"]),
        ("auto", [_doubt(0.9), CERTAIN], ["coarse", "full"]),
        ("auto", [LOOSE], ["coarse", "refine"]),  # certain, but not accurate
        ("auto", [LOOSE, _doubt(0.9), CERTAIN], ["coarse", "refine", "full"]),
        ("auto", [LOOSER], ["coarse", "refine", *SEARCHED[1:]]),
        ("auto", [_doubt(None)], ["coarse", "full"]),  # nothing to compare the mirror image with
        ("auto", [_doubt(0.5)], ["coarse", "full", *SEARCHED]),
        ("auto", [_doubt(0.0, 0.9)], ["coarse", "full", *SEARCHED]),  # an ambiguous pair
        ("auto", [ROTATION | {"hypotheses": (_of_share(0.8),)}], ["coarse", "full", *SEARCHED[1:]]),
        ("auto", [ROTATION | {"hypotheses": (_of_share(1.0),)}], ["coarse", "full"]),
        ("auto", [_doubt(0.8)], ["coarse", "full", *SEARCHED]),
        ("auto", [_doubt(0.5, 0.495)], ["coarse", "full", *SEARCHED]),  # one of two is right
        ("auto", [_doubt(0.96, 0.035)], ["coarse", "mirrored"]),
        ("auto", [_doubt(0.001)], ["coarse", "full", "mirrored"]),  # hopeless
        ("fast", [_doubt(0.5)], ["coarse", "mirrored"]),
        ("fast", [LOOSE], ["coarse"]),
        ("thorough", [CERTAIN], ["full"]),
        ("thorough", [LOOSE, CERTAIN], ["full", *SEARCHED[1:]]),
        ("thorough", [_doubt(0.5)], ["full", *SEARCHED]),
    ],
)
def test_steps_are_done_as_long_as_they_may_change_the_answer(
    monkeypatch: pytest.MonkeyPatch, effort: Effort, answers: Any, steps: list[str]
) -> None:
    estimated = _with(monkeypatch, *answers)
    matcher = _Steps()
    result = solve_pair(*PICTURES, (EXACT, EXACT), matcher, replace(OPTIONS, effort=effort))
    pose, last = result.pose, result.matches
    poses = [step for step in steps if step != "mirrored"]
    assert matcher.steps == steps and list(pose.seconds) == [*poses, "estimate"]
    assert len(estimated) == len(poses)
    assert last is estimated[-1] and len(pose.inliers) == len(last)
    expected = {"coarse": 4, "refine": 3, "full": 2, "guided": 1}[poses[-1]]
    assert len(last) == -(-len(matcher._match(*PICTURES).matches) // expected)


def test_a_coarse_pass_is_not_enough_to_tell_a_wrong_k(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rendered scene whose matches tell the focal length."""
    wrong = Camera(np.diag([1.15, 1.15, 1]) @ dense_scene.K, dense_scene.SIZE)
    for camera, steps in ((EXACT, ["coarse"]), (wrong, ["coarse", "refine"])):
        _with(monkeypatch, CERTAIN)
        matcher = _Steps()
        solve_pair(*PICTURES, (camera, camera), matcher, OPTIONS)
        assert matcher.steps[:2] == steps


@pytest.mark.parametrize("uncertain", [1, 2])
def test_focal_lengths_that_are_not_known_need_all_the_matches(
    monkeypatch: pytest.MonkeyPatch, uncertain: int
) -> None:
    _with(monkeypatch, _doubt(0.5))
    first, second = (replace(EXACT, focal_std=0.02 * (n == uncertain)) for n in (1, 2))
    matcher = _Steps()
    solve_pair(*PICTURES, (first, second), matcher, OPTIONS)
    assert matcher.steps == ["full", "mirrored"]


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
    estimated = _with(monkeypatch, own, own, answer)
    matcher = _Steps(of_mirror_image=True)
    result = solve_pair(*PICTURES, (EXACT, EXACT), matcher, OPTIONS)
    steps, pose = ["coarse", "full", "mirrored"], result.pose
    assert matcher.steps == (steps if status == "mirrored" else [*steps, "guided"])
    assert pose.status == status and len(pose.inliers) == len(result.matches)
    if status == "mirrored":
        assert result.matches is estimated[1] and not pose.success and "mirror image" in pose.reason
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
    cache = image_cache()
    matcher = load_matcher(cache=cache)
    assert estimate_relative_pose(first, second, matcher=matcher).success
    assert len({key[0] for key in cache._kept}) == 2
    assert estimate_relative_pose(first, mirrored, matcher=matcher).status == "mirrored"


@pytest.mark.parametrize("effort", ["fast", "auto"])
def test_a_coarse_pass_without_an_answer_is_followed_by_the_full_one(
    monkeypatch: pytest.MonkeyPatch, effort: Effort
) -> None:
    estimated = _with(monkeypatch, CERTAIN)
    matcher = _Steps(has_coarse=False)
    options = replace(OPTIONS, effort=effort)
    pose = solve_pair(*PICTURES, (EXACT, EXACT), matcher, options).pose
    assert matcher.steps == ["coarse", "full"] and len(estimated) == 1
    assert list(pose.seconds) == ["full", "estimate"]


def test_guided_matches_are_near_the_lines_of_all_hypotheses(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _with(monkeypatch, {"probability": 0.5, "any_probability": 0.5})
    matcher = _Steps()
    before = estimate_pose(matcher.every("before", 2).matches, EXACT, EXACT, OPTIONS)
    solve_pair(*PICTURES, (EXACT, EXACT), matcher, OPTIONS)
    assert len(matcher.views) == len(before.hypotheses) > 0
    for views, hypothesis in zip(matcher.views, before.hypotheses, strict=True):
        assert (views.camera1, views.camera2) == (EXACT, EXACT)
        np.testing.assert_allclose(views.R, hypothesis.R, atol=0.01)
        np.testing.assert_allclose(views.t, hypothesis.t, atol=0.05)
