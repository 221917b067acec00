"""The length of t of scenes whose points are known, beside deviations that it states."""

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest
from marker_scene import draw_markers, pixels_of, square, texture
from scenes import SIZE1, SIZE2, TwoViewScene, two_view_scene

from dgc_pose import InputError, RelativePose, ScaleSource, estimate_pose
from dgc_pose.estimation.scale import with_length
from dgc_pose.geometry.epipolar import depths
from dgc_pose.images.depth import read_depth
from dgc_pose.images.image import Image

LENGTH = 1.7  # metres, of t


@lru_cache
def scene_and_pose(seed: int) -> tuple[TwoViewScene, np.ndarray, RelativePose]:
    """A scene, its points (N, 3) in camera 1, metres, and the estimated pose."""
    scene = two_view_scene(seed=seed, count=600)
    exact = two_view_scene(seed=seed, count=600, sigma_px=0.0, outliers=0.0)
    cam1 = exact.K1 @ np.eye(3, 4)
    cam2 = exact.K2 @ np.column_stack([exact.R, LENGTH * exact.t])
    points = cv2.triangulatePoints(cam1, cam2, exact.points1.T, exact.points2.T)
    pose = estimate_pose(scene.matches, *scene.cameras)
    assert pose.success and pose.length is None and pose.length_std is None
    return scene, (points[:3] / points[3]).T, pose


def depth_map(
    pixels: np.ndarray, z: np.ndarray, size: tuple[int, int], noise: float
) -> np.ndarray | None:
    """A depth map that is known around the pixels (N, 2) alone, z (N,) of each with its noise."""
    depth = np.zeros(size[::-1])
    factors = 1 + noise * np.random.default_rng(0).standard_normal(len(z))
    for (x, y), value in zip(np.rint(pixels).astype(int), z * factors, strict=True):
        depth[y - 2 : y + 3, x - 2 : x + 3] = max(value, 0)
    return read_depth(depth, "depth1", size, 1)


@lru_cache
def maps_of(seed: int, noise: float = 0.02, rays: bool = False) -> list[np.ndarray | None]:
    """Depth maps of both images. rays: of distances along the rays."""
    scene, points, _ = scene_and_pose(seed)
    local = points, points @ scene.R.T + LENGTH * scene.t
    depths = [np.linalg.norm(at, axis=1) if rays else at[:, 2] for at in local]
    true = scene.true
    return [
        depth_map(scene.points1[true], depths[0][true], SIZE1, noise),
        depth_map(scene.points2[true], depths[1][true], SIZE2, noise),
    ]


@pytest.mark.parametrize("images", [(1,), (2,), (1, 2)])
@pytest.mark.parametrize("rays", [False, True], ids=["z", "along the rays"])
def test_depth_maps_tell_the_length_as_surely_as_they_say(
    images: tuple[int, ...], rays: bool
) -> None:
    """Distances along the rays, 6 % longer than z, are converted, with a warning."""
    within = []
    for seed in range(6):
        scene, _, pose = scene_and_pose(seed)
        both = maps_of(seed, rays=rays)
        maps = [both[n] if n + 1 in images else None for n in range(2)]
        result = with_length(pose, scene.matches, ScaleSource(), maps)
        told = [text for text in result.warnings if text not in pose.warnings]
        assert len(told) == rays and result.t is pose.t
        assert all("along the rays, not z along the optical axis" in text for text in told)
        assert abs(result.length / LENGTH - 1) < 0.03
        assert 0.01 < result.length_std / LENGTH < 0.04
        within.append(abs(result.length - LENGTH) < 1.645 * result.length_std)
    assert sum(within) >= 4


def test_depths_that_do_not_tell_their_kind_widen_the_deviation() -> None:
    """Of points at about the same angle to the optical axis: z and the distance are alike."""
    scene, points, pose = scene_and_pose(0)
    rays = scene.cameras[0].normalise(scene.points1)
    secant = np.sqrt(1 + np.square(rays).sum(1))
    rim = np.flatnonzero(scene.true & pose.inliers & (np.abs(secant - 1.08) < 0.01))
    lengths = []
    for depth in points[:, 2], points[:, 2] * secant:
        maps = [depth_map(scene.points1[rim], depth[rim], SIZE1, 0.02), None]
        result = with_length(pose, scene.matches, ScaleSource(), maps)
        assert len(rim) > 30 and result.warnings == pose.warnings
        assert result.length_std > result.length * np.hypot(0.02, 0.3 * 0.08)
        lengths.append(result.length)
    assert lengths[1] / lengths[0] == pytest.approx(1.08, abs=0.01)


def test_a_depth_map_of_another_scene_is_doubted() -> None:
    scene, points, pose = scene_and_pose(0)
    z = np.random.default_rng(1).permutation(points[scene.true, 2])
    maps = [depth_map(scene.points1[scene.true], z, SIZE1, 0.0), None]
    result = with_length(pose, scene.matches, ScaleSource(), maps)
    assert result.length_std is None
    assert "the matches contradict the depth" in result.warnings[-1]


def test_too_few_depths_give_no_length() -> None:
    scene, points, pose = scene_and_pose(0)
    few = np.flatnonzero(pose.inliers & scene.true)[:5]
    maps = [depth_map(scene.points1[few], points[few, 2], SIZE1, 0.0), None]
    result = with_length(pose, scene.matches, ScaleSource(), maps)
    assert result.length is None and result.length_std is None and result.R is pose.R
    *before, few = result.warnings
    assert tuple(before) == pose.warnings
    assert few == "the length of t is not known: 5 inliers have a depth, and 10 are needed"


