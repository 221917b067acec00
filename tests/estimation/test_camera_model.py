"""Which camera the matches agree with, of scenes that cameras of each kind see exactly."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import NO_EXIF, TwoViewScene, camera_scene, pinhole

from dgc_pose.cameras.camera import LOG_FOCALS, Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.cameras.prior import USUAL_K, auto_camera, by_lines, improbability
from dgc_pose.estimation import RelativePose, candidates, relative_pose
from dgc_pose.estimation.camera_changes import Variant
from dgc_pose.estimation.camera_model import model_named, other_models, with_model
from dgc_pose.estimation.camera_texts import is_contradicted
from dgc_pose.estimation.model_fit import assumed_fit
from dgc_pose.estimation.probability import shipped_models
from dgc_pose.images.decoding import Exif, Header

SIZE = (1536, 1024)
NETWORK = min(shipped_models().weights)  # of which a probability is known
LENS = Distortion("RADIAL", (-0.03, 0.01))
EQUIDISTANT, CYLINDER = Distortion("OPENCV_FISHEYE", (0.0,) * 4), Distortion("CYLINDER")
OF_30_MM = Exif("Maker", "X1", focal_35mm=30)  # of 1536 x 1024 a focal length of 1280 pixels
ASIDE = {"turn_deg": (5.0, 30.0, 3.0), "centre": (3.0, 0.5, 0.5)}


def _panorama(degrees: float = 100) -> Camera:
    return pinhole(1400 / np.radians(degrees), (1400, 700), CYLINDER)


USUAL = pinhole(1250, SIZE, LENS, centre=(3, -2))
ZOOMED = pinhole(1.6 * 1280, SIZE, LENS)
SQUEEZED = pinhole(1250, (1152, 1024), LENS, aspect=0.75)
PARTS = [pinhole(1900, (1700, 1200), centre=centre) for centre in ((60, -40), (-50, 50))]
FISHEYE = pinhole(1440 / np.radians(119), (1440, 1080), EQUIDISTANT)
# The true cameras, the model, and the changes of the scene.
CASES = {
    "usual": ((USUAL, USUAL), "assumed", {}),
    "squeezed": ((SQUEEZED, SQUEEZED), "squeezed", {}),
    "parts": (PARTS, "off_centre", ASIDE),
    "fisheye": ((FISHEYE, FISHEYE), "fisheye", {}),
    "zoomed": ((ZOOMED, ZOOMED), "assumed", {}),
    "two": ((pinhole(1000, SIZE, LENS), pinhole(1500, SIZE, LENS)), "two", {}),
    "one zoomed": ((pinhole(1280, SIZE), pinhole(1.6 * 1280, SIZE)), "two", {"weights": NETWORK}),
    "first zoomed": (
        (pinhole(1.3 * 1280, SIZE, LENS), pinhole(1280, SIZE, LENS)),
        "two",
        {"count": 600, "outliers": 0.5},
    ),
}
SAID = {
    "assumed": None,
    "squeezed": "the matches agree with pixels that are not square, fy / fx = ",
    "off_centre": "the matches agree with a principal point of its own, (",
    "fisheye": "the matches agree with a fisheye, f = ",
    "two": "the matches agree with a different focal length for each image, f = ",
}


def _scene(name: str, seed: int) -> TwoViewScene:
    cameras, _, changes = CASES[name]
    return camera_scene(*cameras, seed=seed, **changes)


def _assert_as_stated(pose: RelativePose, scene: TwoViewScene, times: float = 2.0) -> None:
    errors = scene.errors_deg(pose)
    stated = pose.rotation_error_90_deg, pose.translation_error_90_deg
    assert (np.array(errors) <= times * np.array(stated)).all(), (errors, stated)


@pytest.mark.parametrize("name", CASES)
def test_the_model_is_named_and_the_pose_as_near_as_is_stated(name: str) -> None:
    scene, model = _scene(name, 0), CASES[name][1]
    pose = scene.estimate(*scene.auto(OF_30_MM if "zoomed" in name else NO_EXIF))
    named = "assumed" if pose.evidence.camera_model == "tail" else pose.evidence.camera_model
    assert (pose.status, named) == ("ok", model)
    _assert_as_stated(pose, scene, 3.0)
    says = SAID[model]
    if name == "zoomed":
        says = f"the matches agree with f = {pose.camera1.focal:.0f} +- "
        assert pose.warnings[0].endswith(" px, and EXIF states 1280")
    if says is None:
        assert pose.warnings == ()
    else:
        same = pose.camera1.focal == pose.camera2.focal and name != "parts"
        starts = [says] if same else [f"image {number}: {says}" for number in (1, 2)]
        for warning, start in zip(pose.warnings, starts, strict=True):
            assert warning.startswith(start)
    for camera, true in zip((pose.camera1, pose.camera2), scene.cameras, strict=True):
        assert camera.focal_source == "matches"
        assert abs(np.log(camera.focal / true.focal)) < 3 * camera.focal_std < 0.6
        ratio = np.log(camera.K[1, 1] / camera.K[0, 0]) - np.log(true.K[1, 1] / true.K[0, 0])
        assert abs(ratio) <= 3 * camera.aspect_std < 0.15
        offset = np.abs(camera.K[:2, 2] - true.K[:2, 2])
        assert (offset <= 3 * camera.centre_std).all()
        model = (true.distortion or LENS).model  # of a pinhole a lens is fitted as well
        assert camera.distortion.model == model and len(pose.camera_covariance) == 12


@pytest.mark.parametrize(("degrees", "seed"), [(90, 0), (120, 1)])
def test_images_on_a_cylinder_are_panoramas(degrees: float, seed: int) -> None:
    camera = _panorama(degrees)
    scene = camera_scene(camera, camera, seed=seed)
    pose = scene.estimate(seed=seed)
    assert pose.status == "panorama" and pose.evidence.camera_model == "cylinder"
    assert pose.R is None and pose.t is None and pose.camera1 is None and not pose.success
    assert "matches fit a cylindrical panorama" in pose.reason


@pytest.mark.parametrize(("exif", "seed"), [(NO_EXIF, 0), (OF_30_MM, 1)])
def test_a_usual_camera_costs_nothing(exif, seed, monkeypatch) -> None:
    """The pose is that of the assumed cameras alone, and its error grows by no half with EXIF data.
    Without, a part of a larger picture is in the errors."""
    scene = _scene("usual", seed)
    pose = scene.estimate(*scene.auto(exif), seed=seed)

    def assumed(problem, pose):
        return assumed_fit(problem.cameras, pose)

    monkeypatch.setattr(candidates, "likeliest_model", assumed)
    alone = scene.estimate(*scene.auto(exif), seed=seed)
    assert (pose.status, pose.evidence.camera_model) == ("ok", "assumed")
    rotation, translation = replace(scene, R=alone.R, t=alone.t).errors_deg(pose)
    assert rotation <= alone.rotation_error_90_deg
    assert translation <= alone.translation_error_90_deg
    most = 6.0 if exif is NO_EXIF else 1.5
    assert pose.rotation_error_90_deg < most * alone.rotation_error_90_deg
    assert pose.translation_error_90_deg < most * alone.translation_error_90_deg


@pytest.mark.parametrize(
    "stated",
    [
        {},
        {"focal_std": 0.2},
        {"focal_std": 0.2, "lens_std": 0.1, "identity": "a"},
        {"focal_std": 0.45, "distortion": LENS},
        {"focal_std": 0.45, "distortion": LENS, "focal_source": "size"},
    ],
)
@pytest.mark.parametrize("name", ["squeezed", "fisheye"])
def test_a_camera_that_is_stated_is_of_no_other_kind(name: str, stated: dict[str, object]) -> None:
    """Although it is wrong: K, with deviations or none, and a lens. Another focal length, lens or
    principal point may be found."""
    scene = _scene(name, 0)
    cameras = [Camera(camera.K, camera.size, **stated) for camera in scene.auto()]
    pose = scene.estimate(*cameras)
    named = pose.evidence.camera_model
    contradicts = model_named(named).contradicts_K
    assert named == "assumed" or (contradicts and "focal_source" not in stated)
    for camera, before in zip((pose.camera1, pose.camera2), cameras, strict=True):
        if pose.success:
            ratio = camera.K[1, 1] / camera.K[0, 0]
            assert ratio == pytest.approx(before.K[1, 1] / before.K[0, 0])
            assert stated or named != "assumed" or camera is before
            assert camera.distortion is None or camera.distortion.model in ("RADIAL", "OPENCV")
    if named != "assumed":
        assert any(", and K states " in warning for warning in pose.warnings)


@pytest.mark.parametrize(
    ("other", "models"),
    [
        # A lens of two coefficients fits such an image of 119 degrees as well.
        (FISHEYE, {"fisheye", "assumed", "squeezed", "off_centre"}),
        (_panorama(), {"cylinder"}),
        (USUAL, {"assumed"}),
    ],
    ids=["fisheye", "cylinder", "usual"],
)
@pytest.mark.parametrize("first", [True, False])
def test_beside_a_camera_that_is_stated_the_other_alone_changes(other, models, first) -> None:
    """first: whether the camera that is stated is that of image 1."""
    stated = pinhole(1100, (1400, 1000), LENS)
    scene = camera_scene(*((stated, other) if first else (other, stated)), seed=1)
    prior = scene.auto()
    pose = scene.estimate(*((stated, prior[1]) if first else (prior[0], stated)))
    assert pose.evidence.camera_model in models
    if models == {"cylinder"}:
        assert pose.status == "panorama"
        return
    assert pose.status == "ok"
    _assert_as_stated(pose, scene)
    kept, fitted = (pose.camera1, pose.camera2)[:: 1 if first else -1]
    assert kept is stated
    assert abs(np.log(fitted.focal / other.focal)) < 3 * fitted.focal_std
    middle, corner = (np.array(other.size) - 1) / 2, np.array([[100.0, 100.0]])
    points = middle + np.linspace(0.2, 0.7, 6)[:, None] * (corner - middle)
    np.testing.assert_allclose(fitted.normalise(points), other.normalise(points), atol=0.03)
    # What is unusual is told of the camera that changed alone.
    model = pose.evidence.camera_model
    said = [warning for warning in pose.warnings if "the matches agree with" in warning]
    assert len(said) == (model != "assumed")
    assert not said or said[0].startswith(f"image {2 if first else 1}: {SAID[model]}")


@pytest.mark.parametrize(("number", "kind"), [(1, "equirectangular"), (2, "cylindrical")])
def test_a_panorama_by_its_file_has_no_fit(number, kind, monkeypatch) -> None:
    monkeypatch.setattr(relative_pose, "candidates", None)
    scene = _scene("usual", 0)
    cameras = list(scene.auto())
    cameras[number - 1] = replace(cameras[number - 1], projection=kind)
    pose = scene.estimate(*cameras)
    assert pose.status == "panorama" and pose.R is None and pose.evidence is None
    assert pose.reason == f"image {number} is {kind}, as its XMP data state"
    assert pose.inliers.shape == (len(scene.matches),) and not pose.inliers.any()


@pytest.mark.parametrize(("over_side", "seed"), [(2.4, 0), (5.2, 1)])
def test_a_long_lens_on_an_orbit_is_in_the_expected_errors(over_side: float, seed: int) -> None:
    """As of a statue on a turntable, whose matches do not tell the focal length."""
    camera = pinhole(over_side * 1536, SIZE)
    away = 5.0 * over_side
    turn = np.radians(20.0)
    orbit = {"centre": (away * np.sin(turn), 0.1, away * (1 - np.cos(turn)))}
    orbit |= {"turn_deg": (0.0, 20.0, 0.0), "depths": (away - 1.0, away + 1.0)}
    scene = camera_scene(camera, camera, seed=seed, weights=NETWORK, **orbit)
    pose = scene.estimate(seed=seed)
    assert pose.success and pose.probability < 0.95
    _assert_as_stated(pose, scene, 3.0)


def _models(*cameras: Camera) -> dict[str, list[Variant]]:
    found: dict[str, list[Variant]] = {}
    for model, variant in other_models((cameras[0], cameras[1])):
        found.setdefault(model.name, []).append(variant)
    return found


def test_the_models_beside_the_assumed_one() -> None:
    """Those of pictures, of two pictures of two cameras, and of a K."""
    scene = _scene("usual", 0)
    edited = {"squeezed", "off_centre", "fisheye", "cylinder"}
    found = _models(*scene.auto())
    assert found.keys() == {*edited, "tail", "two"} and all(len(f) == 1 for f in found.values())
    two = found["two"][0]
    assert [camera.identity for camera in two.cameras] == [None, None]
    assert found["tail"][0].cameras[0].focal > 1.5 * scene.auto()[0].focal
    # EXIF data make the others less likely.
    exif = _models(*scene.auto(OF_30_MM))
    for name in ("two", "fisheye", "tail"):
        assert exif[name][0].log_odds < found[name][0].log_odds < 0
    # A camera whose EXIF data are whole has square pixels, and its principal point in the middle.
    assert exif.keys() == {"tail", "two", "fisheye", "cylinder"}
    # One of the images is of another focal length than its EXIF data say.
    stds = [[camera.focal_std for camera in variant.cameras] for variant in exif["two"]]
    np.testing.assert_allclose(stds, [(0.55, 0.08), (0.08, 0.55)], rtol=0.02)
    apart = _models(*(replace(camera, identity=None) for camera in scene.auto()))
    assert apart.keys() == {*edited, "tail"} and len(apart["tail"]) == 2
    for number, model in enumerate(apart["tail"]):
        moved = [camera.focal != 0.9 * 1536 for camera in model.cameras]
        assert moved == [number == 0, number == 1]
    stated = scene.cameras[0], scene.auto()[1]
    assert _models(*stated).keys() == {*edited, "tail"}


def test_the_models_in_place_of_a_K() -> None:
    plain = pinhole(1250, SIZE)
    of_any = {"focal", "focals", "lens", "centre", "picture"}
    assert _models(plain, plain).keys() == of_any
    assert _models(USUAL, USUAL).keys() == {*of_any, "unlensed"}
    assert _models(plain, pinhole(1500, SIZE)).keys() == {*of_any, "swapped"}
    assert "swapped" not in _models(plain, pinhole(1500, (1000, 800)))
    off = pinhole(1250, SIZE, centre=(40, 0)), pinhole(1250, SIZE, centre=(100, 0))
    middles = [_models(camera, camera)["middle"][0] for camera in off]
    assert middles[0].log_odds < middles[1].log_odds
    for model in middles:
        np.testing.assert_array_equal(model.cameras[0].K[:2, 2], (767.5, 511.5))
    # Two views of a stereo camera may be swapped; a lens that is no radial one is not opened.
    assert "swapped" in _models(plain, pinhole(1250, SIZE, centre=(150, 0)))
    opencv = pinhole(1250, SIZE, Distortion("OPENCV", (-0.1, 0.0, 0.001, 0.0)))
    assert "lens" not in _models(opencv, opencv)
    for model in (v for variants in _models(plain, plain).values() for v in variants):
        # A K that is contradicted in a part is exact in none.
        assert all(camera.focal_std and camera.centre_std for camera in model.cameras)


@pytest.mark.parametrize(
    "unusual",
    [
        *(pinhole(1250 * factor, SIZE) for factor in (3, 5, 10, 1 / 3)),
        *(pinhole(1250, SIZE, aspect=aspect) for aspect in (1.5, 1 / 1.5)),
        pinhole(1000, SIZE, centre=(-767.5, -511.5)),
    ],
)
def test_what_no_photograph_has_speaks_against_K(unusual: Camera) -> None:
    usual = pinhole(1250, SIZE)
    (picture, *_), (other, *_) = (_models(c, c)["picture"] for c in (usual, unusual))
    assert picture.log_odds + 2 < other.log_odds
    assert improbability(usual) < USUAL_K < improbability(unusual)
    assert other.cameras[0].focal == pytest.approx(0.9 * 1536)
    if unusual.focal in (3 * usual.focal, 5 * usual.focal):  # as EXIF data say
        film = unusual.focal / np.hypot(*SIZE) * 43.27
        picture = auto_camera(Header("JPEG", SIZE, Exif(focal_35mm=film)))
        assert improbability(replace(unusual, picture=picture)) < USUAL_K
    picture = auto_camera(Header("JPEG", SIZE, OF_30_MM))  # which say another focal length
    least = improbability(unusual) - 3  # by the density of the prior alone
    assert improbability(replace(unusual, picture=picture)) > least


def test_a_folder_s_camera_by_a_model_is_that_of_its_pairs() -> None:
    camera, _ = _scene("usual", 0).auto()
    for name, (variant, *_) in _models(camera, camera).items():
        assert with_model(camera, name).focal == variant.cameras[0].focal
    assert with_model(camera, "swapped") is camera is with_model(camera, "assumed")


def test_lines_of_each_image_speak_for_two_cameras() -> None:
    cameras = _scene("usual", 0).auto()

    def lines(focal: float) -> np.ndarray:
        return 3 * np.exp(-(((LOG_FOCALS - np.log(focal)) / 0.1) ** 2) / 2)

    def odds(*focals: float) -> float:
        of_both = by_lines(cameras, [lines(focal) for focal in focals])
        (model,) = _models(*of_both)["two"]
        if focals[0] != focals[1]:
            fitted = [camera.focal / 1536 for camera in model.cameras]
            np.testing.assert_allclose(fitted, focals, rtol=0.12)
        return model.log_odds

    assert odds(0.7, 1.2) > odds(0.9, 0.9) + 1 and odds(0.9, 0.9) < odds(0.8, 1.0) < 0


@pytest.mark.parametrize(
    ("ratio", "std", "contradicted"),
    [
        (1.05, 0.0, False),
        (1.09, 0.0, True),
        (1.0 / 1.09, 0.0, True),
        (1.09, 0.05, False),
        (1.2, 0.05, True),
        (1.2, 0.07, False),
    ],
)
def test_a_focal_length_is_contradicted_by_three_deviations(
    ratio: float, std: float, contradicted: bool
) -> None:
    stated = replace(USUAL, focal_std=std)
    assert is_contradicted(stated, stated.with_focal(ratio * stated.focal)) is contradicted
