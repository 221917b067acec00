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
from dgc_pose.estimation.options import Effort
from dgc_pose.estimation.problem import Hypothesis
from dgc_pose.images.cache import ImageCache
from dgc_pose.matches import Matches
from dgc_pose.matching import MatchResult


class _Steps(dense_scene.MapMatcher):
    """The map's matches: every fourth of them by the coarse step, every third by the refined one,
    every second in full, and all with the guided ones; none with the mirror image of image 2. It
    keeps the steps that were done."""

    def __init__(self) -> None:
        super().__init__(dense_scene.true_map(error_px=0.2))
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
        return None if is_mirrored else result

    def refined(self, image1: Image, image2: Image, result: MatchResult) -> MatchResult:
        return self.every("refine", 3)

    def match(self, image1: Image, image2: Image) -> MatchResult:
        return self.every("full", 2)

    def guided(
        self, image1: Image, image2: Image, result: MatchResult, hypotheses: Sequence[TwoViews]
    ) -> MatchResult:
        self.views = hypotheses
        return self.every("guided", 1)

    def second(self, image1: Image, image2: Image, result: MatchResult) -> MatchResult:
        return self.every("second", 1)


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


def _doubt(probability: float | None, others: float = 0.0) -> dict[str, Any]:
    if probability is None:
        return {"probability": None, "any_probability": None}
    total = probability + others
    values = {"probability": probability, "any_probability": total}
    return values | {"hypotheses": (_hypothesis(probability / total),)}


def _refused(probability: float, **evidence: Any) -> dict[str, Any]:
    """A pair without a pose, with a hypothesis that is right with so much."""
    return _doubt(probability) | {
        "status": "improbable",
        "R": None,
        "t": None,
        "covariance": None,
        "evidence": replace(GOOD_EVIDENCE, **evidence),
    }


def _hypothesis(share: float) -> Hypothesis:
    inliers, in_front = np.ones((2, 9), dtype=bool)
    return Hypothesis(np.eye(3), np.array([1.0, 0, 0]), inliers, in_front, share=share)


SECOND = ["coarse", "full", "guided", "second"]  # all steps of a pose
CERTAIN = _doubt(0.995)
ROTATION = _doubt(0.0, 0.5) | {"status": "rotation_only"}
LOOSE, LOOSER = (CERTAIN | {"covariance": variance * np.eye(6)} for variance in (1e-4, 1e-2))
OTHER_CAMERAS = CERTAIN | {"evidence": replace(GOOD_EVIDENCE, camera_agreement=0.98)}


@pytest.mark.parametrize(
    ("effort", "answers", "steps"),
    [
        ("auto", [CERTAIN], ["coarse"]),
        ("auto", [_doubt(0.9), CERTAIN], ["coarse", "full"]),
        ("auto", [_doubt(0.9), _doubt(0.9), CERTAIN], ["coarse", "full", "guided"]),
        ("auto", [LOOSE], ["coarse", "refine"]),  # certain, but not accurate
        ("auto", [LOOSER], ["coarse", "refine", "guided"]),
        ("auto", [OTHER_CAMERAS], ["coarse", "refine"]),  # few matches tell cameras apart less
        ("auto", [_doubt(None)], ["coarse", "full"]),  # nothing to compare with
        ("auto", [_doubt(0.5)], SECOND),  # a pose is of no mirror image
        ("auto", [_doubt(0.5, 0.495)], SECOND),  # one of two is right
        ("auto", [_refused(0.4)], [*SECOND, "mirrored"]),
        ("auto", [_refused(0.001)], ["coarse", "full", "second", "mirrored"]),  # hopeless
        ("auto", [_refused(0.4, camera_model="focal")], SECOND),  # the camera is what is wrong
        ("auto", [ROTATION | {"hypotheses": (_hypothesis(0.8),)}], SECOND),
        ("auto", [ROTATION | {"hypotheses": (_hypothesis(1.0),)}], ["coarse", "full"]),
        ("fast", [_refused(0.4)], ["coarse", "mirrored"]),
        ("thorough", [CERTAIN], ["full"]),
        ("thorough", [LOOSE, CERTAIN], ["full", "guided"]),
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
    expected = {"coarse": 4, "refine": 3, "full": 2, "guided": 1, "second": 1}[poses[-1]]
    assert len(last) == -(-len(matcher._match(*PICTURES).matches) // expected)


@pytest.mark.parametrize(
    ("before", "after", "last"), [(0.9, 0.6, 2), (0.6, 0.9, 3), (0.9, None, 2)]
)
def test_the_likelier_pose_stays_with_its_matches_after_the_second_step(
    monkeypatch: pytest.MonkeyPatch, before: float, after: float | None, last: int
) -> None:
    """None: the second matcher adds nothing. It has its seconds and no estimate."""
    estimated = _with(monkeypatch, *3 * [_doubt(before)], _doubt(after))
    if after is None:
        monkeypatch.setattr(_Steps, "second", lambda matcher, image1, image2, result: result)
    result = solve_pair(*PICTURES, (EXACT, EXACT), _Steps(), OPTIONS)
    assert result.pose.probability == max(before, after or 0)
    assert result.matches is estimated[last] and len(estimated) == 3 + (after is not None)
    assert list(result.pose.seconds) == [*SECOND, "estimate"]


def test_cameras_that_are_not_exact_have_all_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """The lines of the guided matches are of the cameras as fitted so far."""
    _with(monkeypatch, _refused(0.4))
    first, second = replace(EXACT, focal_std=0.05), EXACT
    matcher = _Steps()
    solve_pair(*PICTURES, (first, second), matcher, OPTIONS)
    assert matcher.steps == [*SECOND, "mirrored"]
    assert matcher.views
    for views in matcher.views:
        fitted = views.camera1
        assert views.camera2 is second
        assert fitted.focal_source == "matches" and fitted.focal_std < 0.05
        assert abs(fitted.focal / EXACT.focal - 1) < 3 * fitted.focal_std


def test_features_are_kept_of_the_two_images_and_not_of_the_mirror_image() -> None:
    cache = ImageCache()
    matcher = load_matcher(cache=cache)
    noise = np.random.default_rng(0).integers(0, 256, (2, 240, 320, 3), dtype=np.uint8)
    for first, second in (PICTURES, map(load_image, noise)):
        for image in list(cache._kept):
            cache.forget(image)
        estimate_relative_pose(first, second, EXACT, matcher=matcher)
        assert set(cache._kept) == {first, second}