def test_a_focal_length_that_is_uncertain_widens_the_deviation() -> None:
    scene, _, pose = scene_and_pose(0)
    unsure = replace(pose, camera1=replace(pose.camera1, focal_std=0.1))
    results = [with_length(p, scene.matches, ScaleSource(), maps_of(0)) for p in (pose, unsure)]
    assert results[0].length == results[1].length
    assert results[1].length_std > 0.1 * LENGTH > 3 * results[0].length_std


def test_the_length_is_text() -> None:
    scene, _, pose = scene_and_pose(0)
    assert "t [" in repr(pose) and "], up to scale" in repr(pose)
    stated = with_length(pose, scene.matches, ScaleSource(baseline=(1.5,)), [None, None])
    assert (stated.length, stated.length_std) == (1.5, None)
    assert "], 1.5 m\n" in repr(stated)
    stated = with_length(pose, scene.matches, ScaleSource(baseline=(1.5, 0.02)), [None, None])
    assert "], 1.5 m +- 0.02 m\n" in repr(stated)
    assert stated.to_dict()["length"] == 1.5 and stated.to_dict()["length_std"] == 0.02


def test_without_a_pose_or_a_source_nothing_changes() -> None:
    scene, _, pose = scene_and_pose(0)
    assert with_length(pose, scene.matches, ScaleSource(), [None, None]) is pose
    matches = two_view_scene("random").matches
    failure = estimate_pose(matches, *scene.cameras)
    assert not failure.success
    source = ScaleSource(baseline="2")
    assert with_length(failure, matches, source, [None, None]) is failure


def test_a_marker_tells_the_length_as_surely_as_it_says() -> None:
    within = []
    for seed in range(6):
        scene, points, pose = scene_and_pose(seed)
        middle = np.median(points, axis=0)
        corners, rng = square(0.1 * middle[2], middle, (0.2, 0.3, 0)), np.random.default_rng(seed)
        poses = np.eye(3, 4), np.column_stack([scene.R, LENGTH * scene.t])
        markers = []
        for K, cam in zip((scene.K1, scene.K2), poses, strict=True):
            markers.append({"a:1": pixels_of(K, cam, corners) + rng.normal(0, 0.1, (4, 2))})
        source = ScaleSource(marker=0.1 * middle[2])
        result = with_length(pose, scene.matches, source, [None, None], markers)
        assert abs(result.length / LENGTH - 1) < 0.05
        within.append(abs(result.length - LENGTH) < 1.645 * result.length_std)
    assert sum(within) >= 4
    for found in markers:
        found["a:1"] = np.random.default_rng(1).uniform(0, 300, (4, 2))
    result = with_length(pose, scene.matches, source, [None, None], markers)
    assert result.length is None and result.warnings[-1].endswith("poses of 0 of its 2 images")


def test_a_marker_that_moved_is_told_by_the_inliers_around_it() -> None:
    """By a tenth of the distance of the cameras, in its direction."""
    scene = two_view_scene("planar")
    exact = two_view_scene("planar", sigma_px=0.0, outliers=0.0)
    pose = estimate_pose(scene.matches, *scene.cameras)
    poses = np.eye(3, 4), np.column_stack([exact.R, LENGTH * exact.t])
    seen = exact.points1, exact.points2
    rays = [c.normalise(p) for c, p in zip(exact.cameras, seen, strict=True)]
    z = LENGTH * depths(*rays, exact.R, exact.t)[0]
    middle = np.median(z) * np.append(np.median(rays[0], axis=0), 1)
    corners = square(0.05 * middle[2], middle, (0.2, 0.3, 0))
    told = {}
    for share in (0.0, 0.1, -0.1):
        moved = corners - share * LENGTH * exact.R.T @ exact.t
        at = zip((scene.K1, scene.K2), poses, (corners, moved), strict=True)
        markers = [{"a:1": pixels_of(*part)} for part in at]
        source = ScaleSource(marker=0.05 * middle[2])
        told[share] = with_length(pose, scene.matches, source, [None, None], markers)
    still, away, near = told.values()
    assert abs(still.length - LENGTH) < 2 * still.length_std < 0.1 * LENGTH
    assert still.warnings == pose.warnings
    assert away.length is None and "farther than the points around it" in away.warnings[-1]
    assert near.length_std is None and "nearer than the points around it" in near.warnings[-1]


def test_a_marker_must_be_in_both_images() -> None:
    source = ScaleSource(marker=0.1)
    drawn = draw_markers(
        texture((320, 240)),
        np.diag([300.0, 300, 1]) + [[0, 0, 160], [0, 0, 120], [0] * 3],
        np.eye(3, 4),
        {"4X4_1000:3": square(0.2, (0, 0, 1))},
    )
    images = [Image(np.dstack([pixels] * 3)) for pixels in (drawn, texture((320, 240)))]
    with pytest.raises(InputError, match="image 1 shows 4X4_1000:3, image 2 none$"):
        source.markers(images)
    assert [*source.markers([images[0]] * 2)[1]] == ["4X4_1000:3"]
    assert ScaleSource().markers(images) == []


@pytest.mark.parametrize(
    "values",
    [
        {"baseline": (0.0,)},
        {"baseline": (1.0, np.inf)},
        {"baseline": (1.0, 2.0, 3.0)},
        {"baseline": "1,nan"},
        {"depth_std": 0.0},
        {"marker": 0.0},
        {"marker": 15.0},
        {"marker": 0.1, "baseline": (1.0,)},
        {"depth1": "a.png", "depth2": "b.png", "baseline": (1.0,)},
    ],
)
def test_sources_out_of_range_are_refused(values: dict[str, object]) -> None:
    with pytest.raises(InputError, match=list(values)[0]):
        ScaleSource(**values)  # type: ignore[arg-type]
