"""The benchmarks' loop: its records are right, and the same however the work is cut up."""

from dataclasses import asdict, replace

import dense_scene
import numpy as np
import pytest
from evaluation_pairs import ESTIMATION, MATCHER, METHODS, posed_pairs, scored, view_of

from dgc_pose.benchmarks.evaluate import doubts_camera, evaluate
from dgc_pose.benchmarks.methods import parse_methods
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.images.image import Image
from dgc_pose.matching import Matcher, MatchResult
from dgc_pose.matching.texture import texture


def test_a_row_a_pair_and_method_the_same_from_any_pair_on(tmp_path) -> None:
    pairs = posed_pairs(tmp_path, 3)
    rows = scored(pairs)
    keys = [(one.method, one.image1, one.image2) for by_method in rows for one in by_method]
    assert keys == [(m.name, "one.png", f"two_{k}.png") for k in (2, 3, 4) for m in METHODS]
    for one in (one for by_method in rows for one in by_method):
        assert one.match_seconds >= 0 and one.estimate_seconds > 0
    true = rows[0][0]
    assert true.success and true.rotation_error_deg < 0.5 and true.translation_error_deg < 2
    assert true.true_rotation_deg == pytest.approx(
        np.degrees(np.arccos((np.trace(dense_scene.R) - 1) / 2)), abs=1e-4
    )
    for one, again in zip(rows[2], scored(pairs, first=2)[0], strict=True):
        again = replace(
            again, match_seconds=one.match_seconds, estimate_seconds=one.estimate_seconds
        )
        np.testing.assert_equal(asdict(again), asdict(one))


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
    names = [f"{method.name}:max_matches={2**31}" for method in METHODS]
    rows = scored(pairs, parse_methods(names, MATCHER, ESTIMATION))
    masked, everywhere, some = (s.num_matches for s in rows[0])
    found = dense_scene.true_map(error_px=0.1)
    inside = (found.map >= -0.5).all(-1) & (found.map <= np.array(dense_scene.SIZE) - 0.5).all(-1)
    (pair,) = pairs.read()
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
    methods = parse_methods(["sift"], estimation=EstimationOptions(runs=2, iterations=200))
    ((result,),) = evaluate(posed_pairs(tmp_path, 1), methods, [Backwards()])
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
