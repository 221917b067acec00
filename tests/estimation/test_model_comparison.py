"""Other cameras than those that K states, of scenes that the true cameras see exactly."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scenes import SceneKind, TwoViewScene, camera_scene, pinhole, poster_scene, two_view_scene
from scipy.spatial.transform import Rotation

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation import RelativePose, estimate_pose
from dgc_pose.estimation.camera_fit import JointPose
from dgc_pose.estimation.camera_model import other_models
from dgc_pose.estimation.intrinsics_prior import FOCALS, IntrinsicsPrior
from dgc_pose.estimation.model_comparison import _Sample
from dgc_pose.estimation.model_fit import ModelFit, Quadratic
from dgc_pose.estimation.probability import shipped_models
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.matches import Matches
from dgc_pose.metrics import rotation_error_deg

SIZE = (1536, 1024)
NETWORK = min(shipped_models().weights)  # of which a probability is known
# Motions whose optical axes do not meet, so that the matches tell the focal lengths.
MOTIONS = {
    "aside": {},
    "far": {"turn_deg": (4.0, 22.0, 15.0), "centre": (2.5, 1.5, 0.5)},
    "near": {"turn_deg": (-6.0, 9.0, -10.0), "centre": (1.0, -1.0, 0.4)},
}
EACH_MOTION = pytest.mark.parametrize(("motion", "seed"), list(zip(MOTIONS, range(3), strict=True)))
K1 = -0.15
BARREL = Distortion("OPENCV", (K1, 0.0, 0.0, 0.0))


def _one(camera: Camera) -> tuple[Camera, Camera]:
    """Both images are of it, as by one K."""
    camera = replace(camera, identity="K")
    return camera, camera


CAMERA, ZOOMED = pinhole(1300, SIZE), pinhole(1950, SIZE)
LENS = pinhole(1300, SIZE, BARREL)


def _scene(camera1: Camera, camera2: Camera, motion: str, seed: int) -> TwoViewScene:
    return camera_scene(camera1, camera2, seed=seed, weights=NETWORK, **MOTIONS[motion])


def _agreed(pose: RelativePose) -> list[str]:
    """What the matches agree with, of both images or of one."""
    found = (re.fullmatch(r"(?:image \d: )?the matches agree with (.*)", w) for w in pose.warnings)
    return [match[1] for match in found if match]


def _numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?\d+\.?\d*", text)]


def _assert_found(pose: RelativePose, scene: TwoViewScene, name: str) -> None:
    """The pose is that of the camera found, and its errors as stated."""
    assert pose.success and pose.evidence.camera_model == name, (pose, pose.warnings)
    rotation, translation = scene.errors_deg(pose)
    assert rotation < min(1.0, pose.rotation_error_90_deg)
    assert translation < min(1.0, pose.translation_error_90_deg)
    assert pose.probability > 0.9


def _is_honest(pose: RelativePose, scene: TwoViewScene) -> bool:
    if not pose.success or pose.probability < 0.5:
        return True
    errors = np.array(scene.errors_deg(pose))
    stated = np.array([pose.rotation_error_90_deg, pose.translation_error_90_deg])
    return bool((errors < 3 * stated).all())


@pytest.mark.parametrize(
    ("motion", "factor", "seed"), [("aside", 0.8, 0), ("far", 1.3, 1), ("near", 1.6, 0)]
)
def test_a_K_that_is_wrong_for_both_images(motion: str, factor: float, seed: int) -> None:
    scene = _scene(CAMERA, CAMERA, motion, seed)
    pose = scene.estimate(*_one(CAMERA.with_focal(1300 * factor)), seed=seed)
    assert pose.evidence.camera_model in ("focal", "picture")
    _assert_found(pose, scene, pose.evidence.camera_model)
    (said,) = _agreed(pose)
    focal, std, states = _numbers(said)
    assert re.fullmatch(r"f = \d+ \+- \d+ px,( as without K,)? and K states \d+", said)
    assert abs(focal - 1300) < max(3 * std, 1.0) < 100 and states == round(1300 * factor)
    assert len(pose.warnings) == 1
    for camera in (pose.camera1, pose.camera2):
        assert abs(camera.focal - 1300) < max(3 * camera.focal_std * camera.focal, 1.0)
        assert camera.focal_source == "matches" and not camera.exact


@pytest.mark.parametrize(("motion", "seed", "stated"), [("aside", 0, CAMERA), ("near", 1, ZOOMED)])
def test_a_K_that_is_that_of_one_image_alone(motion: str, seed: int, stated: Camera) -> None:
    scene = _scene(CAMERA, ZOOMED, motion, seed)
    named = (replace(stated, identity=f"K{n}") for n in (1, 2))
    pose = scene.estimate(*named, seed=seed)
    _assert_found(pose, scene, "focals")
    (said,) = _agreed(pose)  # of the other image
    stds = [camera.focal_std * camera.focal for camera in (pose.camera1, pose.camera2)]
    assert abs(pose.camera1.focal - 1300) < 3 * stds[0] < 150
    assert abs(pose.camera2.focal - 1950) < 3 * stds[1] < 150
    other, std = (pose.camera2, stds[1]) if stated is CAMERA else (pose.camera1, stds[0])
    np.testing.assert_allclose(_numbers(said), (other.focal, std, stated.focal), atol=0.51)


@EACH_MOTION
def test_K1_and_K2_that_are_swapped(motion: str, seed: int) -> None:
    scene = _scene(CAMERA, ZOOMED, motion, seed)
    named = (replace(camera, identity=f"K{n}") for n, camera in enumerate((ZOOMED, CAMERA)))
    pose = scene.estimate(*named, seed=seed)
    _assert_found(pose, scene, "swapped")
    assert [camera.focal for camera in (pose.camera1, pose.camera2)] == [1300, 1950]
    said = [f"f = {focal} px, as the K of the other image" for focal in (1300, 1950)]
    assert _agreed(pose) == said


@pytest.mark.parametrize(
    ("motion", "seed", "one"), [("aside", 0, True), ("far", 1, False), ("near", 2, True)]
)
def test_a_lens_that_is_left_out(motion: str, seed: int, one: bool) -> None:
    scene = _scene(LENS, LENS, motion, seed)
    pose = scene.estimate(*(_one(CAMERA) if one else (CAMERA, CAMERA)), seed=seed)
    _assert_found(pose, scene, "lens")
    (said,) = pose.warnings
    lens = r"the matches agree with a lens of k1 = (\S+) \+- (\S+), and K states none"
    k1, std = map(float, re.fullmatch(lens, said).groups())
    assert abs(k1 - K1) < 3 * std < 0.05
    for camera in (pose.camera1, pose.camera2):
        assert abs(camera.distortion.radial[0] - K1) < 3 * camera.lens_std < 0.05
        # A K that lacks a lens is not exact in the rest either.
        assert abs(np.log(camera.focal / CAMERA.focal)) < 3 * camera.focal_std < 0.06


@EACH_MOTION
def test_a_lens_that_the_images_do_not_have(motion: str, seed: int) -> None:
    """As of images that are undistorted already."""
    scene = _scene(CAMERA, CAMERA, motion, seed)
    pose = scene.estimate(*_one(LENS), seed=seed)
    _assert_found(pose, scene, "unlensed")
    assert _agreed(pose) == ["no lens, and K states OPENCV"] and len(pose.warnings) == 1
    assert pose.camera1.distortion is None is pose.camera2.distortion


@EACH_MOTION
def test_a_principal_point_far_off(motion: str, seed: int) -> None:
    """K of a photograph for a part of it, whose own is in its middle."""
    scene = _scene(CAMERA, CAMERA, motion, seed)
    moved = pinhole(1300, SIZE, centre=(120, 80))
    pose = scene.estimate(*_one(moved), seed=seed)
    _assert_found(pose, scene, pose.evidence.camera_model)
    assert pose.evidence.camera_model in ("middle", "centre")
    (said,) = _agreed(pose)
    x, y, std, *states = _numbers(said)
    assert re.fullmatch(r"a principal point of \(.*\) \+- \d+ px, and K states \(.*\)", said)
    assert np.abs(np.subtract((x, y), CAMERA.K[:2, 2])).max() < 3 * std < 200
    np.testing.assert_allclose(states, moved.K[:2, 2], atol=0.51)


@pytest.mark.parametrize("kind", ["general", "skew", "orbit", "planar", "forward"])
def test_a_right_K_is_never_contradicted(kind: SceneKind) -> None:
    for seed in range(4):
        scene = two_view_scene(kind, seed=seed, count=400, outliers=0.3)
        scene = replace(scene, matches=replace(scene.matches, weights=NETWORK))
        pose = scene.estimate(*scene.cameras, seed=seed)
        assert not _agreed(pose), (seed, pose.warnings)
        assert pose.evidence is None or pose.evidence.camera_model == "assumed"
        if pose.success:
            assert pose.camera1 is scene.cameras[0] and pose.camera2 is scene.cameras[1]
            if kind in ("general", "skew"):
                assert pose.evidence.camera_agreement > 0.99 and pose.probability > 0.9


@pytest.mark.parametrize("camera", [CAMERA, LENS, pinhole(1300, SIZE, centre=(40, -30)), ZOOMED])
@pytest.mark.parametrize("motion", MOTIONS)
def test_a_right_K_of_any_camera_is_kept(camera: Camera, motion: str) -> None:
    scene = _scene(camera, camera, motion, 0)
    pose = scene.estimate(*_one(camera))
    assert pose.success and pose.warnings == ()
    assert pose.evidence.camera_model == "assumed" and pose.camera1.exact
    assert max(scene.errors_deg(pose)) < 0.5


@pytest.mark.parametrize("centre", [(0.0, 0.0, 0.0), (1.5, 1.2, 0.3), (0.6, 0.1, 0.1)])
def test_a_right_principal_point_far_from_the_middle_is_kept(centre) -> None:
    """As of a part of a photograph; also where the camera only turned."""
    part = pinhole(1300, SIZE, centre=(110, -70))
    for seed in range(2):
        scene = camera_scene(part, part, seed=seed, centre=centre, weights=NETWORK)
        pose = scene.estimate(*_one(part), seed=seed)
        assert pose.evidence.camera_model == "assumed" and not _agreed(pose), pose.warnings
        assert rotation_error_deg(pose.R, scene.R) < 0.15
        assert (pose.status == "rotation_only") is (not any(centre))


@pytest.mark.parametrize("factor", [0.7, 1.0, 1.4])
@pytest.mark.parametrize("kind", ["orbit", "forward"])
def test_a_focal_length_that_the_matches_hardly_tell_contradicts_nothing(kind, factor) -> None:
    """Few matches of a motion with axes that meet, or along the axis."""
    for seed in range(2):
        scene = two_view_scene(kind, seed=seed, count=60, sigma_px=1.5, same_camera=True)
        cameras = _one(scene.cameras[0].with_focal(factor * scene.cameras[0].focal))
        pose = scene.estimate(*cameras, seed=seed)
        assert not _agreed(pose), pose.warnings


@EACH_MOTION
def test_cameras_that_are_not_found_are_no_wrong_pose(motion: str, seed: int) -> None:
    scene = _scene(CAMERA, ZOOMED, motion, seed)
    for cameras in ((ZOOMED, CAMERA), (CAMERA, CAMERA), (ZOOMED, ZOOMED)):
        pose = scene.estimate(*cameras, seed=seed)
        assert _is_honest(pose, scene), (scene.errors_deg(pose), pose, pose.warnings)


@EACH_MOTION
def test_images_whose_principal_point_is_off_and_K_that_has_it_in_the_middle(
    motion: str, seed: int
) -> None:
    """Two views hardly tell it from two focal lengths."""
    part = pinhole(1300, SIZE, centre=(60, -50))
    scene = _scene(part, part, motion, seed)
    pose = scene.estimate(*_one(CAMERA), seed=seed)
    assert pose.success and _is_honest(pose, scene)
    assert pose.evidence.camera_model in ("centre", "focal", "focals", "assumed")


@pytest.mark.parametrize("factor", [1.0, 0.8, 1.3])
def test_a_plane_contradicts_no_K(factor: float) -> None:
    """It has two unknown cameras that explain it for each focal length."""
    for seed in range(2):
        for scene in (poster_scene(seed=seed), two_view_scene("planar", seed=seed, count=400)):
            cameras = [camera.with_focal(factor * camera.focal) for camera in scene.cameras]
            pose = scene.estimate(*cameras, seed=seed)
            if factor == 1:
                assert not _agreed(pose), pose.warnings
            elif _agreed(pose):
                assert _is_honest(pose, scene), (scene.errors_deg(pose), pose.warnings)


@pytest.mark.parametrize("stated", [{"focal_std": 0.3}, {"lens_std": 0.2, "focal_std": 0.3}])
def test_a_K_with_a_wide_deviation_is_fitted_and_not_contradicted(stated: dict) -> None:
    scene = _scene(CAMERA, CAMERA, "aside", 0)
    (wide, _) = _one(replace(CAMERA.with_focal(1690), **stated))
    pose = scene.estimate(wide, wide)
    assert pose.success and pose.evidence.camera_model == "assumed" and not _agreed(pose)
    assert abs(np.log(pose.camera1.focal / 1300)) < max(3 * pose.camera1.focal_std, 0.01)


@pytest.mark.parametrize(
    "stated",
    [
        # A lens that is not undone at the middle, and a part that is left of its principal point.
        Camera([1000, 1000, 100, 100], (1601, 1201), Distortion("RADIAL", (-0.3, 0.0))),
        Camera([1000, 1000, -20, -20]),
    ],
)
def test_a_K_of_a_part_far_off_the_middle_is_compared(stated: Camera) -> None:
    rng = np.random.default_rng(0)
    R = Rotation.from_euler("y", 8, degrees=True).as_matrix()
    points = rng.uniform([-1, -1, 5], [4, 3, 9], (6000, 3))
    rays = [points, points @ R.T + (0.9, 0.1, 0.2)]
    near = np.all([np.hypot(*(x[:, :2] / x[:, 2:]).T) < 0.9 for x in rays], axis=0)
    pixels = [stated.project(x[near, :2] / x[near, 2:]) for x in rays]
    inside = np.all([(p >= 0).all(1) for p in pixels], axis=0)
    first, second = (p[inside][:500] + rng.normal(0, 0.3, (500, 2)).clip(-1, 1) for p in pixels)
    second[:250] = rng.permutation(second[:250])
    matches = Matches(first.clip(0), second.clip(0), np.full(len(first), 0.9), error_px=0.5)
    pose = estimate_pose(matches, stated, stated)
    assert pose.evidence.camera_model in ("assumed", "focal", "lens")
    assert rotation_error_deg(pose.R, R) < 1.0


@pytest.mark.parametrize("seed", [0, 1])
def test_a_part_of_the_photograph_of_K(seed: int) -> None:
    """K is that of the whole photograph: its principal point is outside of the middle of the part,
    and the focal length is right."""
    whole = pinhole(1300, (1536, 1024))
    part = Camera(whole.K - [[0, 0, 400], [0, 0, 150], [0, 0, 0]], (1100, 800))
    scene = camera_scene(whole, part, seed=seed, weights=NETWORK)
    pose = scene.estimate(whole, Camera(whole.K, part.size), seed=seed)
    assert pose.evidence.camera_model in ("centre", "middle") and _is_honest(pose, scene)
    assert pose.warnings[0].startswith("image 2: the matches agree with a principal point of (")


@pytest.mark.parametrize("corrected", [(True, False), (True, True)])
def test_corrected_verticals(corrected: tuple[bool, bool]) -> None:
    """A level view of what a camera saw that looked up: the principal point is far along y."""
    plain, level = pinhole(1300, (1536, 1024)), pinhole(1400, (1536, 1024), centre=(0, -240))
    scene = camera_scene(*(level if is_level else plain for is_level in corrected), weights=NETWORK)
    pose = scene.estimate(plain, plain)
    assert pose.success and pose.evidence.camera_model == "centre" and _is_honest(pose, scene)
    said = [line for line in pose.warnings if "corrected verticals, a shift lens or a crop" in line]
    assert len(said) == 1 and said[0].startswith("the matches" if all(corrected) else "image 1")


def test_a_telescope_whose_focal_length_the_matches_confirm_is_kept() -> None:
    telescope = pinhole(5.0 * 1200, (1200, 900))
    away = {"depths": (14.0, 40.0), "centre": (6.0, 0.5, 3.0), "turn_deg": (1.0, 12.0, 4.0)}
    scene = camera_scene(telescope, telescope, count=600, weights=NETWORK, **away)
    pose = scene.estimate(*scene.cameras)
    assert pose.success and pose.evidence.camera_model == "assumed" and not _agreed(pose)


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
