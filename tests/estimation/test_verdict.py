import dataclasses

import pytest
from results import GOOD_EVIDENCE

from dgc_pose.estimation.camera_model import MODELS
from dgc_pose.estimation.verdict import judge

LEAST = 0.5  # probability of a success
ROTATES = {"rotation_share": 1.0, "parallax": 1.0}
TURNS = {"rotation_share": 0.95}
MANY = {"num_rotation_inliers": 10_000}
SECOND = {"num_second_inliers": 30, "second_rotation_deg": 17.24}  # a motion that contradicts it


def _changed(**changes):
    return dataclasses.replace(GOOD_EVIDENCE, **changes)


def verdict(**changes):
    return judge(_changed(**changes), LEAST)


CYLINDER = {"camera_model": "cylinder"}
PLANE = {"homography_ratio": 0.9}
# What closes a gate, and what leaves it open on its other side. Chance comes before all, then the
# camera, and a rotation before cheirality and planes.
CERTAIN = [
    ("chance_inliers", {"log10_false_alarms": -1.0}, {}),
    ("chance_inliers", {**CYLINDER, "log10_false_alarms": -1.0}, {}),
    *(("panorama", CYLINDER, {"camera_model": name}) for name in MODELS if name != "cylinder"),
    ("panorama", {**CYLINDER, **ROTATES, **SECOND}, {}),
    ("panorama", {**CYLINDER, "cheirality_ratio": 0.4}, {}),
    ("rotation_only", ROTATES, {"rotation_share": 0.7, "parallax": 1.0}),
    ("rotation_only", {**ROTATES, **SECOND, "num_second_inliers": 0}, {}),
    ("rotation_only", {**ROTATES, **SECOND, "second_rotation_deg": 2.9}, {}),
    ("rotation_only", {**ROTATES, "cheirality_ratio": 0.4}, {}),
    ("rotation_only", {"still_ratio": 0.95, **SECOND, "second_rotation_deg": 2.9}, {}),
    ("rotation_only", {"still_ratio": 0.91}, {"still_ratio": 0.89}),
    # At most 1.5 x (1 + 4 / sqrt(100)) = 2.1
    ("rotation_only", {**TURNS, "parallax": 1.0}, {**TURNS, "parallax": 2.2}),
    ("rotation_only", {**TURNS, "parallax": 1.6}, {**TURNS, "parallax": 1.6, **MANY}),
    ("rotation_only", {"strict_rotation_share": 0.92}, {"strict_rotation_share": 0.88}),
    ("rotation_only", {"strict_rotation_share": 0.92, "raw_rotation_90_deg": 180.0}, {}),
    ("collinear", {"collinear": True}, {}),
    ("behind_cameras", {"cheirality_ratio": 0.55}, {"cheirality_ratio": 0.65}),
    ("ambiguous", {**ROTATES, **SECOND, "second_rotation_deg": 3.1}, {}),
    ("ambiguous", {"still_ratio": 0.95, **SECOND}, {}),
]
GATES = [
    ("chance_inliers", {"num_inliers": 14}, {"num_inliers": 15}),
    ("chance_inliers", {"inlier_ratio": 0.14}, {"inlier_ratio": 0.151}),
    ("chance_inliers", {"chance_ratio": 0.21}, {"chance_ratio": 0.19}),
    ("chance_inliers", {"occupied_cells": 19}, {"occupied_cells": 20}),
    ("chance_inliers", {"occupied_cells": 5}, {"occupied_cells": 5, "key_points": True}),
    ("chance_inliers", {**CYLINDER, "inlier_ratio": 0.1}, {}),
    ("chance_inliers", {**ROTATES, **SECOND, "inlier_ratio": 0.1}, {}),
    ("chance_inliers", {**ROTATES, "inlier_ratio": 0.1}, {}),
    ("undetermined", {"raw_rotation_90_deg": 25.0}, {"raw_rotation_90_deg": 23.0}),
    ("undetermined", {"raw_translation_90_deg": 25.0}, {"raw_rotation_90_deg": None}),
    ("ambiguous", {"num_second_inliers": 30}, {}),
    ("planar", PLANE, {"homography_ratio": 0.84}),
    ("planar", {**PLANE, "around_plane": 0.09}, {"homography_ratio": 0.84, "around_plane": 0.11}),
    ("ambiguous", {**PLANE, "around_plane": 0.11}, {}),
    ("planar", {**PLANE, "around_plane": 0.11, "key_points": True}, {}),
]


