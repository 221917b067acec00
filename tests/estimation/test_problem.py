"""The problem made of matches and cameras: what is dropped, the threshold, the grid cells; points
in pixels of another image than their camera's."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import K1, SIZE1, camera_scene, joined, two_view_scene

from dgc_pose.cameras.calibration import parse_camera
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.estimation.problem import TwoViewProblem, odd_extent, pose_loss_width
from dgc_pose.geometry.epipolar import essential_from_pose, sampson_distance
from dgc_pose.matches import Matches


def test_bad_and_double_matches_are_dropped_and_counted_and_the_mask_keeps_its_length():
    scene = two_view_scene("general", seed=2, count=300, sigma_px=0.5, outliers=0.2)
    points1 = np.vstack([scene.points1, scene.points1[:7], scene.points1[:3]])
    points2 = np.vstack([scene.points2, scene.points2[:7], scene.points2[:3]])
    points1[300] = scene.points1[0]  # rows 300 to 306 are copies, 307 to 309 not finite
    points1[307, 0], points1[308, 1], points2[309, 0] = np.nan, np.inf, -np.inf
    order = np.random.default_rng(0).permutation(310)
    matches = Matches(points1[order], points2[order], np.ones(310), 1.0)
    pose = estimate_pose(matches, *scene.cameras)
    assert pose.success
    assert pose.num_matches == 300
    assert pose.inliers.shape == (310,)
    assert not pose.inliers[order >= 307].any()
    assert pose.inliers.sum() == pose.num_inliers
    assert "3 matches dropped: not finite" in pose.warnings
    assert "7 matches dropped: duplicates" in pose.warnings
    kept = pose.inliers[np.argsort(order)]
    assert kept[:300][scene.true].mean() > 0.8


def test_points_whose_distortion_cannot_be_undone_are_dropped_and_counted():
    """Of a lens that the image has: no ray is seen at its corners."""
    strong = parse_camera("SIMPLE_RADIAL,1600,1200,1700,810.5,590.5,-0.9")
    camera2 = two_view_scene(count=10).cameras[1]
    scene = camera_scene(strong, camera2, count=300, sigma_px=0.2, outliers=0.0)
    corners = np.random.default_rng(0).random((67, 2)) * 100
    scene = joined(scene, corners, corners + 50)
    lost = ~np.isfinite(strong.normalise(scene.points1)).all(1)
    assert lost.sum() >= 67 and lost[300:].all()
    pose = estimate_pose(scene.matches, *scene.cameras)
    assert pose.success and pose.num_matches == 367 - lost.sum()
    assert pose.inliers.shape == (367,) and not pose.inliers[lost].any()
    assert any(f"{lost.sum()} matches dropped" in warning for warning in pose.warnings)


def test_the_threshold_is_the_mean_over_both_cameras_of_pixels_over_focal_length():
    scene = two_view_scene(count=30)
    cameras = scene.cameras
    matches = replace(scene.matches, error_px=0.7)

    def threshold(**options):
        return TwoViewProblem.of(matches, *cameras, EstimationOptions(**options)).threshold

    pixel = (1 / 1695 + 1 / 1105) / 2  # mean focal lengths of K1 and K2
    assert threshold(threshold_px=3.0) == pytest.approx(3.0 * pixel)
    assert threshold() == pytest.approx(2 * matches.error_px * pixel)


def test_a_cell_is_a_24th_of_the_longer_side():
    scene = two_view_scene(count=30)
    cells = TwoViewProblem.of(scene.matches, *scene.cameras).cells
    assert cells == pytest.approx((1600 / 24 / 1695, 1280 / 24 / 1105))
    # Without a size the principal point, (810, 590), counts as the middle.
    unknown = TwoViewProblem.of(scene.matches, Camera(scene.K1), scene.cameras[1])
    assert unknown.cells[0] == pytest.approx(1621 / 24 / 1695)


POINTS = two_view_scene(count=300).points1  # of 1600x1200 pixels
FEW = [
    "less than half of both sides of the 1600x1200",
    "less than half of both sides of the 1621x1181",
]
MANY = ["refused", "lie outside the 1621x1181"]


@pytest.mark.parametrize(
    ("points", "said"),  # of a camera of 1600x1200 pixels, and of one without a size
    [
        (0.4 * POINTS, FEW),
        (POINTS[:, ::-1], MANY),
        (POINTS / (800, 600) - 1, FEW),  # from -1 to 1
        (2 * POINTS, MANY),
        (POINTS + 0.5, ["", ""]),  # COLMAP's convention
        (np.vstack([POINTS[:290], np.full((10, 2), 1700.0)]), ["", ""]),
        (np.vstack([POINTS, np.full((30, 2), np.nan), [[np.inf, 0]]]), ["", ""]),
        (POINTS, ["", ""]),
        (POINTS[POINTS[:, 0] < 533], ["", ""]),
        (0.1 * POINTS[:19], ["", ""]),
        (POINTS[:0], ["", ""]),
    ],
)
def test_points_of_another_size_are_told_and_real_ones_are_not(points, said):
    for camera, text in zip((Camera(K1, SIZE1), Camera(K1)), said, strict=True):
        if text == "refused":
            with pytest.raises(InputError, match="of 300 lie outside the 1600x1200 pixels"):
                odd_extent(points, camera, 2)
            continue
        texts = odd_extent(points, camera, 2)
        assert len(texts) == bool(text)
        if texts:
            left, right = points[:, 0].min(), points[:, 0].max()
            assert texts[0].startswith(f"points2 span x {left:.0f} to {right:.0f}, y ")
            assert text in texts[0] and "pixels of camera2" in texts[0]
    assert odd_extent(Camera(K1).normalise(POINTS), Camera(np.eye(3)), 1) == ()


def test_a_pose_has_the_warnings_of_both_images():
    scene = two_view_scene(count=300)
    matches = replace(scene.matches, points2=0.4 * scene.points2)
    pose = estimate_pose(matches, *scene.cameras)
    assert [w.split(" span ")[0] for w in pose.warnings if w.startswith("points")] == ["points2"]
    for name in ("points1", "points2"):
        matches = replace(scene.matches, **{name: 2 * getattr(scene, name)})
        with pytest.raises(InputError, match=f"^{name} span "):
            estimate_pose(matches, *scene.cameras)


THRESHOLD = 2e-3


def test_the_scale_follows_the_errors_between_a_floor_and_the_threshold():
    for sigma_px, expected in ((0.0, 0.02 * THRESHOLD), (30.0, THRESHOLD)):
        scene = two_view_scene(count=300, sigma_px=sigma_px, outliers=0.0)
        assert pose_loss_width(scene.problem(THRESHOLD), scene.R, scene.t) == expected
    scene = two_view_scene(count=4000, sigma_px=0.5, outliers=0.0)
    problem = scene.problem(THRESHOLD)
    E = essential_from_pose(scene.R, scene.t)
    error = sampson_distance(problem.points1, problem.points2, E)
    # Gaussian errors: 2.385 of their standard deviations (Rey 1983).
    scale = pose_loss_width(problem, scene.R, scene.t)
    assert scale == pytest.approx(2.385 * np.sqrt((error**2).mean()), rel=0.05)


def test_the_threshold_in_pixels_is_that_of_any_cameras():
    scene = two_view_scene("general", count=50)
    wide, long = (
        camera.with_focal(f) for camera, f in zip(scene.cameras, (500, 2000), strict=True)
    )
    problem = TwoViewProblem.of(scene.matches, wide, long, EstimationOptions(threshold_px=1.7))
    assert problem.threshold_px == pytest.approx(1.7)
    loose = problem.with_cameras((replace(wide, lens_std=0.1), long), problem.threshold_px)
    assert loose.threshold_px == pytest.approx(1.7)
