"""Records of pairs are right: poses, distances from the true epipolar lines, cameras."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import dense_scene
import numpy as np
import pytest

from dgc_pose.benchmarks.evaluate import doubts_camera, epipolar_errors, folded, pose_auc, score
from dgc_pose.benchmarks.methods import parse_methods
from dgc_pose.benchmarks.posed_pairs import ListedPairs, PosedPair
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import Pair
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.geometry.epipolar import essential_from_pose, fundamental_from_essential
from dgc_pose.images.image import Image
from dgc_pose.matching import Matcher, MatchResult

CAMERA = Camera(dense_scene.K, dense_scene.SIZE)


def listed(folder: Path) -> Pair:
    """The two pictures of the scene."""
    dense_scene.write_pictures(folder)
    return Pair("one.png", "two.png", folder, CAMERA, CAMERA, dense_scene.R, 120 * dense_scene.T)


class Backwards(Matcher):
    """The true matches with the images exchanged: a pose that is wrong by a known amount."""

    name = "backwards"

    def _match(self, image1, image2):
        found = dense_scene.MapMatcher(dense_scene.true_map()).match(image1, image2).matches
        return MatchResult(replace(found, points1=found.points2, points2=found.points1), None)


def test_a_wrong_pose_has_its_error_and_a_map_that_is_not_there_none(tmp_path) -> None:
    pair, estimation = ListedPairs([listed(tmp_path)]).pair(0), EstimationOptions(runs=2)
    by_pose, by_map = parse_methods(["sift", "other/all"], estimation=estimation)
    result = SimpleNamespace(**score(("1", "2"), pair, by_pose, Backwards()))
    # The pose found is cam1_from_cam2: its rotation is off by twice the true one.
    assert result.success
    assert result.true_rotation_deg == pytest.approx(
        np.degrees(np.arccos((np.trace(dense_scene.R) - 1) / 2)), abs=1e-4
    )
    assert result.rotation_error_deg == pytest.approx(2 * result.true_rotation_deg, abs=0.1)
    cosine = float(dense_scene.T @ (-dense_scene.R.T @ dense_scene.T))
    assert result.translation_error_deg == pytest.approx(np.degrees(np.arccos(cosine)), abs=0.3)
    assert result.translation_folded_deg == folded(result.translation_error_deg)
    assert [folded(error) for error in (180.0, 170.0, 10.0, math.inf)] == [0, 10, 10, math.inf]
    with pytest.raises(InputError, match="other/all: backwards makes no dense map"):
        score(("1", "2"), pair, by_map, Backwards())


@pytest.mark.parametrize(
    ("scale", "source", "std"),
    [(1.0, "given", 0.0), (0.8, "given", 0.0), (0.7, "exif", 0.02)],
)
def test_a_wrong_focal_length_is_doubted_as_the_warnings_of_the_pose_say(
    scale, source, std
) -> None:
    camera = replace(CAMERA.with_focal(300 * scale), focal_source=source, focal_std=std)
    images = map(Image, dense_scene.pictures())
    matches = dense_scene.MapMatcher(dense_scene.true_map()).match(*images).matches
    pose = estimate_pose(matches, camera, camera, EstimationOptions(runs=1, iterations=200))
    warned = any("the matches agree with " in text for text in pose.warnings)
    assert doubts_camera(pose, (camera, camera)) == warned == (scale != 1)
    given = replace(camera, focal_source="given", warnings=("K1 is odd",))
    assert doubts_camera(pose, (given, camera))


@pytest.mark.parametrize("size", [None, (256, 256)])
def test_a_size_changes_images_and_cameras_alike(tmp_path, size) -> None:
    """A point that both cameras see stays the same point of the scene: true matches stay true,
    their distances from the epipolar lines being zero after the resize as before."""
    found = dense_scene.true_map()
    shown = ListedPairs([listed(tmp_path)], size=size).pair(0)
    expected = size or dense_scene.SIZE
    assert shown.camera1.size == shown.camera2.size == expected
    for image in (shown.image1, shown.image2):
        assert image.size == expected
        assert (image.stored_size or image.size) == dense_scene.SIZE
    scale = np.divide(expected, dense_scene.SIZE)
    points1, points2 = ((p + 0.5) * scale - 0.5 for p in (found.map, found.grid))
    assert max(epipolar_errors(shown, points1, points2)) < 1e-3
    far = Camera(np.array([[900.0, 0, 800], [0, 900, 600], [0, 0, 1]]))
    with pytest.raises(InputError, match=r"K of .*two\.png"):
        ListedPairs([replace(listed(tmp_path), camera2=far)]).pair(0)


def test_auc_of_cases_done_by_hand() -> None:
    assert pose_auc([0, 0, 0], 10) == pytest.approx(100)
    assert pose_auc([math.inf, 90], 20) == 0
    # One pair at 4 degrees: a triangle up to 4, level after it. A failure beside it halves it.
    assert [pose_auc([4], limit) for limit in (5, 8)] == pytest.approx([60, 75])
    assert [pose_auc([math.inf, 4], limit) for limit in (5, 8)] == pytest.approx([30, 37.5])


def test_epipolar_figures_are_those_of_the_equation() -> None:
    """Against the distances of points and lines, one by one, and in the presence of infinities."""
    rng = np.random.default_rng(0)
    image, camera = Image(np.zeros((240, 320, 3), np.uint8)), Camera(dense_scene.K)
    pair = PosedPair(image, image, camera, camera, dense_scene.R, dense_scene.T)
    E = essential_from_pose(dense_scene.R, dense_scene.T)
    F = fundamental_from_essential(E, camera.K, camera.K)
    points1, points2 = rng.uniform(0, 100, (2, 25, 2))
    expected = []
    for (x1, y1), (x2, y2) in zip(points1, points2, strict=True):
        a, b, c = F @ [x1, y1, 1]
        d, e, f = F.T @ [x2, y2, 1]
        to_line2 = abs(a * x2 + b * y2 + c) / np.hypot(a, b)
        to_line1 = abs(d * x1 + e * y1 + f) / np.hypot(d, e)
        expected.append((to_line1 + to_line2) / 2)
    found = epipolar_errors(pair, points1.reshape(5, 5, 2), points2.reshape(5, 5, 2))
    assert found == pytest.approx((np.median(expected), np.mean(expected)))
    points1[:3] = np.inf
    median, mean = epipolar_errors(pair, points1, points2)
    assert median == pytest.approx(np.sort([np.inf] * 3 + expected[3:])[12]) and mean == np.inf
    assert epipolar_errors(pair, np.zeros((0, 2)), np.zeros((0, 2))) == (np.inf, np.inf)
