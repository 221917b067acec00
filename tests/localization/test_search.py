"""The choice of references, and the verdict."""

from dataclasses import replace

import numpy as np
import pytest
from world_scene import OPTIONS, PHOTO_CAMERA, WorldScene, world_scene

from dgc_pose.estimation import RelativePose
from dgc_pose.localization.location import Location
from dgc_pose.localization.search import MAX_REFERENCES, ReferenceSearch
from dgc_pose.metrics import rotation_error_deg, translation_error_deg

NO_POINTS = np.zeros((0, 3)), np.zeros((0, 2))
NO_POSE = RelativePose("too_few_matches", "few", np.zeros(0, bool), 0)


def _searched(scene: WorldScene, **pair: float | None) -> tuple[Location, list[str]]:
    """The location, and the references in the order in which they were asked for."""
    search = ReferenceSearch(scene.model(), PHOTO_CAMERA, OPTIONS, scene.names)
    asked = []
    while (name := search.next_reference()) is not None:
        number = scene.names.index(name)
        search.add(name, scene.pair_pose(number, **pair), scene.matches(number), *NO_POINTS)
        asked.append(name)
    return search.location(), asked


def test_references_that_agree_give_the_pose() -> None:
    scene = world_scene()
    location, asked = _searched(scene)
    assert location.success and location.R is not None and location.centre is not None
    assert asked[:2] == scene.names[:2]  # the most similar first
    assert rotation_error_deg(location.R, scene.R) < 0.1
    assert np.linalg.norm(location.centre - scene.centre) < 0.02
    assert location.probability > 0.99
    assert [r.name for r in location.references if r.agrees] == asked
    for reference in location.references:
        inliers = reference.inliers
        assert len(inliers) == len(reference.matches) and 0.7 < inliers.mean() < 0.9
    np.testing.assert_allclose(location.cam_from_world[:, 3], -location.R @ location.centre)
    data = location.to_dict()
    assert data["status"] == "located" and data["references"][0]["agrees"]
    assert data["position_error_90"] == pytest.approx(location.position_error_90)


def test_the_next_reference_is_spread_around_the_photograph() -> None:
    """After two on the right, one of the left is worth more than further ones of the right."""
    centres = np.array([[1.2, 0, 0], [1.5, 0, 0], [1.8, 0.1, 0], [2.0, 0, 0], [-1.2, 1.0, 0]])
    _, asked = _searched(world_scene(centres))
    assert asked[2] == "r4.jpg"


def test_one_line_of_sight_has_no_scale() -> None:
    scene = world_scene()
    away = np.array([1.0, 0.2, 0.0])
    line = world_scene(np.stack([scene.centre + k * away for k in (0.5, 1.0, 1.5)]))
    location, _ = _searched(line)
    assert location.status == "no_scale" and "one line of sight" in location.reason
    assert location.R is not None and location.direction is not None and location.t is None
    assert rotation_error_deg(location.R, scene.R) < 1
    assert translation_error_deg(location.direction, -away / np.linalg.norm(away)) < 3


def test_one_reference_has_no_scale_and_points_have() -> None:
    scene = world_scene(np.array([[1.0, 0, 0]]))
    location, _ = _searched(scene)
    assert location.status == "no_scale" and "r0.jpg alone" in location.reason
    search = ReferenceSearch(scene.model(), PHOTO_CAMERA, OPTIONS, scene.names)
    seen = scene.pixels(PHOTO_CAMERA, scene.R, scene.centre)
    points = scene.points[:60], seen[:60]
    search.add("r0.jpg", scene.pair_pose(0), scene.matches(0), *points)
    location = search.location()
    assert location.success and location.centre is not None
    assert np.linalg.norm(location.centre - scene.centre) < 0.02


def test_unrelated_references_end_the_search_early() -> None:
    centres = np.column_stack([np.linspace(-2, 2, 12), np.zeros(12), np.zeros(12)])
    scene = world_scene(centres, count=30)
    search = ReferenceSearch(scene.model(), PHOTO_CAMERA, OPTIONS, scene.names)
    count = 0
    while (name := search.next_reference()) is not None:
        search.add(name, NO_POSE, scene.matches(0).subset(np.zeros(30, bool)), *NO_POINTS)
        count += 1
    location = search.location()
    assert count == 5 < MAX_REFERENCES
    assert location.status == "nowhere" and location.probability == 0
    assert location.reason == "none of 5 references has a pose that is likely"


def test_pairs_that_contradict_each_other_are_nowhere() -> None:
    scene = world_scene(np.array([[1.2, 0, 0], [-1.2, 0.4, 0]]))
    search = ReferenceSearch(scene.model(), PHOTO_CAMERA, OPTIONS, scene.names)
    search.add("r0.jpg", scene.pair_pose(0), scene.matches(0), *NO_POINTS)
    other = world_scene(np.array([[0.5, 3, 4.0], [-3, 0.4, 2.0]]), seed=7)
    pose = other.pair_pose(1)
    search.add("r1.jpg", pose, other.matches(1), *NO_POINTS)
    assert search.location().status == "nowhere"


def test_poses_whose_probability_is_not_known_place_a_photograph_if_they_agree() -> None:
    scene = world_scene()
    location, _ = _searched(scene, probability=None)
    assert location.success and location.R is not None and location.centre is not None
    assert rotation_error_deg(location.R, scene.R) < 0.1
    assert location.probability is None and location.to_dict()["probability"] is None
    assert {reference.probability for reference in location.references} == {None}


@pytest.mark.parametrize(("probability", "status"), [(0.05, "nowhere"), (0.9, "located")])
def test_improbable_pairs_place_nothing(probability: float, status: str) -> None:
    scene = world_scene(np.array([[1.2, 0, 0], [-1.2, 0.4, 0]]))
    search = ReferenceSearch(scene.model(), PHOTO_CAMERA, OPTIONS, scene.names)
    for number, name in enumerate(scene.names):
        pose = scene.pair_pose(number, probability=probability)
        if status == "nowhere":
            pose = replace(pose, status="improbable")
        search.add(name, pose, scene.matches(number), *NO_POINTS)
    assert search.location().status == status
