"""Which photographs of a folder share a camera: pairs of points that known cameras see."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scenes import camera_scene, pinhole

from dgc_pose.batch.folder_cameras import folder_cameras
from dgc_pose.batch.plan import Plan
from dgc_pose.batch.pooling import by_image
from dgc_pose.batch.poses import Poses
from dgc_pose.batch.rows import MatchedPair, row_of
from dgc_pose.batch.store import open_store
from dgc_pose.batch.work import Job, Worker
from dgc_pose.batch.workers import Task
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import FISHEYE, Distortion
from dgc_pose.cameras.prior import auto_camera
from dgc_pose.estimation import EstimationOptions, RelativePose
from dgc_pose.images.decoding import Exif, Header
from dgc_pose.matchers import MatcherOptions
from dgc_pose.matches import Matches

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
    worker = Worker(Job(out, priors, {}, MatcherOptions("sift"), EstimationOptions(runs=3), 2**20))
    alone = []
    for k, (i, j) in enumerate(pairs):
        scene = camera_scene(
            true[i],
            true[j],
            seed=k,
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
        listed = folder_cameras(Poses(store, run, 1), priors)
    return by_image(listed), listed, done


def test_photographs_that_agree_share_a_camera_without_further_work(tmp_path):
    cameras, (one,), tasks = _folder(tmp_path, [pinhole(FOCAL, SIZE)] * COUNT)
    assert len(one.cameras) == COUNT and one.why == "" and not tasks
    assert all(camera.focal == pytest.approx(FOCAL, rel=0.02) for camera in cameras.values())


@pytest.mark.parametrize(
    ("focal", "centre"), [(1.5 * FOCAL, (0.0, 0.0)), (1.3 * FOCAL, (170.0, -110.0))]
)
def test_a_zoomed_or_cut_photograph_has_a_camera_of_its_own(tmp_path, focal, centre):
    """Of the same size, without EXIF data: its pairs alone tell."""
    true = [pinhole(FOCAL, SIZE)] * COUNT
    true[1] = pinhole(focal, SIZE, centre=centre)
    cameras, listed, _ = _folder(tmp_path, true)
    assert [len(one.cameras) for one in listed] == [COUNT - 1, 1]
    assert {*listed[1].cameras} == {SECOND} and listed[1].why
    own = cameras.pop(SECOND)
    assert own.identity is None and own.focal == pytest.approx(focal, rel=0.05)
    off = np.abs(own.K[:2, 2] - true[1].K[:2, 2])
    assert (off < 3 * own.centre_std).all() and own.centre_std < 0.08 * SIZE[0]
    for camera in cameras.values():
        assert camera.focal == pytest.approx(FOCAL, rel=0.02)
        assert np.abs(camera.K[:2, 2] - true[0].K[:2, 2]).max() < 0.02 * SIZE[0]


@pytest.mark.parametrize("resized", [(1,), (3, 4, 5)])
def test_a_resized_photograph_has_the_camera_of_the_others(tmp_path, resized):
    """Off by the same factor as they are: a single one, and a group of its own."""
    half = SIZE[0] // 2, SIZE[1] // 2
    true = [pinhole(FOCAL, SIZE)] * (3 + len(resized))
    for i in resized:
        true[i] = true[i].resized(half)
    cameras, listed, _ = _folder(tmp_path, true)
    assert len(listed) == 2 and "at its size" in listed[1].why
    whole, small = cameras["0.png"], cameras[f"{resized[0]}.png"]
    assert small.size == half and small.identity == whole.identity is not None
    assert small.focal == pytest.approx(whole.focal / 2)
    assert small.focal == pytest.approx(FOCAL / 2, rel=0.02)


def test_a_camera_of_one_image_alone_takes_no_other(tmp_path):
    """Of a resized photograph without an identity, as fixed cameras have none."""
    half = SIZE[0] // 2, SIZE[1] // 2
    true = [pinhole(FOCAL, SIZE)] * COUNT
    true[1] = true[1].resized(half)
    priors = {f"{i}.png": _prior(camera) for i, camera in enumerate(true)}
    priors[SECOND] = replace(priors[SECOND], identity=None)
    cameras, _, _ = _folder(tmp_path, true, priors)
    small, whole = cameras[SECOND], cameras["0.png"]
    assert small.identity is None and whole.identity is not None and small.size == half
    assert small.focal == pytest.approx(FOCAL / 2, rel=0.05) and small.focal != whole.focal / 2


def test_a_resized_photograph_does_not_have_the_camera_of_a_zoomed_one(tmp_path):
    """Which comes first, and is of the size and EXIF data of the others."""
    true = [pinhole(FOCAL, SIZE)] * COUNT
    true[0] = pinhole(1.5 * FOCAL, SIZE)
    true[-1] = true[-1].resized((SIZE[0] // 2, SIZE[1] // 2))
    cameras, _, _ = _folder(tmp_path, true)
    found = [cameras[name].focal for name in sorted(cameras)]
    np.testing.assert_allclose(found, [camera.focal for camera in true], rtol=0.05)


def test_a_part_of_another_size_bends_no_camera_of_others(tmp_path):
    """The lower right three quarters of a photograph, as they are."""
    part = (900, 600)
    true = [pinhole(FOCAL, SIZE)] * COUNT
    true[1] = pinhole(FOCAL, part, centre=(-150.0, -100.0))
    cameras, listed, _ = _folder(tmp_path, true)
    assert {*listed[-1].cameras} == {SECOND}
    own = cameras[SECOND]
    assert own.focal == pytest.approx(FOCAL, rel=0.08)
    assert (np.abs(own.K[:2, 2] - true[1].K[:2, 2]) < 3 * own.centre_std).all()
    assert cameras["0.png"].focal == pytest.approx(FOCAL, rel=0.02)


def test_a_part_of_another_width_is_not_a_squeezed_photograph(tmp_path):
    true = [pinhole(FOCAL, SIZE)] * COUNT
    true[1] = pinhole(FOCAL, (SIZE[1], SIZE[1]))
    cameras, listed, _ = _folder(tmp_path, true)
    assert {*listed[-1].cameras} == {SECOND} and "squeezed" not in listed[-1].why
    np.testing.assert_allclose(cameras[SECOND].K[[0, 1], [0, 1]], FOCAL, rtol=0.05)


def test_the_model_of_most_pairs_is_that_of_the_camera(tmp_path):
    """An action camera's fisheye, of which no file says anything."""
    size = (1280, 960)
    fisheye = pinhole(620.0, size, Distortion(FISHEYE, (0.0,) * 4))
    cameras, _, _ = _folder(tmp_path, [fisheye] * COUNT)
    for camera in cameras.values():
        assert camera.distortion is not None and camera.distortion.model == FISHEYE
        assert camera.focal == pytest.approx(620.0, rel=0.03)
        assert camera.lens_std < 0.1


