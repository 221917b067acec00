"""Which cameras the matches agree with. A table: the true cameras of two views, what is stated of
them, the model that is found, and the images whose camera is told."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from scenes import NO_EXIF, TwoViewScene, camera_scene, pinhole

from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.colmap_camera import Distortion
from dgc_pose.estimation import RelativePose
from dgc_pose.estimation.camera_changes import Cameras
from dgc_pose.estimation.camera_model import MODELS
from dgc_pose.estimation.probability import shipped_models
from dgc_pose.images.decoding import Exif

SIZE = (1536, 1024)
NETWORK = min(shipped_models().weights)  # of which a probability is known
OF_30_MM = Exif("Maker", "X1", focal_35mm=30)  # of 1536 x 1024 a focal length of 1280 pixels
RADIAL = Distortion("RADIAL", (-0.03, 0.01))


def _of_size(focal: float, **changes: Any) -> Camera:
    return pinhole(focal, SIZE, **changes)


CAMERA = _of_size(1300)
ZOOMED = _of_size(1950)
BARREL = _of_size(1300, lens=Distortion("OPENCV", (-0.15, 0.0, 0.0, 0.0)))
CROP = _of_size(1300, centre=(110, -70))
SHIFTED = _of_size(1300, centre=(120, 80))
NEAR_MIDDLE = _of_size(1300, centre=(60, -50))
LEVEL = _of_size(1400, centre=(0, -240))  # a corrected view of what a camera saw that looked up
STRETCHED = _of_size(1300, aspect=0.95)
USUAL = _of_size(1250, lens=RADIAL, centre=(3, -2))
SQUEEZED = pinhole(1250, (1152, 1024), RADIAL, aspect=0.75)
FISHEYE = pinhole(1440 / np.radians(119), (1440, 1080), Distortion("OPENCV_FISHEYE", (0.0,) * 4))
PARTS = pinhole(1900, (1700, 1200), centre=(60, -40)), pinhole(1900, (1700, 1200), centre=(-50, 50))
PART = Camera(CAMERA.K - [[0, 0, 400], [0, 0, 150], [0, 0, 0]], (1100, 800))
KNOWN = pinhole(1100, (1400, 1000), RADIAL)
JOINED = pinhole(1400 / np.radians(90), (1400, 700), Distortion("CYLINDER"))
WIDE = pinhole(1400 / np.radians(120), (1400, 700), Distortion("CYLINDER"))
TELESCOPE = pinhole(5.0 * 1200, (1200, 900))
# A lens that is not undone at the middle, and a part that is left of its principal point.
CORNER = Camera([1000, 1000, 100, 100], (1601, 1201), Distortion("RADIAL", (-0.3, 0.0)))
LEFT = Camera([1000, 1000, -20, -20], (900, 700))

# The optical axes of all motions but an orbit's do not meet, so that the matches tell the focal
# lengths.
FAR = {"turn_deg": (4.0, 22.0, 15.0), "centre": (2.5, 1.5, 0.5), "seed": 1}
NEAR = {"turn_deg": (-6.0, 9.0, -10.0), "centre": (1.0, -1.0, 0.4), "seed": 2}
ASIDE = {"turn_deg": (5.0, 30.0, 3.0), "centre": (3.0, 0.5, 0.5)}
SHORT = {"centre": (0.6, 0.1, 0.1)}
AWAY = {"turn_deg": (1.0, 12.0, 4.0), "centre": (6.0, 0.5, 3.0), "depths": (14.0, 40.0)}
NOISY = {"sigma_px": 1.0, "outliers": 0.1}
TURNED = {"turn_deg": (0.0, 8.0, 0.0), "centre": (-0.9, -0.1, -0.3), "outliers": 0.5}


def _orbit(away: float) -> dict[str, Any]:
    """By 20 degrees around points that are so far away."""
    turn = np.radians(20.0)
    centre = away * np.sin(turn), 0.1, away * (1 - np.cos(turn))
    return {"turn_deg": (0, 20, 0), "centre": centre, "depths": (away - 1, away + 1)}


# What is told of each model; the fields are those of `_told`.
SAYS = {
    "assumed": "{f}, and {source} states {stated:.0f}",
    "tail": "{f}, and {source} states {stated:.0f}",
    "two": "a different focal length for each image, {f}",
    "squeezed": "pixels that are not square, fy / fx = {aspect}",
    "off_centre": "a principal point of its own, {centre}",
    "fisheye": "a fisheye, f = {focal:.0f} px",
    "focal": "{f}, and K states {stated:.0f}",
    "focals": "{f}, and K states {stated:.0f}",
    "picture": "{f}, as without K, and K states {stated:.0f}",
    "lens": "a lens of k1 = {k1}, and K states none",
    "unlensed": "no lens, and K states OPENCV",
    "centre": "a principal point of {centre}{cause}, and K states {stated_centre}",
    "middle": "a principal point of {centre}{cause}, and K states {stated_centre}",
    "swapped": "f = {focal:.0f} px, as the K of the other image",
}
SHIFT = ", as of corrected verticals, a shift lens or a crop"


@dataclass(frozen=True)
class Case:
    """Two views by true cameras, and what the estimate makes of what is stated of them."""

    true: Cameras
    stated: tuple[Camera | None, Camera | None]  # None: no K
    found: str  # models, one of which is found; "" for any
    told: tuple[int, ...] = ()  # images whose camera is told
    scene: Mapping[str, Any] = field(default_factory=dict)
    exif: Exif = NO_EXIF
    times: float = 1.0  # errors of the pose over the stated ones, at most
    error_deg: float = 1.0  # at most
    probable: tuple[float, float] = (0.0, 1.0)  # between which the probability is
    spread: tuple[float, float] = (0.0, 0.05)  # between which the deviation of ln f is
    cause: str = ""  # of a principal point far off
    status: str = "ok"
    near: bool = True  # whether the cameras that are found are the true ones

    def views(self) -> TwoViewScene:
        return camera_scene(*self.true, **{"weights": NETWORK, "count": 500} | dict(self.scene))

    def cameras(self, scene: TwoViewScene) -> Cameras:
        first, second = scene.auto(self.exif)
        return self.stated[0] or first, self.stated[1] or second


def _one(camera: Camera, **deviations: Any) -> Cameras:
    """Both images are of it, as by one K."""
    camera = replace(camera, identity="K", **deviations)
    return camera, camera


def _two(camera1: Camera, camera2: Camera) -> Cameras:
    return replace(camera1, identity="K1"), replace(camera2, identity="K2")


def _unknown(camera: Camera, factor: float, **deviations: Any) -> Camera:
    """A camera whose focal length is off, as that of an image without a K is."""
    return replace(_of_size(factor * camera.focal), focal_std=0.4, centre_std=15.0, **deviations)


PROBABLE = (0.9, 1.0)
ANY = (0.0, 1.0)
EXIF_DATA = {"focal_std": 0.06, "centre_std": 8.0, "focal_source": "exif"}

no_K = partial(Case, stated=(None, None), told=(1, 2), times=3, error_deg=15, spread=(0, 0.2))
zoom = partial(no_K, found="two")
long = partial(no_K, found="", told=(), probable=(0, 0.95), spread=(0, 1))
panorama = partial(Case, found="cylinder", status="panorama")
WITHOUT_K = {
    "usual": no_K((USUAL, USUAL), found="assumed tail", told=()),
    "squeezed": no_K((SQUEEZED, SQUEEZED), found="squeezed"),
    "parts of pictures": no_K(PARTS, found="off_centre", scene=ASIDE),
    "fisheye": no_K((FISHEYE, FISHEYE), found="fisheye"),
    "another f than EXIF": no_K(
        (_of_size(2048, lens=RADIAL),) * 2, found="assumed tail", exif=OF_30_MM
    ),
    "two": zoom((_of_size(1000, lens=RADIAL), _of_size(1500, lens=RADIAL))),
    "image 2 zoomed": zoom((_of_size(1280), _of_size(2048)), exif=OF_30_MM),
    "image 1 zoomed": zoom(
        (_of_size(1664, lens=RADIAL), _of_size(1280, lens=RADIAL)),
        exif=OF_30_MM,
        scene={"count": 600, "outliers": 0.5},
    ),
    # As of a statue on a turntable, whose matches do not tell the focal length.
    "long lens": long((_of_size(2.4 * 1536),) * 2, scene=_orbit(12.0)),
    "telescope": long((_of_size(5.2 * 1536),) * 2, scene=_orbit(26.0) | {"seed": 1}),
    "panorama": panorama((JOINED, JOINED), (None, None)),
    "wide panorama": panorama((WIDE, WIDE), (None, None)),
}

beside = partial(Case, times=2, error_deg=15, spread=(0, 0.2))
CURVED = "fisheye assumed squeezed off_centre"  # a lens of two coefficients fits as well
BESIDE_K = {
    "fisheye after": beside((KNOWN, FISHEYE), (KNOWN, None), CURVED, (2,)),
    "fisheye before": beside((FISHEYE, KNOWN), (None, KNOWN), CURVED, (1,)),
    "usual after": beside((KNOWN, USUAL), (KNOWN, None), "assumed"),
    "usual before": beside((USUAL, KNOWN), (None, KNOWN), "assumed"),
    "panorama after": panorama((KNOWN, JOINED), (KNOWN, None)),
    "panorama before": panorama((JOINED, KNOWN), (None, KNOWN)),
}

BOTH = CAMERA, CAMERA
UNLIKE = CAMERA, ZOOMED
wrong = partial(Case, told=(1, 2), probable=PROBABLE)
verticals = partial(wrong, found="centre", cause=SHIFT, times=3, error_deg=3, near=False)
WRONG_K = {
    "f too short": wrong(BOTH, _one(_of_size(1040)), "focal picture"),
    "f too long": wrong(BOTH, _one(_of_size(1690)), "focal picture", scene=FAR),
    "f far too long": wrong(BOTH, _one(_of_size(2080)), "focal picture", scene=NEAR),
    "f of no photograph": wrong(BOTH, _one(_of_size(6500)), "picture"),
    "K of image 1": wrong(UNLIKE, _two(CAMERA, CAMERA), "focals", told=(2,)),
    "K of image 2": wrong(UNLIKE, _two(ZOOMED, ZOOMED), "focals", told=(1,), scene=NEAR),
    "swapped": wrong(UNLIKE, _two(ZOOMED, CAMERA), "swapped"),
    "without the lens": wrong((BARREL, BARREL), _one(CAMERA), "lens"),
    "two without the lens": wrong((BARREL, BARREL), (CAMERA, CAMERA), "lens", scene=FAR),
    "lens of undistorted images": wrong(BOTH, _one(BARREL), "unlensed", scene=NEAR),
    "centre": wrong(BOTH, _one(SHIFTED), "middle centre"),
    # The principal point of a whole photograph is outside of the middle of its part.
    "part": wrong(
        (CAMERA, PART),
        (CAMERA, replace(CAMERA, size=PART.size)),
        "centre middle",
        told=(2,),
        times=3,
        error_deg=3,
    ),
    "verticals of image 1": verticals((LEVEL, CAMERA), (CAMERA, CAMERA), told=(1,)),
    "verticals": verticals((LEVEL, LEVEL), (CAMERA, CAMERA)),
    # Two views hardly tell a principal point from two focal lengths.
    "centre in the middle": wrong(
        (NEAR_MIDDLE,) * 2, _one(CAMERA), "centre focal focals assumed", probable=ANY, times=3
    ),
}

exact = partial(Case, found="assumed", probable=PROBABLE, error_deg=0.5)
no_middle = partial(Case, found="assumed focal lens", scene=TURNED)
RIGHT_K = {
    "one": exact(BOTH, _one(CAMERA)),
    "two": exact(UNLIKE, _two(CAMERA, ZOOMED), scene=FAR),
    "lens": exact((BARREL, BARREL), _one(BARREL), scene=NEAR),
    "part": exact((CROP, CROP), _one(CROP)),
    "part, a short way": exact((CROP, CROP), _one(CROP), scene=SHORT),
    "telescope": exact((TELESCOPE,) * 2, (TELESCOPE,) * 2, scene=AWAY),
    "lens without a middle": no_middle((CORNER, CORNER), (CORNER, CORNER)),
    "left of the image": no_middle((LEFT, LEFT), (replace(LEFT, size=None),) * 2),
}

loose = partial(Case, found="assumed")
LOOSE_K = {
    "f too short": loose(BOTH, _one(_unknown(CAMERA, 0.6))),
    "f too long": loose(BOTH, _one(_unknown(CAMERA, 1.7)), scene=FAR),
    "two": loose(
        UNLIKE, (_unknown(CAMERA, 1.3), _unknown(ZOOMED, 1.3)), error_deg=5, spread=(0, 1)
    ),
    "one is exact": loose(UNLIKE, (CAMERA, _unknown(ZOOMED, 1.3)), scene=FAR),
    "lens": loose((BARREL, BARREL), _one(CAMERA, lens_std=0.1), error_deg=0.5),
    "f and lens": loose((BARREL, BARREL), _one(_unknown(CAMERA, 1.1, lens_std=0.1))),
    "f, lens and aspect": loose(
        BOTH, _one(_unknown(CAMERA, 1.1, lens_std=0.1, aspect_std=0.1)), scene=NEAR
    ),
    "aspect": loose((STRETCHED,) * 2, _one(CAMERA, focal_std=0.05, aspect_std=0.05)),
    "axes that meet": loose(
        BOTH,
        _one(_unknown(CAMERA, 1.3)),
        scene=_orbit(6.0) | NOISY,
        error_deg=20,
        spread=(0.1, 0.4),
    ),
    "f of a wide deviation": loose(BOTH, _one(_of_size(1690), focal_std=0.3, lens_std=0.2)),
    "f of a small deviation": loose(
        BOTH, _one(_of_size(1690), focal_std=0.02), found="focal picture", told=(1, 2)
    ),
    "f of other EXIF data": loose(BOTH, _one(_of_size(2470), **EXIF_DATA), told=(1, 2)),
    "f of near EXIF data": loose(BOTH, _one(_of_size(1365), **EXIF_DATA)),
}
GROUPS = {
    "no K": WITHOUT_K,
    "beside a K": BESIDE_K,
    "wrong K": WRONG_K,
    "right K": RIGHT_K,
    "loose K": LOOSE_K,
}
CASES = {f"{g}: {name}": case for g, cases in GROUPS.items() for name, case in cases.items()}


def _told(case: Case, model: str, stated: Camera, fitted: Camera) -> str:
    """What is told of one camera."""
    x, y = fitted.K[:2, 2]
    stated_x, stated_y = stated.K[:2, 2]
    k1 = fitted.distortion.radial[0] if model == "lens" and fitted.distortion else 0.0
    text = SAYS[model].format(
        focal=fitted.focal,
        f=f"f = {fitted.focal:.0f} +- {fitted.focal_std * fitted.focal:.0f} px",
        source="EXIF" if stated.focal_source == "exif" else "K",
        stated=stated.focal,
        aspect=f"{fitted.K[1, 1] / fitted.K[0, 0]:.3f} +- {fitted.aspect_std:.3f}",
        centre=f"({x:.0f}, {y:.0f}) +- {fitted.centre_std:.0f} px",
        cause=case.cause,
        stated_centre=f"({stated_x:.0f}, {stated_y:.0f})",
        k1=f"{k1:.3f} +- {fitted.lens_std:.3f}",
    )
    return f"the matches agree with {text}"


def _warnings(case: Case, model: str, stated: Cameras, fitted: Cameras) -> tuple[str, ...]:
    """A line for both images if it is the same; and of focal lengths that are uncertain."""
    told = {
        number: _told(case, model, stated[number - 1], fitted[number - 1]) for number in case.told
    }
    lines = [f"image {number}: {line}" for number, line in told.items()]
    if len(told) == 2 and told[1] == told[2]:
        lines = [told[1]]
    for number, camera in enumerate(fitted, start=1):
        if camera.focal_std > 0.1 and number not in told:
            within = f"f = {camera.focal:.0f} px within {100 * camera.focal_std:.0f} %"
            lines.append(f"the focal length is uncertain: {within}")
    return tuple(dict.fromkeys(lines))


def _is_honest(pose: RelativePose, scene: TwoViewScene, times: float = 3.0) -> bool:
    """Whether the errors are as stated, of what is a pose."""
    if not pose.success or (pose.probability is not None and pose.probability < 0.5):
        return True
    stated = np.array([pose.rotation_error_90_deg, pose.translation_error_90_deg])
    return bool((np.array(scene.errors_deg(pose)) <= times * stated).all())


def _lens(camera: Camera) -> np.ndarray:
    """Where the lens moves points up to 0.5 from the axis."""
    points = np.linspace(0.05, 0.5, 10)[:, None] * [[0.8, 0.6]]
    return points if camera.distortion is None else camera.distortion.apply(points)


def _assert_near(fitted: Camera, true: Camera) -> None:
    """Each part of the camera is within three deviations of the true one."""
    assert abs(np.log(fitted.focal / true.focal)) <= max(3 * fitted.focal_std, 1e-3)
    ratio = np.log(fitted.K[1, 1] / fitted.K[0, 0]) - np.log(true.K[1, 1] / true.K[0, 0])
    assert abs(ratio) <= 3 * fitted.aspect_std + 1e-9 < 0.15
    offset = np.abs(fitted.K[:2, 2] - true.K[:2, 2])
    assert (offset <= 3 * fitted.centre_std + 1e-6).all()
    np.testing.assert_allclose(_lens(fitted), _lens(true), atol=8e-3)
    assert fitted.lens_std < 0.06
    if true is BARREL:
        assert abs(fitted.distortion.radial[0] + 0.15) < 3 * fitted.lens_std


def _assert_deviations(pose: RelativePose, stated: Cameras, model: str) -> None:
    """They are the roots of the covariance, and none is wider than it was stated."""
    roots = np.sqrt(np.diag(pose.camera_covariance)).reshape(2, 6)
    for root, camera, before in zip(roots, (pose.camera1, pose.camera2), stated, strict=True):
        centre = np.sqrt((root[1:3] ** 2).mean())
        expected = {"focal": root[0], "centre": centre, "lens": root[3], "aspect": root[5]}
        for name, std in expected.items():
            assert getattr(camera, f"{name}_std") == pytest.approx(std, rel=1e-9)
            assert model != "assumed" or std <= getattr(before, f"{name}_std") * (1 + 1e-9)


def test_each_model_is_found_in_a_case() -> None:
    """Each that contradicts a K is the first that a case names."""
    found = [case.found.split() for case in CASES.values()]
    assert {name for names in found for name in names} == MODELS.keys() == {*SAYS, "cylinder"}
    first = {names[0] for names in found if names}
    assert {model.name for model in MODELS.values() if model.contradicts_K} <= first


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_the_camera_that_the_matches_agree_with_is_found_and_told(case: Case) -> None:
    scene = case.views()
    stated = case.cameras(scene)
    pose = scene.estimate(*stated, seed=case.scene.get("seed", 0))
    model = pose.evidence.camera_model
    assert pose.status == case.status
    assert model in case.found.split() or not case.found
    if case.status == "panorama":
        assert pose.R is None and pose.t is None and pose.camera1 is None and not pose.success
        assert "matches fit a cylindrical panorama" in pose.reason
        return
    fitted = pose.camera1, pose.camera2
    told = tuple(line for line in pose.warnings if not line.endswith("cannot be undone"))
    assert told == _warnings(case, model, stated, fitted)
    assert _is_honest(pose, scene, case.times) and max(scene.errors_deg(pose)) < case.error_deg
    least, most = case.probable
    assert least <= pose.probability <= most
    for camera, before, true in zip(fitted, stated, scene.cameras, strict=True):
        if before.exact and (model == "assumed" or None in case.stated):
            assert camera is before
            continue
        assert camera.exact == (model == "swapped")
        assert (camera.focal_source == "matches") == (camera.focal_std > 0)
        if case.near:
            _assert_near(camera, true)
    least, most = case.spread
    assert least <= max(camera.focal_std for camera in fitted) <= most
    if stated[0] is stated[1] and model == "assumed":
        np.testing.assert_array_equal(fitted[0].K, fitted[1].K)
        assert fitted[0].distortion == fitted[1].distortion
    if fitted[0].exact:
        assert model == "swapped" or pose.evidence.camera_agreement > 0.99
    assert (pose.camera_covariance is None) == all(c.exact for c in fitted)
    if pose.camera_covariance is not None:
        _assert_deviations(pose, stated, model)