@pytest.mark.parametrize(("status", "closed", "other_side"), [*CERTAIN, *GATES])
def test_each_gate_closes_by_itself_and_is_open_on_its_other_side(status, closed, other_side):
    assert verdict(**closed).status == status
    assert verdict(**other_side) == ("ok", "a pose", ())


@pytest.mark.parametrize("probability", [0.01, 0.99])
@pytest.mark.parametrize(("status", "closed", "_"), CERTAIN)
def test_what_is_certain_is_no_pose_whatever_its_probability(status, closed, _, probability):
    verdict = judge(_changed(**closed), LEAST, probability)
    assert verdict.status == status
    if status == "ambiguous":
        assert "30 other matches fit a motion with a rotation" in verdict.reason
        assert f"{closed['second_rotation_deg']:.1f} deg" in verdict.reason


def test_a_small_triangulation_angle_and_a_plane_give_warnings():
    status, _, warnings = verdict(median_triangulation_angle_deg=0.5, homography_ratio=0.9)
    assert status == "planar"
    assert len(warnings) == 2
    assert "0.50 deg" in warnings[0] and "90 %" in warnings[1]


# By default a pose has a probability of at least 0.5, and a share of at least 0.8.
@pytest.mark.parametrize("focal_percent", [None, 30.0])
@pytest.mark.parametrize(
    ("status", "probability", "shares", "same_place"),
    [
        ("ok", 0.5, (), 1.0),
        ("improbable", 0.49, (), 1.0),
        ("ok", 0.63, (0.8, 0.2), 1.0),  # 0.504
        ("improbable", 0.62, (0.8, 0.2), 1.0),  # 0.496
        ("ambiguous", 0.99, (0.79, 0.21), 1.0),  # although 0.782
        ("ambiguous", 0.5, (0.79, 0.21), 1.0),  # 0.395
        ("ambiguous", 0.5, (0.4, 0.3, 0.3), 1.0),
        ("improbable", 0.49, (0.79, 0.21), 1.0),  # probably none of them
        ("ok", 0.99, (), 0.6),
        ("improbable", 0.99, (), 0.5),
        ("improbable", 0.6, (), 0.8),
        ("ok", 0.6, (), 0.9),
        ("ok", 0.72, (), 0.7),
        ("improbable", 0.7, (), 0.7),
    ],
)
def test_a_pose_of_one_place_is_claimed_if_it_is_probable_and_clearly_the_likeliest(
    status, probability, shares, same_place, focal_percent
):
    """Fitted focal lengths need no other probability. What is compared is what is printed, of the
    pose and the place together."""
    evidence = _changed(raw_focal_90_percent=focal_percent)
    verdict = judge(evidence, LEAST, probability, ("unlike",), shares, same_place=same_place)
    assert verdict.status == status
    if status == "improbable" and not shares:
        told = f"probability {100 * probability * same_place:.0f} %"
        assert told in verdict.reason and verdict.reason.endswith("below the required 50 %: unlike")


def test_an_ambiguous_pair_has_the_probabilities_of_its_poses_in_words():
    assert judge(GOOD_EVIDENCE, LEAST, 0.97, ("few",), (0.536, 0.464)).reason == (
        "two poses explain the matches: probabilities 52 % and 45 %"
    )
    assert judge(GOOD_EVIDENCE, LEAST, 0.8, (), (0.5, 0.3, 0.2)).reason == (
        "3 poses explain the matches: probabilities 40 %, 24 % and 16 %"
    )


def test_the_probability_decides_and_not_the_gates() -> None:
    few = _changed(num_inliers=12, occupied_cells=9)
    assert judge(few, LEAST).status == "chance_inliers"
    assert judge(few, LEAST, 0.5).status == "ok"
    assert judge(GOOD_EVIDENCE, 0.3, 0.4).status == "ok"
    assert judge(GOOD_EVIDENCE, None, 0.1).status == "ok"
    for ratio, percent in ((0.97, 3.3), (0.94, 31.0)):
        plane = _changed(homography_ratio=ratio, raw_focal_90_percent=percent)
        assert judge(plane, LEAST, 0.95).status == "planar"
    plane = _changed(homography_ratio=0.97, raw_focal_90_percent=31.0)
    assert "plane does not determine the focal length" in judge(plane, LEAST, 0.95).reason


def test_a_failed_gate_gives_the_status_and_the_evidence_the_reason() -> None:
    against = ["only 28 % of the matches are inliers", "there is little parallax"]
    status, reason, _ = judge(_changed(occupied_cells=8), LEAST, 0.231, against)
    assert status == "chance_inliers"
    assert reason == (
        "probability 23 %, below the required 50 %: "
        "only 28 % of the matches are inliers, "
        "there is little parallax"
    )
