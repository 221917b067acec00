"""The cameras of a folder: pooled, against Gaussian arithmetic and drawn errors; and which
photographs share one, by pairs of points that known cameras see."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from results import exif_camera
from scenes import camera_scene, pinhole

from dgc_pose.batch.folder_cameras import by_image, fit_of, folder_cameras, pool, pooled_fit
from dgc_pose.batch.pairs import MatchedPair, PairRow, row_of
from dgc_pose.batch.store import Plan, open_store
from dgc_pose.batch.workers import Job, PoseRunner, Task, Worker
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import FISHEYE, Distortion
from dgc_pose.cameras.prior import auto_camera
from dgc_pose.estimation import EstimationOptions, RelativePose
from dgc_pose.images.decoding import Exif, Header
from dgc_pose.matchers import MatcherOptions
from dgc_pose.matches import Matches

OPEN = exif_camera()
PRIOR = OPEN.focal_std


def _pooled(values, std, images, weights=None):
    """The value and the deviation of fits (N,) of one parameter."""
    values = np.array(values, float)[:, None]
    covariance = np.broadcast_to(np.square(std), len(values))[:, None, None]
    weights = np.ones(len(values)) if weights is None else np.array(weights)
    pooled, deviation = pooled_fit(values, covariance, weights, np.array([PRIOR]), images)
    return float(pooled[0]), float(deviation[0])


def test_parameters_that_are_correlated():
    """Equal fits of four pairs: four times the information of the matches, and that of the prior.
    In the first axis the matches say nothing."""
    prior = np.array([PRIOR, 8.0, 8.0])
    sines = np.array([[1, 0.2, 0], [-0.2, 1, 0.5], [0.1, -0.5, 1]])
    axes = np.linalg.qr(sines)[0]
    of_matches = (axes * [0.0, 40, 900]) @ axes.T / np.outer(prior, prior)
    covariance = np.linalg.inv(of_matches + np.diag(prior**-2))
    true = np.array([0.01, 0.3, -0.2])
    value = covariance @ of_matches @ true
    fits = np.tile(value, (4, 1)), np.tile(covariance, (4, 1, 1)), np.ones(4)
    pooled, std = pooled_fit(*fits, prior, 8)
    together = np.linalg.inv(4 * of_matches + np.diag(prior**-2))
    np.testing.assert_allclose(pooled, together @ (4 * of_matches @ true), rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(std, np.sqrt(np.diag(together)), rtol=1e-3)


def test_outliers_do_not_move_a_pooled_camera():
    right, wrong = 0.1 + np.linspace(-0.01, 0.01, 9), [-1.2, -1.2, -1.4]
    stds, weights = [0.01] * 9 + [0.005, 0.005, 0.001], [1.0] * 11 + [0.01]
    value, std = _pooled([*right, *wrong], stds, 24, weights)
    assert abs(value - 0.1) < 0.004 and std < 0.02


@pytest.mark.parametrize(("images", "count"), [(20, 10), (5, 2.5), (1, 1)])
def test_errors_of_an_image_are_shared_by_its_pairs(images, count):
    """Ten pairs of five images count as two and a half."""
    assert _pooled([0.0] * 10, 0.01, images)[1] == pytest.approx(0.01 / count**0.5, rel=1e-3)


def test_scatter_widens_the_deviation():
    """Eight fits two deviations away: each of the weight w = 1 / (1 + 4 / 2.385^2), and 4 times
    the variance that they state."""
    value, std = _pooled([-0.02, 0.02] * 4, 0.01, 16)
    weight = 1 / (1 + 4 / 2.385**2)
    assert abs(value) < 1e-4
    assert std == pytest.approx(0.02 / (8 * weight) ** 0.5, rel=0.01)


def _pair(name1, name2, focal1, focal2, std=0.01):
    """A pair that tells focal lengths, the principal point (51.5, 39.5), and the lens."""
    lens = Distortion("RADIAL", (0.05, -0.1))
    first, second = (
        Camera(np.array([focal, focal, 51.5, 39.5]), OPEN.size, lens) for focal in (focal1, focal2)
    )
    covariance = np.diag([std**2, 0.25, 0.25, 1e-4, 1e-4, 1e-4] * 2)
    pose = RelativePose(
        *("ok", "a pose", np.ones(9, bool), 9),
        camera1=first,
        camera2=second,
        camera_covariance=covariance,
        probability=1.0,
    )
    return PairRow(name1, name2, "ok", "a pose", pose)


def test_each_camera_has_its_pairs():
    """One of two images, one of an image alone, one that no pair tells, and one that is exact."""
    cameras = {
        "a": exif_camera("x"),
        "b": exif_camera("x"),
        "c": exif_camera(None),
        "d": exif_camera(None),
    }
    exact = {"focal_std": 0.0, "centre_std": 0.0, "lens_std": 0.0, "focal_source": "given"}
    cameras["e"] = replace(exif_camera("y"), **exact)
    pairs = [
        _pair("a", "b", 121, 121),
        _pair("a", "c", 121, 99),
        _pair("c", "b", 99, 121),
        _pair("a", "d", 121, 300, std=0.39),
        replace(_pair("a", "c", 500, 500), pose=None),
    ]
    listed = pool(cameras, pairs)
    pooled = by_image(listed)
    assert [tuple(one.cameras) for one in listed] == [("a", "b"), ("c",), ("d",)]
    assert [one.pairs for one in listed] == [3, 2, 0]
    assert pooled["a"].focal == pooled["b"].focal == pytest.approx(121, rel=1e-3)
    assert pooled["c"].focal == pytest.approx(99, rel=1e-3)
    assert pooled["a"].focal_std < 0.011 and pooled["a"].focal_source == "matches"
    np.testing.assert_allclose(pooled["a"].K[:2, 2], (51.5, 39.5), atol=0.05)
    assert pooled["a"].centre_std < 0.6
    lens = pooled["a"].distortion
    assert lens is not None and lens.model == "RADIAL" and pooled["a"].lens_std < 0.011
    np.testing.assert_allclose(lens.coefficients, (0.05, -0.1), rtol=0.01)
    assert pooled["d"].distortion is None and pooled["d"].lens_std == OPEN.lens_std
    assert (pooled["d"].focal, pooled["d"].focal_std) == (110, PRIOR)
    assert pooled["d"].focal_source == "exif" and pooled["d"].centre_std == OPEN.centre_std
    backwards = by_image(pool(cameras, pairs[::-1]))
    for name, camera in pooled.items():
        np.testing.assert_array_equal(backwards[name].K, camera.K)


def test_images_of_two_sizes_share_no_principal_point():
    cameras = {"a": exif_camera("x"), "b": replace(exif_camera("x"), size=(80, 100))}
    pooled = by_image(pool(cameras, [_pair("a", "b", 121, 121)]))
    for name in "ab":
        assert pooled[name].focal == pytest.approx(121, rel=1e-3)
        np.testing.assert_array_equal(pooled[name].K[:2, 2], OPEN.K[:2, 2])
        assert pooled[name].centre_std == OPEN.centre_std


def test_a_pair_without_a_pose_or_of_another_camera_model_fits_no_camera():
    rows = [_pair("a", "b", 121, 121)] * 3
    pose = replace(rows[1].pose, status="improbable")
    rows[1:] = replace(rows[1], pose=pose), replace(rows[2], camera_model="squeezed")
    assert all(row.fitted_cameras is not None for row in rows)
    assert [fit_of(row) is not None for row in rows] == [True, False, False]


SIZE, FOCAL, COUNT = (1200, 800), 1100.0, 4
TURNS = ((8, 15, 12), (-9, 14, -10), (10, -16, 9), (7, 13, -14), (-8, -15, 11), (9, 12, 13))
CENTRES = ((1.5, 1.2, 0.3), (1.4, -1.3, 0.2), (-1.5, 1.1, -0.3))
SECOND = "1.png"


def _prior(camera: Camera, exif: Exif = Exif()) -> Camera:  # noqa: B008, it is frozen
    assert camera.size is not None
    return auto_camera(Header("JPEG", camera.size, exif))


def _folder(out, true, priors=None):
    """The cameras of photographs 0.png, 1.png and so on, those one by one, and the tasks that they
    took after each pair was fitted alone."""
    names = tuple(f"{i}.png" for i in range(len(true)))
    priors = priors or {name: _prior(c) for name, c in zip(names, true, strict=True)}
    pairs = np.array(list(combinations(range(len(true)), 2)))
    worker = Worker(Job(out, priors, {}, MatcherOptions("sift"), EstimationOptions(runs=1), 2**20))
    alone = []
    for k, (i, j) in enumerate(pairs):
        scene = camera_scene(
            true[i],
            true[j],
            seed=k,
            count=400,
            outliers=0.1,
            turn_deg=TURNS[k % len(TURNS)],
            centre=CENTRES[k % len(CENTRES)],
        )
        points = (scene.matches.points1, scene.matches.points2, scene.matches.confidence)
        matches = Matches(*(array.astype(np.float32) for array in points), 0.5)
        pose = RelativePose("ok", "", np.zeros(len(matches), bool), len(matches))
        alone.append(MatchedPair(row_of((names[i], names[j]), pose, 0.5, k), matches))
    done: list[Task] = []

    def run(work, tasks):
        done.extend(tasks)
        return (work(worker, *task) for task in tasks)

    with open_store(out, create=True) as store:
        store.begin(Plan(out, priors, {}, {}, names, pairs, {}))
        store.add("matched", worker.estimate(alone, priors, fit_cameras=True))
        listed = folder_cameras(PoseRunner(store, run, 1), priors)
    return by_image(listed), listed, done


def test_photographs_that_agree_share_a_camera_without_further_work(tmp_path):
    cameras, (one,), tasks = _folder(tmp_path, [pinhole(FOCAL, SIZE)] * COUNT)
    assert len(one.cameras) == COUNT and one.why == "" and not tasks
    assert all(camera.focal == pytest.approx(FOCAL, rel=0.02) for camera in cameras.values())


@pytest.mark.parametrize(
    ("focal", "size", "centre", "error"),
    [
        (1.5 * FOCAL, SIZE, (0.0, 0.0), 0.05),
        (1.3 * FOCAL, SIZE, (170.0, -110.0), 0.05),
        (FOCAL, (900, 600), (-150.0, -100.0), 0.08),  # the lower right three quarters, as they are
    ],
)
def test_a_zoomed_or_cut_photograph_has_a_camera_of_its_own(tmp_path, focal, size, centre, error):
    """Without EXIF data: its pairs alone tell, and it bends no camera of others."""
    true = [pinhole(FOCAL, SIZE)] * COUNT
    true[1] = pinhole(focal, size, centre=centre)
    cameras, listed, _ = _folder(tmp_path, true)
    assert [len(one.cameras) for one in listed] == [COUNT - 1, 1]
    assert {*listed[1].cameras} == {SECOND}
    own = cameras.pop(SECOND)
    assert own.focal == pytest.approx(focal, rel=error)
    off = np.abs(own.K[:2, 2] - true[1].K[:2, 2])
    assert (off < 3 * own.centre_std).all()
    if size == SIZE:
        assert listed[1].why and own.identity is None and own.centre_std < 0.08 * SIZE[0]
    for camera in cameras.values():
        assert camera.focal == pytest.approx(FOCAL, rel=0.02)
        assert np.abs(camera.K[:2, 2] - true[0].K[:2, 2]).max() < 0.02 * SIZE[0]


def test_a_camera_of_one_image_alone_takes_no_other(tmp_path):
    """Of a resized photograph without an identity, as fixed cameras have none."""
    half = SIZE[0] // 2, SIZE[1] // 2
    true = [pinhole(FOCAL, SIZE)] * 3
    true[1] = true[1].resized(half)
    priors = {f"{i}.png": _prior(camera) for i, camera in enumerate(true)}
    priors[SECOND] = replace(priors[SECOND], identity=None)
    cameras, _, _ = _folder(tmp_path, true, priors)
    small, whole = cameras[SECOND], cameras["0.png"]
    assert small.identity is None and whole.identity is not None and small.size == half
    assert small.focal == pytest.approx(FOCAL / 2, rel=0.05) and small.focal != whole.focal / 2


def test_the_model_of_most_pairs_is_that_of_the_camera(tmp_path):
    """An action camera's fisheye, of which no file says anything."""
    size = (1280, 960)
    fisheye = pinhole(620.0, size, Distortion(FISHEYE, (0.0,) * 4))
    cameras, _, _ = _folder(tmp_path, [fisheye] * 3)
    for camera in cameras.values():
        assert camera.distortion is not None and camera.distortion.model == FISHEYE
        assert camera.focal == pytest.approx(620.0, rel=0.03)
        assert camera.lens_std < 0.1


def test_a_stated_camera_stays_that_of_all(tmp_path):
    """A K with a deviation, which one photograph contradicts."""
    true = [pinhole(FOCAL, SIZE)] * 3
    stated = replace(true[0], focal_std=0.05, identity="K")
    true[1] = pinhole(1.5 * FOCAL, SIZE)
    priors = {f"{i}.png": stated for i in range(3)}
    _, (one,), _ = _folder(tmp_path, true, priors)
    assert {*one.cameras} == {*priors}


def test_photographs_of_several_zooms_have_no_camera_in_common(tmp_path):
    """Of one size, without EXIF data, as of a rig of two lenses or a zooming camera: most pairs are
    of two cameras."""
    true = [pinhole(factor * FOCAL, SIZE) for factor in (0.8, 1.1, 1.5)]
    cameras, listed, _ = _folder(tmp_path, true)
    for name, camera in zip(sorted(cameras), true, strict=True):
        found = cameras[name]
        assert found.focal == pytest.approx(camera.focal, rel=0.06)
        assert abs(np.log(found.focal / camera.focal)) < 3 * found.focal_std
    reason = "most pairs of its size fit a separate focal length for each photograph"
    assert [one.why for one in listed] == 3 * [reason]
