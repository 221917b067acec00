"""The model of the probability: applied as its file says, monotone, and with reasons."""

import dataclasses
import json
import math
import re
from typing import get_args

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from results import GOOD_EVIDENCE
from scenes import two_view_scene
from scipy.stats import norm

from dgc_pose import estimate_pose, estimate_relative_pose, load_image, load_matcher
from dgc_pose.cameras.pair_list import bundled_photographs
from dgc_pose.cli.output import pose_text
from dgc_pose.estimation.evidence import Evidence
from dgc_pose.estimation.probability import (
    CHOICE_FEATURES,
    FEATURES,
    MatchKind,
    bound_if_right,
    match_kind,
    parse_models,
    shipped_models,
)


def test_each_share_in_a_reason_is_of_something() -> None:
    texts = [feature.words(GOOD_EVIDENCE) for feature in FEATURES.values()]
    shares = [text for text in texts if "%" in text]
    assert "only 95 % of the inliers lie in front of both cameras" in shares and len(shares) > 5
    assert all(re.search(r"\d % (of |as many inliers)", text) for text in shares), shares


ERROR = {"slope": -0.25, "intercept": 0.5}
SAME_PLACE = {"slope": 7.0, "intercept": -2.0}
MODEL = {
    "weights": {name: 0.5 * feature.sign for name, feature in FEATURES.items()},
    "intercept": -2.0,
    "reference": {name: feature.value(GOOD_EVIDENCE) for name, feature in FEATURES.items()},
    "rotation_error": ERROR,
    "translation_error": ERROR,
    "choice": {"likelihood": 0.9, "map_agreement": 10.0, "lapse": 0.0},
}


def _text(**changes: object) -> str:
    models = {"network": MODEL | changes, "key_points": {**MODEL, "tested": ["sift", "xfeat"]}}
    engines = {"net": {"fingerprint": "abc"}}
    data = {"engine": engines, "focal_error": ERROR, "same_place": SAME_PLACE, "models": models}
    return json.dumps(data)


def _model():
    return parse_models(_text()).by_kind["network"]


def _worse(**changes: object) -> Evidence:
    return dataclasses.replace(GOOD_EVIDENCE, **changes)


def test_the_probability_is_the_logistic_function_of_the_weighted_features() -> None:
    odds = -2.0 + sum(0.5 * f.sign * f.value(GOOD_EVIDENCE) for f in FEATURES.values())
    assert _model().probability(GOOD_EVIDENCE) == pytest.approx(1 / (1 + math.exp(-odds)))


@pytest.mark.parametrize("part", ["rotation", "translation"])
@pytest.mark.parametrize("error_deg", [15.0, 90.0])
def test_the_probability_is_no_more_than_the_expected_errors_leave(part, error_deg) -> None:
    """Of a normal error that is below r nine times in ten, against SciPy."""
    model = parse_models(_text(intercept=30.0)).by_kind["network"]
    evidence = _worse(**{f"raw_{part}_90_deg": error_deg})
    calibrated = error_deg * getattr(model, f"{part}_error").factor(error_deg)
    within = 2 * norm.cdf(10 * norm.ppf(0.95) / calibrated) - 1
    assert model.probability(evidence) == pytest.approx(within, rel=1e-3)


@pytest.mark.parametrize("agreement", [0.0, 0.3, 0.9])
def test_the_probability_is_no_more_than_other_cameras_leave(agreement: float) -> None:
    model = parse_models(_text(intercept=30.0)).by_kind["network"]
    assert model.probability(GOOD_EVIDENCE) > 0.95
    evidence = _worse(camera_agreement=agreement, camera_model="two")
    assert model.probability(evidence) == agreement


@pytest.mark.parametrize(
    "changes",
    [
        {"chance_ratio": 0.2},
        {"raw_rotation_90_deg": 9.0},
        {"raw_rotation_90_deg": None},
        {"parallax": 1.5},
        {"homography_ratio": 0.95},
        {"other_ratio": 0.95},
        {"map_agreement": 0.3},
        {"camera_agreement": 0.4},
    ],
)
def test_worse_evidence_lowers_the_probability_and_is_named_first(changes) -> None:
    model, evidence = _model(), _worse(**changes)
    assert model.probability(evidence) < model.probability(GOOD_EVIDENCE)
    (reason, *_) = model.against(evidence)
    named = [f.words(evidence) for f in FEATURES.values()]
    assert reason in named and model.against(GOOD_EVIDENCE) == []


def test_what_surrounds_the_matches_has_a_probability_of_its_own() -> None:
    model = _model()
    assert model.same_place.probability(GOOD_EVIDENCE) == 1  # not known
    alike, unlike = _worse(context_ratio=0.9), _worse(context_ratio=0.1)
    # Fitted on pairs of which 8 % are of two places, for pairs of which 2 % are.
    odds = math.exp(7.0 * 0.9 - 2.0) * (0.98 / 0.02) / (0.92 / 0.08)
    assert model.same_place.probability(alike) == pytest.approx(odds / (1 + odds))
    assert model.probability(unlike) == model.probability(alike) == model.probability(GOOD_EVIDENCE)
    told = ["the surroundings of the matches differ between the images"]
    assert (model.against(alike), model.against(unlike)) == ([], told)
    worse = model.against(dataclasses.replace(unlike, inlier_ratio=0.2, chance_ratio=0.2))
    assert worse[:1] == told and 1 < len(worse) <= 3


