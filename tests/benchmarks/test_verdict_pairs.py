from dataclasses import replace

import cv2
import numpy as np
import pytest
from photos import write_photos

from dgc_pose.benchmarks.posed_pairs import PosedPair, Truth
from dgc_pose.benchmarks.verdict_pairs import (
    VerdictPairs,
    changed,
    facade,
    listed,
    unrelated_photos,
    unrelated_scenes,
)
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.geometry.epipolar import essential_from_pose, sampson_distance
from dgc_pose.images.image import Image
from dgc_pose.matching.sift import SiftMatcher
from dgc_pose.training.synthesis.photos import held_back_paths, load_held_back
from dgc_pose.training.synthesis.render.scene_pair import render_scene_pair

SIZE = (200, 160)


@pytest.fixture(scope="module")
def pair():
    return render_scene_pair(2, size1=SIZE, size2=SIZE)


@pytest.fixture(scope="module")
def case(pair):
    truth = Truth({}, Camera(pair.K1, SIZE), Camera(pair.K2, SIZE), pair.R, pair.t)
    return PosedPair(truth, Image(pair.image1), Image(pair.image2))


def distances(case, points1, points2):
    """Sampson distances in pixels, by the case's cameras and pose."""
    truth = case.truth
    E = essential_from_pose(truth.R, truth.t / np.linalg.norm(truth.t))
    normal = truth.camera1.normalise(points1), truth.camera2.normalise(points2)
    return sampson_distance(*normal, E) * truth.camera1.focal


@pytest.mark.parametrize(
    ("change", "move"),
    [
        ("roll 90", lambda x, y: (y, SIZE[0] - 1 - x)),
        ("roll 180", lambda x, y: (SIZE[0] - 1 - x, SIZE[1] - 1 - y)),
        ("4x zoom", lambda x, y: (x - 75, y - 60)),
        ("night", lambda x, y: (x, y)),
        ("moving object", lambda x, y: (x, y)),
    ],
)
def test_a_changed_view_has_the_pose_that_belongs_to_it(pair, case, change, move):
    """What becomes of its pixels is tested beside `synthesis.misleading`."""
    view = changed(case, change, 0)
    y, x = np.nonzero(pair.visible)
    points1, points2 = pair.map[y, x], np.column_stack(move(x, y)).astype(float)
    assert distances(view, points1, points2).max() < 1e-3
    assert view.truth.camera2.size == view.image2.size
    assert np.linalg.det(view.truth.R) == pytest.approx(1)


def test_the_facades_pose_is_that_of_its_pictures():
    made = facade(1)
    matches = SiftMatcher().match(made.image1, made.image2).matches
    off = distances(made, matches.points1, matches.points2)
    assert len(off) > 50 and np.median(off) < 1.0
    tilt = cv2.Rodrigues(np.array([0.05, 0.0, 0.05]))[0]
    away = replace(made, truth=replace(made.truth, R=tilt @ made.truth.R))
    assert np.median(distances(away, matches.points1, matches.points2)) > 3.0


def test_unrelated_photographs_are_two_that_training_holds_back(tmp_path):
    paths = write_photos(tmp_path / "photos", 90)
    held_back = held_back_paths(tmp_path / "photos")
    assert set(held_back) < set(paths)
    assert len(held_back) == len(load_held_back(tmp_path / "photos", side=16).pixels)
    cases = list(unrelated_photos(tmp_path / "photos", 12, seed=0))
    assert len(cases) == 12
    for case in cases:
        first, second = str(case.truth.ids["name"]).split()
        assert first != second
        assert {first, second} <= {f"photos/{path.name}" for path in held_back}
        assert case.truth.ids["kind"] == "unrelated" and case.truth.R is None
        assert case.truth.camera1.size == case.image1.size
    again = unrelated_photos(tmp_path / "photos", 12, seed=0)
    assert [case.truth.ids for case in again] == [case.truth.ids for case in cases]


def test_unrelated_scenes_are_photographs_of_two_folders(tmp_path):
    for folder in ("a", "b", "c"):
        write_photos(tmp_path / folder, 3)
    folders = [tmp_path / folder for folder in ("a", "b", "c")]
    met = set()
    for one in unrelated_scenes(folders, 30, seed=0):
        first, second = (name.split("/")[0] for name in str(one.truth.ids["name"]).split())
        assert first != second
        met.add(frozenset((first, second)))
    assert len(met) == 3
    with pytest.raises(InputError, match="two scenes"):
        list(unrelated_scenes(folders[:1], 1, seed=0))
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no photographs"):
        list(unrelated_scenes([folders[0], tmp_path / "empty"], 1, seed=0))


def test_of_a_list_an_even_choice_is_taken(tmp_path):
    write_photos(tmp_path / "scene", 10)
    K = "90 0 47.5 0 90 39.5 0 0 1"
    T = "1 0 0 1 0 1 0 0 0 0 1 0 0 0 0 1"
    lines = [f"photo0_{k:03d}.png photo0_000.png 0 0 {K} {K} {T}" for k in range(1, 10)]
    (tmp_path / "scene" / "house_pairs.txt").write_text("\n".join(lines) + "\n")
    chosen = list(listed(tmp_path / "scene" / "house_pairs.txt", None, 3))
    seconds = [str(one.truth.ids["name"]).split()[1] for one in chosen]
    assert seconds == [f"photo0_00{k}.png" for k in (1, 5, 9)]
    assert {one.truth.ids["group"] for one in chosen} == {"house_pairs"}
    assert len(list(listed(tmp_path / "scene" / "house_pairs.txt", None, None))) == 9


def test_groups_follow_each_other_and_are_begun_anywhere(tmp_path):
    write_photos(tmp_path / "photos", 90)
    group = unrelated_photos(tmp_path / "photos", 3, seed=0)
    pairs = VerdictPairs([group, group])
    names = [one.truth.ids["name"] for one in pairs.read()]
    assert names == [ids["name"] for ids in pairs.ids] and len(names) == 6
    assert [one.truth.ids["name"] for one in pairs.read(4)] == names[4:]
