"""Whether a fixed camera has moved, by matches of known motions."""

from __future__ import annotations

import json
import math
from typing import Any

import cv2
import dense_scene
import numpy as np
import pytest
from PIL import Image as PilImage

from dgc_pose import Camera, CameraMotion, FixedCamera, Image, InputError, camera_motion
from dgc_pose.cameras.colmap_camera import RADIAL, Distortion
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


def moved_points(
    points1: np.ndarray,
    turn_deg: tuple[float, float, float],
    shift: tuple[float, float, float],
    depth: np.ndarray,
    zoom: float,
    k1: float,
) -> np.ndarray:
    """Where pixels (N, 2) of depths (N, 1) are seen after a motion, (N, 2)."""
    camera = Camera(K, distortion=Distortion(RADIAL, (k1, 0.0)))
    rays = np.column_stack([camera.normalise(points1), np.ones(len(points1))])
    R = cv2.Rodrigues(np.radians(turn_deg))[0]
    moved = rays @ R.T + np.array(shift) / depth
    return camera.with_focal(zoom * 600).project(moved[:, :2] / moved[:, 2:])


def seen(
    turn_deg: tuple[float, float, float] = NONE,
    shift: tuple[float, float, float] = NONE,
    *,
    zoom: float = 1.0,
    k1: float = 0.0,
    seed: int = 0,
    part: float = 0.0,
    step: tuple[float, float] = (20.0, 8.0),
    chance: float = 0.0,
    camera: Camera | np.ndarray | None = K,
) -> CameraMotion:
    """The motion by 1000 matches of depths about 1, with noise of 0.2 pixels. part: of the width,
    covered by an object that makes a step, pixels. chance: share of the matches that are random."""
    rng = np.random.default_rng(seed)
    points1 = rng.random((1000, 2)) * SIZE
    depth = np.exp(0.4 * rng.standard_normal((1000, 1)))
    points2 = moved_points(points1, turn_deg, shift, depth, zoom, k1)
    on_object = points1[:, 0] < part * SIZE[0]
    points2[on_object] = points1[on_object] + step
    points2 += 0.2 * rng.standard_normal((1000, 2))
    random = rng.random(1000) < chance
    points2[random] = rng.random((int(random.sum()), 2)) * SIZE
    return camera_motion(PICTURE, PICTURE, camera, matcher=Given(points1, points2))


def assert_measured(
    motion: CameraMotion,
    turn_deg: tuple[float, float, float] = NONE,
    shift: tuple[float, float, float] = NONE,
    zoom: float = 1.0,
    k1: float = 0.0,
    part: float = 0.0,
    **_: Any,
) -> None:
    """Every value of a motion is within its error. part: of the width, covered by an object."""
    middle = (np.array([SIZE]) - 1) / 2
    sides = np.linspace(0, 1, 9)
    whole = np.array([(x, y) for x in sides for y in sides]) * SIZE
    matched = whole[whole[:, 0] >= part * SIZE[0]]
    middle_px, whole_px, matched_px = (
        np.linalg.norm(
            moved_points(points, turn_deg, shift, np.ones((1, 1)), zoom, k1) - points, axis=1
        ).max()
        for points in (middle, whole, matched)
    )
    assert abs(motion.middle_px - middle_px) < motion.middle_error_90_px < 3
    # The corners have no match; a match of the object may agree by chance.
    assert motion.worst_px < whole_px + 2 * motion.worst_error_90_px
    assert motion.worst_px > 0.95 * matched_px - motion.worst_error_90_px
    assert abs(motion.angle_deg - np.linalg.norm(turn_deg)) < motion.angle_error_90_deg < 2
    assert abs(motion.shift - np.linalg.norm(shift)) < motion.shift_error_90 < 0.05
    assert abs(motion.zoom - (zoom - 1)) < motion.zoom_error_90 < 0.05


TURN = (0.0, 1.0, 0.0)
OBJECT = 0.33  # of the width


@pytest.mark.parametrize(
    ("verdict", "motion"),
    [
        ("moved", {"turn_deg": (0.0, 0.06, 0.0)}),
        ("moved", {"turn_deg": (0.0, 0.06, 0.0), "part": 0.3}),
        ("moved", {"turn_deg": (0.5, -0.4, 0.8), "part": 0.3}),
        ("moved", {"turn_deg": (10.0, 20.0, -5.0)}),
        ("moved", {"shift": (0.0, 0.004, 0.001)}),
        ("moved", {"shift": (0.0, 0.004, 0.001), "part": 0.3}),
        ("moved", {"shift": (-0.01, 0.0, 0.01), "turn_deg": (0.2, 0.3, 0.0), "part": 0.3}),
        ("moved", {"shift": (0.0, 0.0, 0.02)}),
        ("moved", {"turn_deg": TURN, "k1": -0.3}),
        ("moved", {"turn_deg": TURN, "k1": -0.1, "part": 0.3}),
        ("moved", {"turn_deg": (0.6, 0.0, 0.8), "k1": 0.2}),
        ("moved", {"turn_deg": (0.0, 0.3, 0.0), "k1": -0.2, "zoom": 1.01, "part": 0.3}),
        ("moved", {"turn_deg": TURN, "zoom": 0.96}),
        # A zoom is no motion of the camera.
        ("still", {"zoom": 1.005, "k1": -0.2}),
        ("still", {"zoom": 0.99}),
        ("still", {"zoom": 0.99, "part": OBJECT}),
        ("zoomed", {"zoom": 1.03, "part": OBJECT}),
        ("zoomed", {"zoom": 0.95}),
        ("zoomed", {"zoom": 0.95, "k1": -0.2}),
        # A camera stays still before which an object moves.
        ("still", {}),
        ("still", {"k1": -0.2, "seed": 1}),
        ("still", {"part": OBJECT, "step": (20.0, 8.0), "seed": 2}),
        *(("still", {"part": OBJECT, "step": (2.0, -1.0), "seed": seed}) for seed in range(3)),
        ("still", {"part": OBJECT, "step": (300.0, 0.0)}),
    ],
)
def test_a_motion_is_measured_within_its_error(verdict: str, motion: dict[str, Any]) -> None:
    """The lens is not stated."""
    found = seen(**motion)
    zoom = motion.get("zoom", 1.0)
    assert found.verdict == verdict, found.reason
    assert ("zoomed by" in found.reason) == (zoom != 1)
    assert ("zoomed by -" in found.reason) == (zoom < 1)
    if verdict == "still" and zoom == 1:
        assert found.reason.startswith("the picture moves by less than")
    assert_measured(found, **motion)
    assert found.num_matches == 1000
    assert found.num_inliers > 1000 * (0.85 - motion.get("part", 0.0))
    assert {*found.seconds} == {"load", "match", "estimate"}
    json.dumps(found.to_dict(), allow_nan=False)


