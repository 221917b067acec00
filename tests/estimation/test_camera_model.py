"""The cameras that two images may have, by what is stated of them: models and prior log-odds."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import NO_EXIF, pinhole

from dgc_pose.cameras.camera import LOG_FOCALS, Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.cameras.prior import (
    USUAL_K,
    auto_camera,
    auto_cameras,
    by_lines,
    improbability,
)
from dgc_pose.estimation.camera_changes import Cameras, Variant
from dgc_pose.estimation.camera_model import other_models, with_model
from dgc_pose.estimation.camera_texts import is_contradicted
from dgc_pose.images.decoding import Exif, Header

SIZE = (1536, 1024)
LENS = Distortion("RADIAL", (-0.03, 0.01))
OF_30_MM = Exif("Maker", "X1", focal_35mm=30)  # of 1536 x 1024 a focal length of 1280 pixels
USUAL = pinhole(1250, SIZE, LENS, centre=(3, -2))


def _auto(exif: Exif = NO_EXIF) -> Cameras:
    """The cameras of two photographs without a K."""
    header = Header("JPEG", SIZE, exif)
    return auto_cameras(header, header)


def _models(*cameras: Camera) -> dict[str, list[Variant]]:
    found: dict[str, list[Variant]] = {}
    for model, variant in other_models((cameras[0], cameras[1])):
        found.setdefault(model.name, []).append(variant)
    return found


def test_the_models_beside_the_assumed_one() -> None:
    """Those of pictures, of two pictures of two cameras, and of a K."""
    edited = {"squeezed", "off_centre", "fisheye", "cylinder"}
    found = _models(*_auto())
    assert found.keys() == {*edited, "tail", "two"} and all(len(f) == 1 for f in found.values())
    two = found["two"][0]
    assert [camera.identity for camera in two.cameras] == [None, None]
    assert found["tail"][0].cameras[0].focal > 1.5 * _auto()[0].focal
    # EXIF data make the others less likely.
    exif = _models(*_auto(OF_30_MM))
    for name in ("two", "fisheye", "tail"):
        assert exif[name][0].log_odds < found[name][0].log_odds < 0
    # A camera whose EXIF data are whole has square pixels, and its principal point in the middle.
    assert exif.keys() == {"tail", "two", "fisheye", "cylinder"}
    # One of the images is of another focal length than its EXIF data say.
    stds = [[camera.focal_std for camera in variant.cameras] for variant in exif["two"]]
    np.testing.assert_allclose(stds, [(0.55, 0.08), (0.08, 0.55)], rtol=0.02)
    apart = _models(*(replace(camera, identity=None) for camera in _auto()))
    assert apart.keys() == {*edited, "tail"} and len(apart["tail"]) == 2
    for number, model in enumerate(apart["tail"]):
        moved = [camera.focal != 0.9 * 1536 for camera in model.cameras]
        assert moved == [number == 0, number == 1]
    stated = USUAL, _auto()[1]
    assert _models(*stated).keys() == {*edited, "tail"}


def test_the_models_in_place_of_a_K() -> None:
    plain = pinhole(1250, SIZE)
    usual = {"focal", "focals", "lens", "centre", "picture"}
    assert _models(plain, plain).keys() == usual
    assert _models(USUAL, USUAL).keys() == {*usual, "unlensed"}
    assert _models(plain, pinhole(1500, SIZE)).keys() == {*usual, "swapped"}
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
    camera, _ = _auto()
    for name, (variant, *_) in _models(camera, camera).items():
        assert with_model(camera, name).focal == variant.cameras[0].focal
    assert with_model(camera, "swapped") is camera is with_model(camera, "assumed")


def test_lines_of_each_image_speak_for_two_cameras() -> None:
    cameras = _auto()

    def lines(focal: float) -> np.ndarray:
        return 3 * np.exp(-(((LOG_FOCALS - np.log(focal)) / 0.1) ** 2) / 2)

    def odds(*focals: float) -> float:
        with_lines = by_lines(cameras, [lines(focal) for focal in focals])
        (model,) = _models(*with_lines)["two"]
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
