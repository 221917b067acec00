"""The cameras that two images may have: one table of models.

A model changes the cameras as they are stated, or assumed without a K, and has prior log-odds
against them; its row has all of it. docs/architecture.md states how to add one. An assumed camera
has a lens of two radial coefficients, square pixels and its principal point near the middle, the
same in all of its images. `model_comparison` fits the models.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import camera_changes as changes
from dgc_pose.estimation import camera_texts as texts
from dgc_pose.estimation import stated_changes
from dgc_pose.estimation.camera_changes import Cameras, Change, Variant

ModelName = str  # of a row of `MODELS`
# Shares of the matches that the assumed cameras explain, above which no distant cameras are
# searched: without a K; with a K, and for models that are less likely than the third, in log-odds.
EXPLAINED = 0.8
EXPLAINED_BY_K = 0.5
_UNLIKELY = -10.0
_UNCERTAIN_STD = 0.1  # deviation of ln f beyond which there is a warning


@dataclass(frozen=True)
class CameraModel:
    """A row of the table, all that is to be stated of a model."""

    name: ModelName
    change: Change
    # What the matches agree with: of a camera before and after the fit; "" for nothing unusual.
    text: Callable[[Camera, Camera], str]
    log_odds: float  # prior, against the cameras that are stated or assumed
    # In docs/method.md: what the model opens or changes, and its odds; {} stands for `log_odds`.
    opens: str = ""
    odds: str = "{}"
    contradicts_K: bool = False
    # Changes of ln f at which RANSAC runs, for a model that the pose of the assumed cameras does
    # not lead to; and whether it may be far from unusual cameras that explain the matches.
    focals: tuple[float, ...] = ()
    is_far: bool = False

    def variants(self, stated: Cameras) -> Iterator[Variant]:
        """The cameras of the model before their fit; none if it leaves the stated ones as they
        are."""
        return self.change(stated, self.log_odds)

    def is_searched(self, log_odds: float, *, explained: float, usual: bool) -> bool:
        """Whether the model is fitted whatever its estimate.

        log_odds: of the variant. explained: the share of the matches that the assumed cameras
        explain. usual: whether these are usual.
        """
        if self.name == "tail":
            return True
        least = EXPLAINED_BY_K if self.contradicts_K or log_odds < _UNLIKELY else EXPLAINED
        is_explained = explained > least
        if self.is_far:
            return not (is_explained and usual)
        return bool(self.focals) and not is_explained


def model_named(name: str) -> CameraModel:
    """The model of this name."""
    return MODELS[name]


def other_models(stated: Cameras) -> Iterator[tuple[CameraModel, Variant]]:
    """The models other than the cameras as stated or assumed."""
    for model in MODELS.values():
        for variant in model.variants(stated):
            yield model, variant


def with_model(camera: Camera, name: str) -> Camera:
    """The camera of a folder before the fit, by another model; unchanged if it does not apply."""
    variant = next(model_named(name).variants((camera, camera)), None)
    return camera if variant is None else variant.cameras[0]


def _texts(name: str, stated: Cameras, fitted: Cameras) -> list[str]:
    text = model_named(name).text
    return [text(before, camera) for before, camera in zip(stated, fitted, strict=True)]


def unusual_cameras(name: str, stated: Cameras, fitted: Cameras) -> tuple[str, ...]:
    """What the matches agree with instead of what is stated, a line for each of unlike cameras.
    stated: before the fit."""
    first, second = _texts(name, stated, fitted)
    if first == second:
        return (f"the matches agree with {first}",) if first else ()
    numbered = (("image 1", first), ("image 2", second))
    return tuple(f"{image}: the matches agree with {line}" for image, line in numbered if line)


def camera_warnings(name: str, stated: Cameras, fitted: Cameras) -> tuple[str, ...]:
    """Warnings about unusual or uncertain fitted cameras, a line each. stated: before the fit."""
    lines = dict.fromkeys(unusual_cameras(name, stated, fitted))
    for camera, text in zip(fitted, _texts(name, stated, fitted), strict=True):
        if camera.focal_std > _UNCERTAIN_STD and not text:
            within = f"f = {camera.focal:.0f} px within {100 * camera.focal_std:.0f} %"
            lines[f"the focal length is uncertain: {within}"] = None
    return tuple(lines)


def _if_open(text: Callable[[Camera], str]) -> Callable[[Camera, Camera], str]:
    """A text of a camera without a K."""
    return lambda before, camera: text(camera) if changes.is_open(before) else ""


def _lens(before: Camera, camera: Camera) -> str:
    """Of a lens that K does not state."""
    if camera.distortion is None or not camera.lens_std:
        return ""
    states = "none" if before.distortion is None else before.distortion.model
    k1 = f"k1 = {camera.distortion.radial[0]:.3f} +- {camera.lens_std:.3f}"
    return f"a lens of {k1}, and K states {states}"


def _unlensed(before: Camera, camera: Camera) -> str:
    """Of no lens where K states one."""
    return "" if before.distortion is None else f"no lens, and K states {before.distortion.model}"


def odds_text(log_odds: float) -> str:
    """As docs/method.md states prior odds."""
    return f"e^{log_odds:g}"


_WIDE_FOCALS = (-0.42, -0.14, 0.14, 0.42)
_ODDS_OF_CUT = odds_text(stated_changes.LOG_ODDS_OF_CUT)
_ODDS_WITHOUT_K = (
    f"{{}}; with EXIF data {odds_text(changes.LOG_ODDS_OF_EXIF)}; "
    f"{odds_text(changes.LOG_ODDS_OF_SHAPE)} if the picture has no sensor's shape"
)
MODELS: Mapping[str, CameraModel] = {
    model.name: model
    for model in (
        CameraModel("assumed", changes.nothing, texts.focal_of_prior, log_odds=0.0),
        # Without a K.
        CameraModel(
            "tail",
            changes.tail,
            texts.focal_of_prior,
            log_odds=0.0,
            opens="f, in the less likely part of the prior",
            odds="from the prior and the lines",
            focals=(-0.6, 0.0, 0.6),
        ),
        CameraModel(
            "two",
            changes.two,
            _if_open(
                lambda camera: (
                    f"a different focal length for each image, {texts.focal_text(camera)}"
                )
            ),
            log_odds=changes.LOG_ODDS_OF_TWO,
            opens="f of each image; with the same EXIF data, f of one image, in the less likely "
            "part of its prior",
            odds=f"{{}}, with EXIF data {odds_text(changes.LOG_ODDS_OF_TWO_WITH_EXIF)}; and from "
            "the priors",
            is_far=True,
        ),
        CameraModel(
            "squeezed",
            changes.squeezed,
            _if_open(texts.squeezed),
            log_odds=-7.0,
            opens="fy / fx, within 30 %; not where EXIF data are whole",
            odds=_ODDS_WITHOUT_K,
        ),
        CameraModel(
            "off_centre",
            changes.off_centre,
            _if_open(texts.off_centre),
            log_odds=-7.0,
            opens="the principal point of each image, within 2 % of the longer side; not where "
            "EXIF data are whole",
            odds=_ODDS_WITHOUT_K,
        ),
        CameraModel(
            "fisheye",
            changes.fisheye,
            _if_open(lambda camera: f"a fisheye, f = {camera.focal:.0f} px"),
            log_odds=-6.0,
            opens="an equidistant projection, f = 0.55 of the longer side within 35 % (or EXIF), "
            "two coefficients",
            odds=_ODDS_WITHOUT_K,
            focals=_WIDE_FOCALS,
        ),
        CameraModel(
            "cylinder",
            changes.cylinder,
            lambda before, camera: "",  # the status is panorama
            log_odds=-6.0,
            opens="a cylinder about y, f = 0.6 of the longer side within 40 % (or EXIF)",
            odds=_ODDS_WITHOUT_K,
            focals=_WIDE_FOCALS,
        ),
        # In place of a K.
        CameraModel(
            "focal",
            stated_changes.focal,
            texts.focal,
            log_odds=-5.5,
            opens="in place of a K: one factor of both focal lengths, within 50 %",
            contradicts_K=True,
        ),
        CameraModel(
            "focals",
            stated_changes.focals,
            texts.focal,
            log_odds=-8.0,
            opens="the same, a factor of each",
            contradicts_K=True,
        ),
        CameraModel(
            "lens",
            stated_changes.lens,
            _lens,
            log_odds=-5.5,
            opens="in place of a K: the first coefficient of the lens, within 0.15",
            contradicts_K=True,
        ),
        CameraModel(
            "centre",
            stated_changes.centre,
            texts.centre,
            log_odds=-11.0,
            opens="in place of a K: the principal point, within 5 % of the longer side; or of one "
            "image or both within 10 %, with f within 20 % (corrected verticals, a shift lens); or "
            "within 20 % of the middle, if K is over 4 % off the middle, in the middle half of "
            "the image",
            odds=f"{{}}; the last {_ODDS_OF_CUT}",
            contradicts_K=True,
        ),
        CameraModel(
            "unlensed",
            stated_changes.unlensed,
            _unlensed,
            log_odds=-9.0,
            opens="in place of a K: no lens",
            contradicts_K=True,
            focals=(0.0,),
        ),
        CameraModel(
            "middle",
            stated_changes.middle,
            texts.centre,
            log_odds=-10.0,
            opens="in place of a K: the principal point in the middle, with f within 20 %",
            odds=f"{{}}; {_ODDS_OF_CUT} where `centre` has it",
            contradicts_K=True,
            focals=(0.0,),
        ),
        CameraModel(
            "swapped",
            stated_changes.swapped,
            lambda before, camera: f"f = {camera.focal:.0f} px, as the K of the other image",
            log_odds=-12.0,
            opens="in place of two K: each image has the other's K",
            contradicts_K=True,
            focals=(0.0,),
        ),
        CameraModel(
            "picture",
            stated_changes.picture,
            lambda before, camera: (
                f"{texts.focal_text(camera)}, as without K, and K states {before.focal:.0f}"
            ),
            log_odds=-9.0,
            opens="in place of a K: the camera as without K",
            odds="{} times the improbability of K",
            contradicts_K=True,
            focals=(-0.7, -0.35, 0.0, 0.35, 0.7),
            is_far=True,
        ),
    )
}
