"""Whether a fixed camera has moved, by matches of known motions."""

from __future__ import annotations

import json

import cv2
import dense_scene
import numpy as np
import pytest

from dgc_pose import CameraMotion, Image, InputError, camera_motion
from dgc_pose.matches import Matches
from dgc_pose.matching import Matcher, MatchResult

SIZE = 640, 480
K = np.array([[600.0, 0, 319.5], [0, 600, 239.5], [0, 0, 1]])
PICTURE = np.zeros((480, 640, 3), np.uint8)
NONE = 0.0, 0.0, 0.0


class Given(Matcher):
    """Has these matches for any two images."""

    name = "given"

    def __init__(self, points1: np.ndarray, points2: np.ndarray) -> None:
        self.matches = Matches(points1, points2, np.ones(len(points1)), 0.5)

    def match(self, image1: Image, image2: Image) -> MatchResult:
        return MatchResult(self.matches, None)


def seen(
    turn_deg: tuple[float, float, float] = NONE,
    shift: tuple[float, float, float] = NONE,
    *,
    seed: int = 0,
    part: float = 0.0,
    step: tuple[float, float] = (20.0, 8.0),
    k: np.ndarray | None = K,
) -> CameraMotion:
    """The motion by 1000 matches of depths about 1, with noise of 0.2 pixels. part: of the width,
    covered by an object that makes a step, pixels."""
    rng = np.random.default_rng(seed)
    points1 = rng.random((1000, 2)) * SIZE
    rays = np.column_stack([points1, np.ones(1000)]) @ np.linalg.inv(K).T
    depth = np.exp(0.4 * rng.standard_normal((1000, 1)))
    R = cv2.Rodrigues(np.radians(turn_deg))[0]
    moved = (rays @ R.T + np.array(shift) / depth) @ K.T
    points2 = moved[:, :2] / moved[:, 2:]
    on_object = points1[:, 0] < part * SIZE[0]
    points2[on_object] = points1[on_object] + step
    points2 += 0.2 * rng.standard_normal((1000, 2))
    return camera_motion(PICTURE, PICTURE, k, matcher=Given(points1, points2))


@pytest.mark.parametrize("part", [0.0, 0.3])
@pytest.mark.parametrize(
    ("turn_deg", "shift"),
    [
        ((0.0, 0.06, 0.0), NONE),
        ((0.5, -0.4, 0.8), NONE),
        ((10.0, 20.0, -5.0), NONE),
        (NONE, (0.0, 0.004, 0.001)),
        ((0.2, 0.3, 0.0), (-0.01, 0.0, 0.01)),
    ],
)
def test_a_motion_is_measured_within_its_error(turn_deg, shift, part) -> None:
    motion = seen(turn_deg, shift, part=part)
    assert motion.verdict == "moved"
    assert abs(motion.angle_deg - np.linalg.norm(turn_deg)) < motion.angle_error_90_deg < 2
    assert abs(motion.shift - np.linalg.norm(shift)) < motion.shift_error_90 < 0.05
    assert motion.num_matches == 1000 and motion.num_inliers > 1000 * (0.9 - part)
    assert {*motion.seconds} == {"load", "match", "estimate"}
    json.dumps(motion.to_dict(), allow_nan=False)


@pytest.mark.parametrize("step", [(20.0, 8.0), (2.0, -1.0), (300.0, 0.0)])
@pytest.mark.parametrize("part", [0.0, 0.33])
def test_a_camera_before_which_an_object_moves_is_still(part, step) -> None:
    for seed in range(3):
        motion = seen(seed=seed, part=part, step=step)
        assert motion.verdict == "still", motion.reason
        assert motion.angle_deg < motion.angle_error_90_deg
        assert motion.shift < motion.shift_error_90


def test_a_mirrored_picture_is_no_motion() -> None:
    rng = np.random.default_rng(0)
    points1 = rng.random((1000, 2)) * SIZE
    points2 = points1 * (-1, 1) + (SIZE[0] - 1, 0)
    motion = camera_motion(PICTURE, PICTURE, K, matcher=Given(points1, points2))
    assert motion.verdict == "cannot say" and motion.angle_deg is None


def test_the_focal_length_that_is_not_known_is_part_of_the_error() -> None:
    known, assumed = seen((0.0, 3.0, 0.0)), seen((0.0, 3.0, 0.0), k=None)
    assert known.verdict == assumed.verdict == "moved"
    assert known.angle_error_90_deg < 0.3 < assumed.angle_error_90_deg


def test_matches_that_agree_on_nothing_say_nothing() -> None:
    rng = np.random.default_rng(0)
    for count, words in ((500, "% of the matched picture"), (49, "only 49 matches")):
        matcher = Given(*(rng.random((2, count, 2)) * SIZE))
        motion = camera_motion(PICTURE, PICTURE, K, matcher=matcher)
        assert motion.verdict == "cannot say" and words in motion.reason
        assert motion.angle_deg is None and motion.shift is None and motion.num_matches == count


def test_pictures_of_other_light_black_ones_and_ones_of_another_size() -> None:
    picture = dense_scene.pictures()[0]
    darker = (0.7 * picture).astype(np.uint8)
    assert camera_motion(picture, darker, dense_scene.K, matcher="sift").verdict == "still"
    black = camera_motion(picture, 0 * picture, matcher="sift")
    assert (black.verdict, black.reason) == ("cannot say", "only 0 matches")
    with pytest.raises(InputError, match="now has another size: now has 320 x 239, reference has"):
        camera_motion(picture, picture[1:], matcher="sift")
