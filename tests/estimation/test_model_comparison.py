"""When no other camera than the stated or assumed one is found: a usual one, stated ones, matches
that hardly tell; and parts of the comparison."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scenes import NO_EXIF, TwoViewScene, camera_scene, pinhole, poster_scene, two_view_scene

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation import RelativePose, candidates, relative_pose
from dgc_pose.estimation.camera_changes import Cameras
from dgc_pose.estimation.camera_fit import JointPose
from dgc_pose.estimation.camera_model import model_named, other_models
from dgc_pose.estimation.intrinsics_prior import FOCALS, IntrinsicsPrior
from dgc_pose.estimation.model_comparison import _Sample
from dgc_pose.estimation.model_fit import ModelFit, Quadratic, assumed_fit
from dgc_pose.estimation.probability import shipped_models
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.images.decoding import Exif
from dgc_pose.metrics import rotation_error_deg

SIZE = (1536, 1024)
NETWORK = min(shipped_models().weights)  # of which a probability is known
OF_30_MM = Exif("Maker", "X1", focal_35mm=30)
LENS = Distortion("RADIAL", (-0.03, 0.01))
CAMERA = pinhole(1300, SIZE)
ZOOMED = pinhole(1950, SIZE)
USUAL = pinhole(1250, SIZE, LENS, centre=(3, -2))
SQUEEZED = pinhole(1250, (1152, 1024), LENS, aspect=0.75)
FISHEYE = pinhole(1440 / np.radians(119), (1440, 1080), Distortion("OPENCV_FISHEYE", (0.0,) * 4))
MATCHED = {"count": 500, "weights": NETWORK}
# Motions whose optical axes do not meet, and one around points 6 away.
FAR = {"turn_deg": (4.0, 22.0, 15.0), "centre": (2.5, 1.5, 0.5)}
NEAR = {"turn_deg": (-6.0, 9.0, -10.0), "centre": (1.0, -1.0, 0.4)}
ORBIT = {"turn_deg": (0.0, 20.0, 0.0), "centre": (2.05, 0.1, 0.36), "depths": (5.0, 7.0)}


def _one(camera: Camera, **deviations: Any) -> Cameras:
    """Both images are of it, as by one K."""
    camera = replace(camera, identity="K", **deviations)
    return camera, camera


def _is_honest(pose: RelativePose, scene: TwoViewScene) -> bool:
    """Whether the errors are within three times the stated ones, of a probable pose."""
    if not pose.success or (pose.probability is not None and pose.probability < 0.5):
        return True
    stated = np.array([pose.rotation_error_90_deg, pose.translation_error_90_deg])
    return bool((np.array(scene.errors_deg(pose)) < 3 * stated).all())


@pytest.mark.parametrize(("number", "kind"), [(1, "equirectangular"), (2, "cylindrical")])
def test_a_panorama_by_its_file_has_no_fit(number: int, kind: str, monkeypatch) -> None:
    monkeypatch.setattr(relative_pose, "candidates", None)
    scene = camera_scene(USUAL, USUAL)
    cameras = list(scene.auto())
    cameras[number - 1] = replace(cameras[number - 1], projection=kind)
    pose = scene.estimate(*cameras)
    assert pose.status == "panorama" and pose.R is None and pose.evidence is None
    assert pose.reason == f"image {number} is {kind}, as its XMP data state"
    assert pose.inliers.shape == (len(scene.matches),) and not pose.inliers.any()


@pytest.mark.parametrize(("exif", "most"), [(NO_EXIF, 6.0), (OF_30_MM, 1.5)])
def test_a_usual_camera_costs_nothing(exif: Exif, most: float, monkeypatch) -> None:
    """The pose is that of the assumed cameras alone, and its error grows by no half with EXIF data.
    Without, a part of a larger picture is in the errors."""
    scene = camera_scene(USUAL, USUAL)
    pose = scene.estimate(*scene.auto(exif))

    def assumed(problem, pose):
        return assumed_fit(problem.cameras, pose)

    monkeypatch.setattr(candidates, "likeliest_model", assumed)
    alone = scene.estimate(*scene.auto(exif))
    assert (pose.status, pose.evidence.camera_model) == ("ok", "assumed")
    rotation, translation = replace(scene, R=alone.R, t=alone.t).errors_deg(pose)
    assert rotation <= alone.rotation_error_90_deg
    assert translation <= alone.translation_error_90_deg
    assert pose.rotation_error_90_deg < most * alone.rotation_error_90_deg
    assert pose.translation_error_90_deg < most * alone.translation_error_90_deg


KNOWN_LENS = {"focal_std": 0.45, "distortion": LENS}


@pytest.mark.parametrize(
    ("true", "deviations"),
    [
        (SQUEEZED, {}),
        (FISHEYE, {}),
        (SQUEEZED, {"focal_std": 0.2}),
        (FISHEYE, {"focal_std": 0.2, "lens_std": 0.1, "identity": "a"}),
        (FISHEYE, KNOWN_LENS),
        (FISHEYE, KNOWN_LENS | {"focal_source": "size"}),
    ],
)
def test_a_stated_camera_is_never_of_another_kind(true: Camera, deviations: dict[str, Any]) -> None:
    """Although it is wrong: K, with deviations or none, and a lens. Another focal length, lens or
    principal point may be found."""
    scene = camera_scene(true, true)
    stated = [Camera(camera.K, camera.size, **deviations) for camera in scene.auto()]
    pose = scene.estimate(*stated)
    model = pose.evidence.camera_model
    contradicts = model_named(model).contradicts_K and "focal_source" not in deviations
    assert model == "assumed" or contradicts
    for camera, before in zip((pose.camera1, pose.camera2), stated, strict=True):
        if pose.success:
            ratio = camera.K[1, 1] / camera.K[0, 0]
            assert ratio == pytest.approx(before.K[1, 1] / before.K[0, 0])
            assert deviations or model != "assumed" or camera is before
            assert camera.distortion is None or camera.distortion.model in ("RADIAL", "OPENCV")
    if model != "assumed":
        assert any(", and K states " in warning for warning in pose.warnings)


def test_a_part_of_a_photograph_that_only_turned_keeps_its_K() -> None:
    part = pinhole(1300, SIZE, centre=(110, -70))
    scene = camera_scene(part, part, weights=NETWORK, centre=(0.0, 0.0, 0.0))
    pose = scene.estimate(*_one(part))
    assert pose.status == "rotation_only" and pose.evidence.camera_model == "assumed"
    assert rotation_error_deg(pose.R, scene.R) < 0.15 and pose.warnings == ()


FEW = {"count": 60, "sigma_px": 1.5, "same_camera": True}


@pytest.mark.parametrize(
    ("kind", "changes", "factor"),
    [
        ("general", {}, 1.0),
        ("orbit", {}, 1.0),
        ("forward", {}, 1.0),
        ("planar", {}, 1.0),
        ("poster", {}, 1.0),
        # Few matches of a motion with axes that meet, or along the axis.
        ("orbit", FEW, 0.7),
        ("orbit", FEW, 1.4),
        ("forward", FEW, 0.7),
        ("forward", FEW, 1.4),
    ],
)
@pytest.mark.parametrize("seed", [0, 1])
def test_matches_that_hardly_tell_f_contradict_no_K(
    kind: Any, changes: dict[str, Any], factor: float, seed: int
) -> None:
    changes = {"seed": seed} | changes
    scene = poster_scene(**changes) if kind == "poster" else two_view_scene(kind, **changes)
    stated = [camera.with_focal(factor * camera.focal) for camera in scene.cameras]
    stated = stated if factor == 1 else _one(stated[0])
    pose = scene.estimate(*stated, seed=seed)
    assert not any("the matches agree with" in line for line in pose.warnings), pose.warnings
    if factor == 1:
        assert pose.evidence is None or pose.evidence.camera_model == "assumed"
        if pose.success:
            assert pose.camera1 is stated[0] and pose.camera2 is stated[1]


@pytest.mark.parametrize(
    ("scene", "stated"),
    [
        (camera_scene(CAMERA, ZOOMED, **MATCHED), (ZOOMED, CAMERA)),
        (camera_scene(CAMERA, ZOOMED, seed=1, **MATCHED, **FAR), (CAMERA, CAMERA)),
        (camera_scene(CAMERA, ZOOMED, seed=2, **MATCHED, **NEAR), (ZOOMED, ZOOMED)),
        # A plane has two unknown cameras that explain it for each focal length.
        (poster_scene(seed=1), 0.8),
        (two_view_scene("planar", count=400), 1.3),
    ],
    ids=["swapped", "K of image 1", "K of image 2", "poster", "plane"],
)
def test_cameras_that_are_not_found_are_no_wrong_pose(
    scene: TwoViewScene, stated: Cameras | float
) -> None:
    if isinstance(stated, float):
        cameras = [camera.with_focal(stated * camera.focal) for camera in scene.cameras]
    else:
        cameras = [*stated]
    pose = scene.estimate(*cameras)
    if isinstance(stated, tuple) or any("the matches agree with" in w for w in pose.warnings):
        assert _is_honest(pose, scene), (scene.errors_deg(pose), pose, pose.warnings)


def test_the_deviation_of_K_widens_the_expected_error() -> None:
    scene = camera_scene(CAMERA, CAMERA, **ORBIT)
    exact, loose = (scene.estimate(*_one(CAMERA, focal_std=std)) for std in (0.0, 0.05))
    assert loose.rotation_error_90_deg > 1.5 * exact.rotation_error_90_deg
    assert _is_honest(loose, scene)


@pytest.mark.parametrize(
    ("K", "log_focal", "std", "confirms"),
    [
        (pinhole(6000, (1200, 900)), np.log(6000), 0.1, True),
        (pinhole(6000, (1200, 900)), np.log(6000) - 0.3, 0.2, True),
        (pinhole(6000, (1200, 900)), np.log(6000) - 0.3, 0.1, False),  # another focal length
        (pinhole(6000, (1200, 900)), np.log(6000), 0.35, False),  # not determined
        (pinhole(6000, (1200, 900), aspect=1.5), np.log(6000), 0.1, False),
        (pinhole(6000, (1200, 900), centre=(300, 0)), np.log(6000), 0.1, False),
    ],
)
def test_an_unusual_focal_length_is_confirmed_by_the_cameras_without_K(
    K: Camera, log_focal: float, std: float, confirms: bool
) -> None:
    near = {"turn_deg": (0.0, 5.0, 2.0), "centre": (3.0, 0.3, 0.3), "depths": (20.0, 40.0)}
    scene = camera_scene(K, K, count=200, **near)
    pose = JointPose(scene.R, scene.t, np.zeros(0))
    sample = _Sample.of(TwoViewProblem.of(scene.matches, K, K), pose)
    model, variant = next(
        (model, variant) for model, variant in other_models((K, K)) if model.name == "picture"
    )
    prior = IntrinsicsPrior.of(*variant.cameras)
    off = np.zeros(12)
    off[FOCALS] = log_focal - np.log(variant.cameras[0].focal)
    z = np.linalg.lstsq(prior.basis, off, rcond=None)[0]
    fit = ModelFit(model, variant.cameras, pose=replace(pose, z=z), focal_std=std)
    assert sample.confirms_K(fit) is confirms


@pytest.mark.parametrize(
    ("count", "times"),
    [(100, 3.0), (500, 3.0), (1000, 3.0), (2000, 1.5), (4000, 1.0)],
)
def test_the_doubt_has_the_information_after_further_steps(
    count: int, times: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    doubt = Quadratic.doubt

    def noted(near: Quadratic, assumed: ModelFit, others: list[ModelFit], weight: float) -> float:
        asked.append(weight)
        return doubt(near, assumed, others, weight)

    monkeypatch.setattr(Quadratic, "doubt", noted)
    scene = camera_scene(*_one(CAMERA), count=count, outliers=0.0, seed=1, weights=NETWORK)
    scene.estimate(*_one(CAMERA))
    assert asked == [pytest.approx(times, rel=0.02)]
