"""The cameras that two images may have: one table of models.

A model changes the cameras as they are stated, or assumed without a K, and has prior log-odds
against them. An assumed camera has a lens of two radial coefficients, square pixels and its
principal point near the middle, the same in all of its images. `model_comparison` fits the models.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from dgc_pose.cameras.camera import Camera
from dgc_pose.estimation import camera_changes as changes
from dgc_pose.estimation import camera_texts as texts
from dgc_pose.estimation import stated_changes
from dgc_pose.estimation.camera_changes import Cameras, Variant

ModelName = Literal[
    "assumed",
    "tail",
    "two",
    "squeezed",
    "off_centre",
    "fisheye",
    "cylinder",
    "focal",
    "focals",
    "lens",
    "centre",
    "unlensed",
    "middle",
    "swapped",
    "picture",
]
# Shares of the matches that the assumed cameras explain, above which no distant cameras are
# searched: without a K; with a K, and for models that are less likely than the third, in log-odds.
EXPLAINED = 0.8
EXPLAINED_BY_K = 0.5
_UNLIKELY = -10.0
_UNCERTAIN_STD = 0.1  # deviation of ln f beyond which there is a warning


@dataclass(frozen=True)
class CameraModel:
    """A row of the table."""

    name: ModelName
    # The variants for stated or assumed cameras; none that leaves them as they are.
    variants: Callable[[Cameras], Iterator[Variant]]
    # What the matches agree with: of a camera before and after the fit; "" for nothing unusual.
    says: Callable[[Camera, Camera], str]
    contradicts_K: bool = False
    # Changes of ln f at which RANSAC runs, for a model that the pose of the assumed cameras does
    # not lead to; and whether it may be far from unusual cameras that explain the matches.
    focals: tuple[float, ...] = ()
    is_far: bool = False

    def is_searched(self, log_odds: float, *, explained: float, usual: bool) -> bool:
        """Whether the model is fitted whatever its estimate.

        log_odds: prior. explained: the share of the matches that the assumed cameras explain.
        usual: whether these are usual.
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
    return _MODELS[name]


def other_models(stated: Cameras) -> Iterator[tuple[CameraModel, Variant]]:
    """The models other than the cameras as stated or assumed."""
    for model in _MODELS.values():
        for variant in model.variants(stated):
            yield model, variant


def with_model(camera: Camera, name: str) -> Camera:
    """The camera of a folder before the fit, by another model; unchanged if it does not apply."""
    variant = next(model_named(name).variants((camera, camera)), None)
    return camera if variant is None else variant.cameras[0]


def _said(name: str, stated: Cameras, fitted: Cameras) -> list[str]:
    says = model_named(name).says
    return [says(before, camera) for before, camera in zip(stated, fitted, strict=True)]


def unusual_cameras(name: str, stated: Cameras, fitted: Cameras) -> tuple[str, ...]:
    """What the matches agree with instead of what is stated, a line for each of unlike cameras.
    stated: before the fit."""
    first, second = _said(name, stated, fitted)
    if first == second:
        return (f"the matches agree with {first}",) if first else ()
    numbered = (("image 1", first), ("image 2", second))
    return tuple(f"{image}: the matches agree with {line}" for image, line in numbered if line)


def camera_warnings(name: str, stated: Cameras, fitted: Cameras) -> tuple[str, ...]:
    """Warnings about unusual or uncertain fitted cameras, a line each. stated: before the fit."""
    lines = dict.fromkeys(unusual_cameras(name, stated, fitted))
    for camera, said in zip(fitted, _said(name, stated, fitted), strict=True):
        if camera.focal_std > _UNCERTAIN_STD and not said:
            within = f"f = {camera.focal:.0f} px within {100 * camera.focal_std:.0f} %"
            lines[f"the focal length is uncertain: {within}"] = None
    return tuple(lines)


def _if_open(text: Callable[[Camera], str]) -> Callable[[Camera, Camera], str]:
    """A text of a camera without a K."""
    return lambda before, camera: text(camera) if changes.is_open(before) else ""


def _nothing(before: Camera, camera: Camera) -> str:
    return ""


_WIDE_FOCALS = (-0.42, -0.14, 0.14, 0.42)
_MODELS: Mapping[str, CameraModel] = {
    model.name: model
    for model in (
        CameraModel("assumed", changes.nothing, texts.focal_of_prior),
        # Without a K.
        CameraModel("tail", changes.tail, texts.focal_of_prior, focals=(-0.6, 0.0, 0.6)),
        CameraModel("two", changes.two, _if_open(texts.two), is_far=True),
        CameraModel("squeezed", changes.squeezed, _if_open(texts.squeezed)),
        CameraModel("off_centre", changes.off_centre, _if_open(texts.off_centre)),
        CameraModel("fisheye", changes.fisheye, _if_open(texts.fisheye), focals=_WIDE_FOCALS),
        CameraModel("cylinder", changes.cylinder, _nothing, focals=_WIDE_FOCALS),
        # In place of a K.
        CameraModel("focal", stated_changes.focal, texts.focal, True),
        CameraModel("focals", stated_changes.focals, texts.focal, True),
        CameraModel("lens", stated_changes.lens, texts.lens, True),
        CameraModel("centre", stated_changes.centre, texts.centre, True),
        CameraModel("unlensed", stated_changes.unlensed, texts.unlensed, True, focals=(0.0,)),
        CameraModel("middle", stated_changes.middle, texts.centre, True, focals=(0.0,)),
        CameraModel("swapped", stated_changes.swapped, texts.swapped, True, focals=(0.0,)),
        CameraModel(
            "picture",
            stated_changes.picture,
            texts.picture,
            True,
            focals=(-0.7, -0.35, 0.0, 0.35, 0.7),
            is_far=True,
        ),
    )
}