@settings(max_examples=50, deadline=None)
@given(
    st.integers(0, 10**6),
    st.floats(0, 1),
    st.floats(0, 1),
    st.floats(-1e5, math.inf),
    st.one_of(st.none(), st.floats(0, 180)),
)
def test_any_evidence_has_a_probability(count, ratio, chance, alarms, error) -> None:
    evidence = _worse(
        num_inliers=count,
        occupied_cells=count,
        inlier_ratio=ratio,
        chance_ratio=chance,
        log10_false_alarms=alarms,
        raw_rotation_90_deg=error,
        raw_translation_90_deg=error,
        parallax=ratio,
        threshold_cells=0.0,
    )
    assert 0 < _model().probability(evidence) < 1
    assert all(isinstance(reason, str) for reason in _model().against(evidence))


def test_the_covariance_is_scaled_by_the_calibrated_error() -> None:
    model = _model()
    root = np.random.default_rng(0).standard_normal((6, 6))
    covariance = root @ root.T * 1e-4
    scaled = model.calibrated(covariance, GOOD_EVIDENCE)
    expected = [math.exp(0.5 - 0.25 * math.log(own)) for own in (0.5, 1.0)]
    assert np.allclose(scaled[:3, :3], covariance[:3, :3] * expected[0] ** 2, rtol=1e-3)
    assert np.allclose(scaled[3:, 3:], covariance[3:, 3:] * expected[1] ** 2, rtol=1e-3)
    assert np.allclose(scaled, scaled.T) and np.linalg.eigvalsh(scaled).min() > -1e-12


@pytest.mark.parametrize("error_deg", [0.2, 9.0, 14.0, 40.0])
def test_the_error_of_a_right_pose_is_that_of_normal_errors_up_to_10_degrees(error_deg) -> None:
    errors = np.abs(np.random.default_rng(0).normal(0, error_deg / 1.6449, 200_000))
    expected = np.quantile(errors[errors <= 10], 0.9)
    assert bound_if_right(error_deg) == pytest.approx(expected, rel=0.01)


def test_the_kind_of_matches_chooses_the_model() -> None:
    kinds = [
        match_kind(key_points=key_points, with_map=with_map, fitted=fitted)
        for key_points in (False, True)
        for with_map, fitted in ((True, False), (False, False), (True, True), (False, True))
    ]
    assert kinds[:4] == ["network", "matches", "network_auto", "matches_auto"]
    assert kinds[4:] == 2 * ["key_points"] + 2 * ["key_points_auto"]


@pytest.mark.parametrize(
    ("weights", "key_points", "kind"),
    [("abc", False, "network"), ("def", False, None), (None, False, None)]
    + [(weights, True, "key_points") for weights in ("abc", "def", None)],
)
def test_a_model_is_for_the_networks_that_it_is_fitted_on(weights, key_points, kind) -> None:
    """And one of key points of any detector, which names those that it was tested on."""
    models = parse_models(_text())
    found = models.model(weights, key_points=key_points, with_map=True, fitted=False)
    assert found is (kind and models.by_kind[kind])
    assert found is None or found.tested == (("sift", "xfeat") if key_points else ())


@pytest.mark.parametrize("known", [True, False], ids=["K", "auto"])
def test_key_points_of_any_detector_have_a_probability(known: bool) -> None:
    """Also those that nothing describes; matches of an unknown dense map have none."""
    tested = shipped_models().by_kind["key_points"].tested
    scene = two_view_scene("skew", count=400, sigma_px=0.3, outliers=0.3)
    cameras = scene.cameras if known else scene.auto()
    matches = dataclasses.replace(scene.matches, key_points=True)
    pose = estimate_pose(matches, *cameras)
    assert pose.success and pose.probability > (0.95 if known else 0.5)
    assert max(scene.errors_deg(pose)) < (1 if known else 10)
    assert pose.tested_matchers == tested
    assert pose.to_dict()["tested_matchers"] == [*tested]
    text = pose_text(pose)
    assert f"the probability of key points was tested for {', '.join(tested)}" in text
    # Whatever the confidence: a detector's own scale does not count.
    doubted = dataclasses.replace(matches, confidence=0.1 * matches.confidence)
    assert estimate_pose(doubted, *cameras).probability == pose.probability
    points2 = np.random.default_rng(0).permutation(matches.points2)
    wrong = estimate_pose(dataclasses.replace(matches, points2=points2), *cameras)
    assert not wrong.success and wrong.probability < 0.3
    dense = dataclasses.replace(matches, key_points=False)
    pose = estimate_pose(dense, *cameras)
    assert pose.probability is None and pose.tested_matchers == ()
    assert "tested" not in pose_text(pose)


def test_sift_has_a_probability_on_photographs() -> None:
    halves = [
        cv2.resize(load_image(path).pixels, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        for path in bundled_photographs()
    ]
    pose = estimate_relative_pose(*halves, matcher="sift")
    assert pose.success and 0.8 < pose.probability < 1 and "sift" in pose.tested_matchers


def test_the_package_s_own_file_can_be_read() -> None:
    assert {*shipped_models().by_kind} == {*get_args(MatchKind)}
    assert shipped_models().weights == {load_matcher().fingerprint}
    for model in shipped_models().by_kind.values():
        assert all(FEATURES[name].sign * w >= 0 for name, w in model.weights.items())
        assert set(model.choice) <= {*CHOICE_FEATURES, "lapse"}
        assert all(weight >= 0 for weight in model.choice.values())
