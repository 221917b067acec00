"""The choice of database images, and the verdict."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from worlds import OPTIONS, PHOTO_CAMERA, WorldScene, world_scene

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import RelativePose
from dgc_pose.localization.location import Location
from dgc_pose.localization.search import MAX_IMAGES, LocationSearch
from dgc_pose.metrics import rotation_error_deg, translation_error_deg
from dgc_pose.model import Model

NO_POINTS = np.zeros(0, np.int64), np.zeros((0, 2))
NO_POSE = RelativePose("too_few_matches", "few", np.zeros(0, bool), 0)
MIRRORED = RelativePose("mirrored", "the mirror image has a pose", np.zeros(300, bool), 300)
AROUND = np.array([[2.5, 0, 0], [-2.5, 1.5, 0], [0.3, -2.5, 0.1], [-1, 2.0, 1.0]])
BESIDE = np.array([[1.2, 0, 0], [-1.2, 0.4, 0], [0.5, 0.2, 0.1], [-0.6, 0, 0.2]])


@cache
def _scene() -> WorldScene:
    return world_scene()


@cache
def _pose_of_scene(number: int) -> RelativePose:
    return _scene().pair_pose(number)


def _pair_pose(scene: WorldScene, number: int) -> RelativePose:
    return _pose_of_scene(number) if scene is _scene() else scene.pair_pose(number)


def _searched(scene: WorldScene) -> tuple[Location, list[str]]:
    """The location, and the images in the order in which they were asked for."""
    search = LocationSearch(scene.model(), PHOTO_CAMERA, OPTIONS, scene.names)
    asked = []
    while (name := search.next_image()) is not None:
        number = scene.names.index(name)
        search.add(name, _pair_pose(scene, number), scene.matches(number), *NO_POINTS)
        asked.append(name)
    return search.location(), asked


def _search_of(
    scene: WorldScene,
    poses: Sequence[RelativePose],
    camera: Camera = PHOTO_CAMERA,
    model: Model | None = None,
) -> LocationSearch:
    """With these poses of the first pairs."""
    search = LocationSearch(model or scene.model(), camera, OPTIONS, scene.names)
    for number, pose in enumerate(poses):
        search.add(scene.names[number], pose, scene.matches(number), *NO_POINTS)
    return search


def _poses(scene: WorldScene) -> list[RelativePose]:
    return [_pair_pose(scene, number) for number in range(len(scene.names))]


def test_database_images_that_agree_give_the_pose() -> None:
    scene = _scene()
    location, asked = _searched(scene)
    assert location.success and location.R is not None and location.centre is not None
    assert asked[:2] == scene.names[:2]  # the most similar first
    assert rotation_error_deg(location.R, scene.R) < 0.1
    assert np.linalg.norm(location.centre - scene.centre) < 0.02
    assert location.probability > 0.99
    assert [r.name for r in location.database_images if r.agrees] == asked
    for matched in location.database_images:
        inliers = matched.inliers
        assert len(inliers) == len(matched.matches) and 0.7 < inliers.mean() < 0.9
    np.testing.assert_allclose(location.cam_from_world[:, 3], -location.R @ location.centre)
    data = location.to_dict()
    assert data["status"] == "located" and data["references"][0]["agrees"]
    assert data["position_error_90"] == pytest.approx(location.position_error_90)


@pytest.mark.parametrize(("share", "most"), [(0.05, 0.9), (0.1, 0.5)])
def test_the_probability_is_no_more_than_the_expected_errors_allow(
    share: float, most: float
) -> None:
    """share: of the extent, the expected error of the centre."""
    scene = _scene()
    search = _search_of(scene, _poses(scene))
    before = search.location()
    assert search.covariance is not None and before.position_error_90 is not None
    factor = share * scene.model().extent / before.position_error_90
    search.covariance = search.covariance.copy()
    search.covariance[3:6, 3:6] *= factor**2
    location = search.location()
    assert location.success and location.probability is not None
    assert location.position_error_90 == pytest.approx(share * scene.model().extent)
    assert 0.5 * most < location.probability <= most


def test_the_next_image_is_spread_around_the_query() -> None:
    """After two on the right, one of the left is worth more than further ones of the right."""
    centres = np.array([[1.2, 0, 0], [1.5, 0, 0], [1.8, 0.1, 0], [2.0, 0, 0], [-1.2, 1.0, 0]])
    _, asked = _searched(world_scene(centres))
    assert asked[2] == "r4.jpg"


def test_one_line_of_sight_has_no_scale() -> None:
    scene = _scene()
    away = np.array([1.0, 0.2, 0.0])
    line = world_scene(np.stack([scene.centre + k * away for k in (0.5, 1.0, 1.5)]))
    location, _ = _searched(line)
    assert location.status == "no_scale" and "one line of sight" in location.reason
    assert location.R is not None and location.direction is not None and location.t is None
    assert rotation_error_deg(location.R, scene.R) < 1
    assert translation_error_deg(location.direction, -away / np.linalg.norm(away)) < 3


def test_one_database_image_has_no_scale_and_points_have() -> None:
    scene = world_scene(np.array([[1.0, 0, 0]]))
    location, _ = _searched(scene)
    assert location.status == "no_scale" and "only r0.jpg" in location.reason
    model = replace(scene.model(), points=scene.points)
    search = LocationSearch(model, PHOTO_CAMERA, OPTIONS, scene.names)
    seen = scene.pixels(PHOTO_CAMERA, scene.R, scene.centre)
    points = np.arange(60), seen[:60]
    search.add("r0.jpg", scene.pair_pose(0), scene.matches(0), *points)
    location = search.location()
    assert location.success and location.centre is not None
    assert np.linalg.norm(location.centre - scene.centre) < 0.02
    assert location.position_error_90 is not None and location.position_error_90 < 0.05
    np.testing.assert_array_equal(location.database_images[0].points, points[0])
    np.testing.assert_array_equal(location.database_images[0].seen, points[1])


def test_unrelated_images_end_the_search_early() -> None:
    centres = np.column_stack([np.linspace(-2, 2, 12), np.zeros(12), np.zeros(12)])
    scene = world_scene(centres, count=30)
    assert _search_of(scene, [NO_POSE] * 4).next_image() is not None
    search = _search_of(scene, [NO_POSE] * 5)
    location = search.location()
    assert search.next_image() is None and MAX_IMAGES > 5
    assert location.status == "nowhere" and location.probability == 0
    assert location.reason == "none of 5 database images has a likely pose"


@pytest.mark.parametrize("probability", [0.05, None])
def test_improbable_pairs_place_nothing(probability: float | None) -> None:
    """Those whose probability is not known do, if they agree."""
    scene = world_scene(BESIDE[:2])
    poses = [scene.pair_pose(number, probability=probability) for number in (0, 1)]
    if probability == 0.05:
        poses = [replace(pose, status="improbable") for pose in poses]
    location = _search_of(scene, poses).location()
    assert location.success == (probability != 0.05)
    assert [image.agrees for image in location.database_images] == [location.success] * 2
    if probability is None:
        assert location.probability is None and location.to_dict()["probability"] is None


@pytest.mark.parametrize(("right", "status"), [(2, "nowhere"), (5, "located")])
def test_mirror_images_that_have_a_pose_are_against_the_location(right: int, status: str) -> None:
    scene = _scene()
    location = _search_of(scene, _poses(scene)[:right] + [MIRRORED] * (5 - right)).location()
    assert location.status == status
    if status == "nowhere":
        mirrored = f"the mirror image of the query fits {5 - right} database images: flip the query"
        assert location.reason == mirrored


def test_a_model_that_contradicts_its_images_is_told() -> None:
    """With world_from_cam in place of cam_from_world, the angles between the images are as observed
    here by SciPy; and the camera of the next pair is the one that was stated."""
    scene = world_scene(AROUND)
    model = scene.model()
    inverse = {name: np.column_stack([p[:, :3].T, p[:, 3]]) for name, p in model.poses.items()}
    wrong = replace(model, poses=inverse)
    location = _search_of(scene, _poses(scene), model=wrong).location()
    turned = [
        Rotation.from_matrix(scene.R @ model.poses[name][:, :3].T @ inverse[name][:, :3])
        for name in scene.names
    ]
    angles = [(a * b.inv()).magnitude() for a, b in combinations(turned, 2)]
    assert location.status == "nowhere" and np.median(angles) > np.radians(20)
    assert location.reason == (
        "4 database images disagree on the rotation of the query, by "
        f"{np.degrees(np.median(angles)):.0f} degrees (median)"
    )
    unknown = replace(PHOTO_CAMERA, focal_std=0.4, focal_source="size")
    assert _search_of(scene, _poses(scene), unknown, wrong).pair_camera is unknown
    assert _search_of(scene, _poses(scene), unknown).pair_camera is not unknown