def test_a_stated_camera_stays_that_of_all(tmp_path):
    """A K with a deviation, which one photograph contradicts."""
    true = [pinhole(FOCAL, SIZE)] * COUNT
    stated = replace(true[0], focal_std=0.05, identity="K")
    true[1] = pinhole(1.5 * FOCAL, SIZE)
    priors = {f"{i}.png": stated for i in range(COUNT)}
    _, (one,), _ = _folder(tmp_path, true, priors)
    assert {*one.cameras} == {*priors}


def test_a_squeezed_photograph_has_the_camera_of_the_others(tmp_path):
    """To three quarters of the width, which no pair alone tells from another focal length."""
    true = [pinhole(FOCAL, SIZE)] * COUNT
    true[1] = true[0].resized((900, 800))
    cameras, listed, _ = _folder(tmp_path, true)
    assert "squeezed" in listed[-1].why and {*listed[-1].cameras} == {SECOND}
    np.testing.assert_allclose(cameras[SECOND].K[[0, 1], [0, 1]], (825.0, 1100.0), rtol=0.02)


@pytest.mark.parametrize(
    "factors",
    [pytest.param((1.0, 1.6, 1.0, 1.6), marks=pytest.mark.slow), (0.8, 1.0, 1.3, 1.65)],
)
def test_photographs_of_several_zooms_have_no_camera_in_common(tmp_path, factors):
    """Of one size, without EXIF data, as of a rig of two lenses or a zooming camera: most pairs are
    of two cameras."""
    true = [pinhole(factor * FOCAL, SIZE) for factor in factors]
    cameras, listed, _ = _folder(tmp_path, true)
    for name, camera in zip(sorted(cameras), true, strict=True):
        found = cameras[name]
        assert found.focal == pytest.approx(camera.focal, rel=0.06)
        assert abs(np.log(found.focal / camera.focal)) < 3 * found.focal_std
    for one in listed:
        assert len({factors[int(name[0])] for name in one.cameras}) == 1
        assert one.why or len(one.cameras) > 1
    if len({*factors}) == COUNT:
        reason = "most pairs of its size agree with a focal length of each photograph"
        assert [one.why for one in listed] == COUNT * [reason]
