"""Matches that stay at the same pixels: of an overlay, of a background, of what is far away, and of
the same picture."""

import numpy as np
import pytest
from scenes import TwoViewScene, camera_scene, joined, pinhole

from dgc_pose.estimation import RelativePose, estimate_pose
from dgc_pose.estimation.relative_pose import staying
from dgc_pose.matches import Matches

SIZE, SMALL = (1600, 1200), (800, 600)
CAMERA, HALF = pinhole(1500, SIZE), pinhole(1500, SIZE).resized(SMALL)
TURN = {"turn_deg": (6.0, 17.0, 9.0)}  # by 20.4 degrees
LEFT_OUT = "stay at the same pixels and are dropped"
# Where an overlay lies, shares of the sides: left, top, right, bottom.
STRIP, CORNER, ANYWHERE = (0.0, 0.85, 1.0, 1.0), (0.02, 0.02, 0.2, 0.15), (0.0, 0.0, 1.0, 1.0)


def _staying(
    count: int, place: tuple[float, ...], size2: tuple[int, int] = SIZE, seed: int = 7
) -> tuple[np.ndarray, np.ndarray]:
    """Points of both images at one place of each, within 0.3 pixels."""
    rng = np.random.default_rng(seed)
    shares = rng.uniform(place[:2], place[2:], (count, 2))
    points1, points2 = (shares * np.array(size) - 0.5 for size in (SIZE, size2))
    turn, length = rng.uniform(0, 2 * np.pi, count), rng.uniform(0, 0.3, count)
    off = length[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    return points1, points2 + off * np.array(size2) / SIZE


def _with(scene: TwoViewScene, share: float, place: tuple[float, ...]) -> TwoViewScene:
    """The scene with so many staying matches, as a share of all."""
    count = round(share / (1 - share) * len(scene.matches))
    return joined(scene, *_staying(count, place, scene.cameras[1].size))


def _told(pose: RelativePose) -> list[str]:
    return [warning for warning in pose.warnings if LEFT_OUT in warning]


def _assert_right(pose: RelativePose, scene: TwoViewScene, most_deg: float = 2.5) -> None:
    """Within twice what is stated, which is at most so much."""
    assert pose.success, pose
    rotation, translation = scene.errors_deg(pose)
    assert rotation <= 2 * pose.rotation_error_90_deg <= 2 * most_deg
    assert translation <= 2 * pose.translation_error_90_deg <= 4 * most_deg


@pytest.mark.parametrize(
    ("share", "place", "second", "auto"),
    [
        (0.05, CORNER, CAMERA, False),
        (0.15, STRIP, HALF, False),
        (0.4, ANYWHERE, CAMERA, False),
        (0.05, STRIP, CAMERA, True),
        (0.15, ANYWHERE, CAMERA, True),
        (0.4, CORNER, HALF, True),
    ],
)
def test_an_overlay_is_left_out_and_told(share, place, second, auto) -> None:
    scene = _with(camera_scene(CAMERA, second, **TURN), share, place)
    count = len(scene.matches)
    overlay = np.arange(count) >= 800
    pose = scene.estimate(*(() if auto else scene.cameras))
    # Two sizes of no sensor's shape, and no K: each picture may be a part.
    _assert_right(pose, scene, 8.0 if auto else 1.0)
    assert pose.inliers.shape == (count,) and not pose.inliers[overlay].any()
    assert pose.inliers[scene.true].mean() > 0.9
    (warning,) = _told(pose)
    number = int(warning.split()[0])
    # A wrong match may stay by chance.
    assert overlay.sum() <= number <= overlay.sum() + 2
    assert f"of {count} matches ({100 * number / count:.0f} %)" in warning and "mask1" in warning


def test_the_pose_is_that_of_the_others_alone() -> None:
    """Also by the matches of the map, of which those that stay are left out likewise."""
    scene = _with(camera_scene(CAMERA, CAMERA, **TURN), 0.4, STRIP)
    stay = staying(scene.matches, *scene.cameras)
    moving = scene.matches.subset(~stay)
    pose = estimate_pose(scene.matches, *scene.cameras, map_matches=scene.matches)
    alone = estimate_pose(moving, *scene.cameras, map_matches=moving)
    assert pose.num_matches == alone.num_matches == (~stay).sum() <= 800
    np.testing.assert_array_equal(alone.R, pose.R)
    np.testing.assert_array_equal(alone.inliers, pose.inliers[~stay])
    assert alone.evidence.map_agreement == pose.evidence.map_agreement > 0.7
    assert (alone.probability, alone.warnings) == (pose.probability, pose.warnings[:-1])


def test_matches_that_are_not_finite_are_in_no_share_that_is_told() -> None:
    scene = _with(camera_scene(CAMERA, CAMERA, **TURN), 0.65, STRIP)
    nowhere = np.full((2000, 2), np.nan)
    poses = [each.estimate(*scene.cameras) for each in (scene, joined(scene, nowhere, nowhere))]
    assert poses[0].status == poses[1].status == "ambiguous"
    assert poses[0].reason == poses[1].reason
    for pose in poses:  # the strip is dropped
        assert pose.num_matches == len(pose.hypotheses[0].inliers) < len(scene.matches)


@pytest.mark.parametrize(("share", "seed"), [(0.15, 0), (0.35, 1)])
def test_far_points_of_a_stereo_pair_are_kept(share: float, seed: int) -> None:
    """It moved sideways and did not turn: what is far away stays at its pixels."""
    near = camera_scene(
        CAMERA, CAMERA, seed=seed, turn_deg=(0, 0, 0), centre=(1, 0.05, 0), outliers=0.1
    )
    scene = _with(near, share, (0.0, 0.0, 1.0, 0.5))
    assert staying(scene.matches, *scene.cameras).sum() > 50
    pose = scene.estimate(*scene.cameras)
    _assert_right(pose, scene)
    assert not _told(pose) and pose.inliers[800:].mean() > 0.95


@pytest.mark.parametrize(
    ("outliers", "auto", "second"),
    [(0, False, CAMERA), (15, True, HALF), (60, True, CAMERA), (300, False, HALF)],
)
def test_the_same_picture_has_no_pose_and_no_rotation(outliers, auto, second) -> None:
    """All matches stay, or most do and the others are anywhere."""
    rng = np.random.default_rng(3)
    points1, points2 = _staying(500, ANYWHERE, second.size)
    wrong = [rng.random((outliers, 2)) * camera.size for camera in (CAMERA, second)]
    rows = [np.vstack(pair) for pair in ((points1, wrong[0]), (points2, wrong[1]))]
    matches = Matches(*rows, np.ones(len(rows[0])), 0.5)
    scene = TwoViewScene(matches, (CAMERA, second), np.eye(3), np.zeros(3), np.zeros(len(matches)))
    pose = scene.estimate(*(() if auto else scene.cameras))
    assert pose.status == "same_picture" and not pose.success and pose.probability == 0
    assert pose.R is None and pose.t is None and pose.camera1 is None
    assert pose.inliers.shape == (len(matches),)
    stay = int(staying(matches, *scene.cameras).sum())
    assert pose.reason.startswith(f"{stay} of {len(matches)} matches (")
    assert "stay at the same pixels" in pose.reason


@pytest.mark.parametrize(("seed", "auto"), [(0, False), (1, True)])
def test_both_motions_of_a_turntable_are_told(seed: int, auto: bool) -> None:
    """One match in three is of an object that turned by 25 degrees, all others of a background
    that stood still."""
    turn = {"turn_deg": (4, 25, 0), "centre": (-2.2, 0.4, 0.4), "depths": (4.8, 7.2)}
    scene = camera_scene(CAMERA, CAMERA, seed=seed, count=400, sigma_px=0.3, outliers=0.0, **turn)
    scene = joined(scene, *_staying(750, ANYWHERE, seed=seed))
    pose = scene.estimate(*(() if auto else scene.cameras))
    assert pose.status == "ambiguous" and pose.R is None and pose.probability == 0
    assert 750 <= int(pose.reason.split()[0]) <= 760 and "fit a motion" in pose.reason
    rotation, translation = scene.errors_deg(pose.alternatives[0])
    assert rotation < (8 if auto else 1) and translation < (16 if auto else 2)


@pytest.mark.parametrize(
    ("turn_deg", "centre", "focal2", "auto"),
    [
        ((0, 0, 0), (0.05, 0.02, 0), 1950, True),
        ((0.3, -0.2, 0.5), (0.01, 0.01, 0.8), 1500, True),
        ((0, 0, 10), (0.2, 0.1, 0.1), 1500, False),
        ((0.5, 0.05, 0), (0.3, 0, 0), 1500, False),
    ],
    ids=["zoom", "forward", "roll", "turn"],
)
def test_a_motion_that_leaves_a_part_in_place_is_no_overlay(turn_deg, centre, focal2, auto) -> None:
    """The middle stays, and around it matches move a little."""
    other = pinhole(focal2, SIZE)
    scene = camera_scene(CAMERA, other, count=1200, turn_deg=turn_deg, centre=centre)
    assert not staying(scene.matches, *scene.cameras).any()
    pose = scene.estimate(*(() if auto else scene.cameras))
    assert not _told(pose) and pose.status != "same_picture"


@pytest.mark.parametrize(
    ("still", "slow", "moving", "error_px", "found"),
    [
        (30, 0, 100, 0.5, True),
        (19, 0, 100, 0.5, False),
        (30, 0, 1000, 0.5, False),  # below 4 % of all
        (45, 0, 1000, 0.5, True),
        (30, 30, 100, 0.5, False),  # as many move a little
        (30, 29, 100, 0.5, True),
        (0, 30, 100, 2.0, True),  # by 1.5 pixels, within the expected error
    ],
)
def test_matches_stay_if_enough_of_them_do(still, slow, moving, error_px, found) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(100, 1000, (still + slow + moving, 2))
    by = np.repeat([0.3, 1.5, 40.0], (still, slow, moving))
    turn = rng.uniform(0, 2 * np.pi, len(by))
    moved = points + by[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    expected = found & (by < max(1.0, error_px))
    rows = np.column_stack([points, moved])
    rows = np.vstack([rows, np.full((1000, 4), np.nan)])  # which are in no share
    expected = np.append(expected, np.zeros(1000, bool))
    matches = Matches(rows[:, :2], rows[:, 2:], np.ones(len(rows)), error_px)
    stay = staying(matches, CAMERA, CAMERA)
    np.testing.assert_array_equal(stay, expected)
