"""Records of pairs are right: poses, distances from the true epipolar lines, cameras."""

import math
from dataclasses import replace
from types import SimpleNamespace

import dense_scene
import numpy as np
import pytest
from evaluation_pairs import ESTIMATION, MATCHER, METHODS, posed_pairs, scored, view_of

from dgc_pose.benchmarks.evaluate import doubts_camera, epipolar_errors, folded, pose_auc, score
from dgc_pose.benchmarks.methods import parse_methods
from dgc_pose.benchmarks.posed_pairs import ListedPairs, PosedPair
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.geometry.epipolar import essential_from_pose, fundamental_from_essential
from dgc_pose.images.image import Image
from dgc_pose.matching import Matcher, MatchResult
from dgc_pose.matching.texture import texture


def test_a_row_a_pair_and_method(tmp_path) -> None:
    rows = scored(posed_pairs(tmp_path, 3))
    keys = [(one.method, one.image1, one.image2) for by_method in rows for one in by_method]
    assert keys == [(m.name, "one.png", f"two_{k}.png") for k in (2, 3, 4) for m in METHODS]
    for one in (one for by_method in rows for one in by_method):
        assert one.match_seconds >= 0 and one.estimate_seconds > 0
    true = rows[0][0]
    assert true.success and true.rotation_error_deg < 0.5 and true.translation_error_deg < 2
    assert true.true_rotation_deg == pytest.approx(
        np.degrees(np.arccos((np.trace(dense_scene.R) - 1) / 2)), abs=1e-4
    )


def test_the_epipolar_error_is_that_of_the_map(tmp_path) -> None:
    """Noise of sigma in each coordinate of image 1 is a distance to the line with a median of
    0.67 sigma there; the distance in image 2 is about the same, the views being alike."""
    for by_method in scored(posed_pairs(tmp_path, 4)):
        sigma = 0.05 * view_of(by_method[0].image2)
        for one in by_method[:2]:
            assert one.epipolar_all_px == pytest.approx(0.67 * sigma, rel=0.1)
            assert one.epipolar_all_mean_px == pytest.approx(0.8 * sigma, rel=0.1)
        assert np.isnan(by_method[2].epipolar_all_px)
        assert by_method[2].epipolar_confident_px < 1e-3


def test_all_takes_what_the_mask_leaves_out(tmp_path) -> None:
    """The cells whose place lies outside image 1 never become matches; matchability aside."""
    pairs = posed_pairs(tmp_path, 1)
    all_matches = replace(MATCHER, matching=replace(MATCHER.matching, max_matches=2**31))
    names = [method.name for method in METHODS]
    rows = scored(pairs, parse_methods(names, all_matches, ESTIMATION))
    masked, everywhere, some = (s.num_matches for s in rows[0])
    found = dense_scene.true_map(error_px=0.1)
    inside = (found.map >= -0.5).all(-1) & (found.map <= np.array(dense_scene.SIZE) - 0.5).all(-1)
    pair = pairs.pair(0)
    structured = texture(pair.image1).at(found.map.reshape(-1, 2))
    structured &= texture(pair.image2).at(found.grid.reshape(-1, 2))
    trusted = (found.matchability > 0.5).ravel()
    assert masked == int((trusted & structured).sum()) > 1000
    assert everywhere == int(inside.sum()) > masked
    assert 40 < some <= 60  # points, those with structure


class Backwards(Matcher):
    """The true matches with the images exchanged: a pose that is wrong by a known amount."""

    name = "backwards"

    def _match(self, image1, image2):
        found = dense_scene.MapMatcher(dense_scene.true_map()).match(image1, image2).matches
        return MatchResult(replace(found, points1=found.points2, points2=found.points1), None)


def test_a_wrong_pose_has_its_error(tmp_path) -> None:
    (method,) = parse_methods(["sift"], estimation=EstimationOptions(runs=2, iterations=200))
    result = score(("1", "2"), posed_pairs(tmp_path, 1).pair(0), method, Backwards())
    result = SimpleNamespace(**result)
    # The pose found is cam1_from_cam2: its rotation is off by twice the true one.
    assert result.success
    assert result.rotation_error_deg == pytest.approx(2 * result.true_rotation_deg, abs=0.1)
    cosine = float(dense_scene.T @ (-dense_scene.R.T @ dense_scene.T))
    assert result.translation_error_deg == pytest.approx(np.degrees(np.arccos(cosine)), abs=0.3)
    folded = min(result.translation_error_deg, 180 - result.translation_error_deg)
    assert result.translation_folded_deg == folded


def test_a_map_that_is_not_there_is_not_scored(tmp_path) -> None:
    with pytest.raises(InputError, match="some/all: some makes no map"):
        scored(posed_pairs(tmp_path, 1), parse_methods(["some/all"]))


@pytest.mark.parametrize(
    ("scale", "source", "std"),
    [(1.0, "given", 0.0), (0.8, "given", 0.0), (0.7, "exif", 0.02)],
)
def test_a_wrong_focal_length_is_doubted_as_the_warnings_of_the_pose_say(
    scale, source, std
) -> None:
    camera = Camera(dense_scene.K, dense_scene.SIZE).with_focal(300 * scale)
    camera = replace(camera, focal_source=source, focal_std=std)
    images = map(Image, dense_scene.pictures())
    matches = dense_scene.MapMatcher(dense_scene.true_map()).match(*images).matches
    pose = estimate_pose(matches, camera, camera, EstimationOptions(runs=1, iterations=200))
    warned = any(text.startswith("the matches agree with ") for text in pose.warnings)
    assert doubts_camera(pose, (camera, camera)) == warned == (scale != 1)
    given = replace(camera, focal_source="given", warnings=("K1 is odd",))
    assert doubts_camera(pose, (given, camera))


@pytest.mark.parametrize("size", [None, (256, 256)])
def test_a_size_changes_images_and_cameras_alike(tmp_path, size) -> None:
    """A point that both cameras see stays the same point of the scene: true matches stay true,
    their distances from the epipolar lines being zero after the resize as before."""
    found = dense_scene.true_map()
    shown = posed_pairs(tmp_path, 1, size).pair(0)
    expected = size or dense_scene.SIZE
    assert shown.camera1.size == shown.camera2.size == expected
    for image in (shown.image1, shown.image2):
        assert image.size == expected
        assert (image.stored_size or image.size) == dense_scene.SIZE
    scale = np.divide(expected, dense_scene.SIZE)
    points1, points2 = ((p + 0.5) * scale - 0.5 for p in (found.map, found.grid))
    assert max(epipolar_errors(shown, points1, points2)) < 1e-3


def test_the_K_of_another_image_is_refused(tmp_path) -> None:
    (pair,) = posed_pairs(tmp_path, 1).pairs
    far = Camera(np.array([[900.0, 0, 800], [0, 900, 600], [0, 0, 1]]))
    with pytest.raises(InputError, match=r"K of .*two_2\.png"):
        ListedPairs([replace(pair, camera2=far)]).pair(0)


def test_the_folded_error_ignores_the_sign() -> None:
    for error, expected in ((180.0, 0), (170.0, 10), (10.0, 10), (90.0, 90), (math.inf, math.inf)):
        assert folded(error) == expected


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