@pytest.mark.parametrize(
    ("turn_deg", "shift", "part"),
    [
        (NONE, (0.0086, -0.0112, -0.0134), 0.3),
        (NONE, (0.02, 0.0, 0.0), 0.2),
        (TURN, (0.0086, -0.0112, -0.0134), 0.2),
        (TURN, (0.02, 0.0, 0.0), 0.3),
    ],
)
def test_a_lens_hood_that_stays_does_not_make_a_camera_still(turn_deg, shift, part) -> None:
    motion = seen(turn_deg, shift, k1=-0.2, part=part, step=(0.0, 0.0))
    assert motion.verdict in ("moved", "cannot say")


@pytest.mark.parametrize("chance", [0.25, 0.5])
def test_random_matches_do_not_make_a_motion_a_mirror_image(chance) -> None:
    """Half of the triangles of random matches are mirrored."""
    motion = seen((0.0, 2.0, 0.0), chance=chance)
    assert motion.verdict == "moved", motion.reason
    assert abs(motion.angle_deg - 2) < motion.angle_error_90_deg < 0.5


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_picture_is_no_motion(axis) -> None:
    rng = np.random.default_rng(0)
    points1 = rng.random((1000, 2)) * SIZE
    points2 = points1.copy()
    points2[:, axis] = SIZE[axis] - 1 - points1[:, axis]
    motion = camera_motion(PICTURE, PICTURE, K, matcher=Given(points1, points2))
    assert motion.verdict == "cannot say" and motion.angle_deg is None


@pytest.mark.parametrize(
    "camera", [None, Camera(K, distortion=Distortion(RADIAL, (0.0, 0.0)))], ids=["none", "pinhole"]
)
def test_what_the_camera_leaves_open_is_part_of_the_error(camera) -> None:
    """A stated lens, also one without distortion, leaves less open than none; no K leaves more."""
    turn_deg = (0.0, 0.3, 0.0)
    motion, by_K = seen(turn_deg, camera=camera), seen(turn_deg)
    for known in (motion, by_K):
        assert known.verdict == "moved"
        assert abs(known.angle_deg - 0.3) < known.angle_error_90_deg
        assert abs(known.middle_px - 600 * math.tan(math.radians(0.3))) < known.middle_error_90_px
    wider = motion if camera is None else by_K
    narrower = by_K if camera is None else motion
    assert narrower.angle_error_90_deg < wider.angle_error_90_deg
    assert wider.middle_error_90_px < 0.2


def test_matches_that_agree_on_nothing_say_nothing() -> None:
    rng = np.random.default_rng(0)
    for count, words in ((500, "% of the matched picture"), (49, "only 49 matches")):
        matcher = Given(*(rng.random((2, count, 2)) * SIZE))
        motion = camera_motion(PICTURE, PICTURE, K, matcher=matcher)
        assert motion.verdict == "cannot say" and words in motion.reason
        assert motion.angle_deg is None and motion.middle_px is None
        assert motion.num_matches == count


def test_pictures_of_other_light_black_ones_and_ones_of_another_size() -> None:
    picture = dense_scene.pictures()[0]
    fixed = FixedCamera(picture, dense_scene.K, matcher="sift")
    assert fixed.motion((0.7 * picture).astype(np.uint8)).verdict == "still"
    black = fixed.motion(0 * picture)
    assert (black.verdict, black.reason) == ("cannot say", "only 0 matches")
    with pytest.raises(InputError, match="now has another size: now has 320 x 239, reference has"):
        fixed.motion(picture[1:])


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_the_camera_is_turned_with_the_stored_reference_once(tmp_path, orientation) -> None:
    """K is of the stored pixels; the principal point is where it is in the upright picture."""
    exif = PilImage.Exif()
    exif[0x0112] = orientation
    PilImage.new("RGB", (640, 480)).save(tmp_path / "reference.jpg", exif=exif)
    stored = np.array([[600.0, 0, 350], [0, 600, 230], [0, 0, 1]])
    rng = np.random.default_rng(0)
    fixed = FixedCamera(tmp_path / "reference.jpg", stored, matcher=Given(*rng.random((2, 9, 2))))
    upright = {1: (350, 230), 3: (639 - 350, 479 - 230), 6: (479 - 230, 350), 8: (230, 639 - 350)}
    np.testing.assert_allclose(fixed.camera.K[:2, 2], upright[orientation])
    assert fixed.camera.size == fixed.reference.size
