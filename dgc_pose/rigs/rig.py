"""The poses of fixed cameras in one frame, from photographs of a walk between them.

The walk becomes a model, each camera is located in it, and one bundle adjustment refines the walk
and the cameras. Without a walk, the cameras' own pictures become the model.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dgc_pose.batch.options import BatchOptions
from dgc_pose.batch.result import Batch
from dgc_pose.batch.run import Progress, run_batch
from dgc_pose.batch.source import BATCH, PairChoice, Source
from dgc_pose.cameras.by_image import Calibration
from dgc_pose.colmap.database import NoPairError
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.colmap.reconstruction import NoModelError, reconstruct, to_metres, write_models
from dgc_pose.estimation import EstimationOptions
from dgc_pose.geometry.rotation import rotation_angle_deg
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.image import load_image, mask_file, masked
from dgc_pose.localization.locate import Locator
from dgc_pose.localization.location import Location
from dgc_pose.matchers import MatcherOptions
from dgc_pose.model import Model
from dgc_pose.rigs.adjustment import WALK, adjusted, extended, in_metres, in_model_of_batch
from dgc_pose.rigs.inputs import PICTURES, Photographs, RigInputs, RigOptions, rig_inputs
from dgc_pose.system.colmap_library import pycolmap

if TYPE_CHECKING:
    from dgc_pose.pose import CameraSource

_SIMILAR = 6  # each photograph of the walk is paired with this number of similar ones
_LEAST_AGREEING = 2  # pictures of the model that must agree with a location


@dataclass(frozen=True, eq=False)
class Rig:
    """Fixed cameras in one frame.

    Attributes:
        cameras: By camera name, the pose in the frame of the rig, or why the camera has none.
        model: The walk and the placed cameras with 3D points; None if no camera is placed.
        metric: The unit, the frame and the error of the scale; empty up to scale.
        warnings: Sentences for the user.
    """

    cameras: Mapping[str, Location]
    model: Model | None = None
    metric: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def placed(self) -> dict[str, Location]:
        """The cameras with a pose, by name."""
        return {name: of for name, of in self.cameras.items() if of.success}


def estimate_rig(
    frames: str | Path,
    out: str | Path,
    walk: str | Path | Model | None = None,
    *,
    K: Mapping[str, CameraSource] | None = None,
    walk_K: str = "auto",
    matcher: MatcherOptions | None = None,
    estimation: EstimationOptions | None = None,
    reconstruction: ReconstructionOptions | None = None,
    work: BatchOptions | None = None,
    progress: Progress = lambda stage, done, of: None,
) -> Rig:
    """Estimate the poses cam_from_world of fixed cameras in one frame: x = R X + t.

    frames: folder with an entry for each camera, which names the camera: an image, a video, or a
    folder of frames. Parts that move between frames are not matched. out: folder for the model and
    the cameras' pictures. walk: photographs taken between the cameras: a folder, a video, or a
    finished model, which is not changed; None if the cameras' views overlap. K: by camera name, as
    for `estimate_relative_pose`; the focal length and lens of all others are estimated. walk_K: of
    the walk, a text as for --K. reconstruction: includes the options for metres. progress: called
    with the stage, the number done, and the total.

    A camera whose picture is unusable has the status "bad_input"; without a model, all others have
    "nowhere". Raises InputError for an unusable K or scale, and for an existing result without
    `resume` in `work`; ImageError; OSError.
    """
    options = RigOptions(
        matcher or MatcherOptions(),
        estimation or EstimationOptions(),
        reconstruction or ReconstructionOptions(),
        work or BatchOptions(),
    )
    between = Path(walk) if isinstance(walk, str) else walk
    inputs = rig_inputs(Path(frames), Path(out), between, K or {}, walk_K, options)
    if not inputs.pictures:
        return Rig(inputs.unusable, warnings=inputs.warnings)
    made = _made_models(inputs, progress)
    return _placed_rig(inputs, made, progress)


@dataclass(frozen=True, eq=False)
class _MadeModels:
    """The models that the cameras are located in."""

    models: Sequence[Model]  # the largest first; may be none
    batch: Batch | None  # that they are made of; None for a finished model
    are_own: bool = False  # whether their images are the cameras' pictures
    why_none: str = ""


def _made_models(inputs: RigInputs, progress: Progress) -> _MadeModels:
    """The finished model, or the models of the walk or of the cameras' own pictures."""
    if isinstance(inputs.walk, Model):
        return _MadeModels([inputs.walk], None)
    estimation = inputs.options.estimation
    options = replace(inputs.options.reconstruction, gps=False, scale=None, marker=None)
    pairs = PairChoice("exhaustive")
    if inputs.walk is None:
        photographs = _own_photographs(inputs)
        options = replace(options, min_images=2, refine_centres=False)
    else:
        photographs = inputs.walk
        options = replace(options, refine_centres=True)
        if len(photographs.source.names) > _SIMILAR + 1:
            pairs = PairChoice("auto", _SIMILAR)
        if estimation.effort == "auto":  # corners are aligned at full resolution later
            estimation = replace(estimation, effort="fast")
    batch = run_batch(
        photographs.source,
        photographs.calibration,
        pairs,
        inputs.out / BATCH,
        matcher=inputs.options.matcher,
        estimation=estimation,
        options=inputs.options.work,
        progress=progress,
    )
    are_own = photographs is not inputs.walk
    try:
        models, *_ = reconstruct(batch, inputs.out, options)
    except (NoModelError, NoPairError) as error:
        why = f"the walk makes no model: {error}"
        if are_own:
            why = "the cameras' own pictures make no model; photographs between them would"
        return _MadeModels([], batch, are_own, why)
    return _MadeModels(models, batch, are_own)


def _own_photographs(inputs: RigInputs) -> Photographs:
    """The cameras' pictures as photographs of a model."""
    names = tuple(sorted(picture.name for picture in inputs.pictures.values()))
    source = Source(inputs.out / PICTURES, names, None, {}, masks=inputs.masks)
    exact = {
        picture.name: inputs.exact[name]
        for name, picture in inputs.pictures.items()
        if name in inputs.exact
    }
    return Photographs(source, Calibration("K", exact, auto="two"))


def _placed_rig(inputs: RigInputs, made: _MadeModels, progress: Progress) -> Rig:
    """The cameras placed in a model, adjusted with it, in metres, and written with it."""
    warnings = inputs.warnings
    if made.batch is not None:
        bad = made.batch.summary["bad_images"]
        warnings += tuple(f"{name}: {why}" for name, why in bad.items())
    if not made.models:
        nowhere = Location("nowhere", made.why_none, ())
        cameras = dict.fromkeys(inputs.pictures, nowhere)
        return Rig({**cameras, **inputs.unusable}, warnings=warnings)
    matcher = inputs.options.matcher.load(ImageCache())
    masks = inputs.masks if made.are_own else None
    estimation = inputs.options.estimation
    locators = [Locator(model, matcher, estimation, masks) for model in made.models]
    model, cameras = _located(locators, inputs, progress, own=made.are_own)
    warnings += tuple(why for locator in locators for why in locator.bad.values())
    walked = sum(name.startswith(WALK) for name in inputs.images)
    if len(model.poses) < walked:
        warnings += (f"{len(model.poses)} of {walked} photographs of the walk are in its model",)
    if made.are_own:
        assert made.batch is not None
        files = {name: picture.name for name, picture in inputs.pictures.items()}
        cameras = in_model_of_batch(cameras, files, model, made.batch)
    placed = {name: location for name, location in cameras.items() if location.success}
    if not placed:
        return Rig({**cameras, **inputs.unusable}, warnings=warnings)

    if made.are_own:
        assert model.colmap is not None  # of `reconstruct`
        whole = model.colmap
        by_file = {image.name: image.image_id for image in whole.images.values()}
        ids = {name: by_file[inputs.pictures[name].name] for name in placed}
    elif made.batch is None:
        whole, ids = extended(model, placed, inputs.pictures)
    else:
        whole, ids, placed = adjusted(model, placed, inputs.pictures)
    before = _spread(whole)
    metric = to_metres(whole, inputs.images, inputs.options.reconstruction, inputs.known)
    scale = _spread(whole) / before
    poses = {name: whole.images[ids[name]].cam_from_world().matrix() for name in placed}
    placed = {name: in_metres(placed[name], poses[name], scale) for name in placed}
    model = _written(whole, inputs.images, inputs.out)
    warnings += (*metric.pop("warnings", ()), *_same_poses(placed))
    return Rig({**cameras, **placed, **inputs.unusable}, model, metric, warnings)


def _located(
    locators: Sequence[Locator], inputs: RigInputs, progress: Progress, *, own: bool
) -> tuple[Model, dict[str, Location]]:
    """The model in which most cameras are located, and the locations in it. For a camera located
    only in another model, the reason states it. own: whether the models contain the pictures."""
    each = list[dict[str, Location]]()
    for locator in locators:
        each.append({})
        for name, picture in inputs.pictures.items():
            itself = [picture.name] if own else []
            image = masked(load_image(picture), mask_file(inputs.masks, picture.name))
            location = locator.locate(image, inputs.exact.get(name), excluded=itself, whole=True)
            each[-1][name] = _checked(location, name, locator)
            progress("cameras", sum(map(len, each)), len(locators) * len(inputs.pictures))
    best = int(np.argmax([sum(of.success for of in located.values()) for located in each]))
    cameras = dict(each[best])
    for located in each:
        for name, of in located.items():
            if of.success and not cameras[name].success:
                why = "located in another model of the walk: take pictures that connect the two"
                cameras[name] = replace(cameras[name], reason=why)
    return locators[best].model, cameras


def _checked(location: Location, name: str, locator: Locator) -> Location:
    """The location if enough pictures of the model agree; otherwise "nowhere", with the reason and
    the most similar picture."""
    matched, reason = location.database_images, location.reason
    if location.success:
        agreeing = sum(image.agrees for image in matched)
        usable = len(locator.model.poses) - len(locator.bad)
        if agreeing >= min(_LEAST_AGREEING, usable - 1):
            return location
        reason = f"its pose agrees with {agreeing} of {len(matched)} pictures"
    if matched:
        reason += f"; pictures between {name} and {matched[0].name} would connect it"
    return Location("nowhere", reason, matched, warnings=location.warnings)


def _spread(whole: pycolmap.Reconstruction) -> float:
    """The root of the summed squared distances of the images' centres from their mean."""
    centres = np.array([i.projection_center() for i in whole.images.values() if i.has_pose])
    return float(np.linalg.norm(centres - centres.mean(0)))


def _written(whole: pycolmap.Reconstruction, paths: Mapping[str, Path], out: Path) -> Model:
    """Write COLMAP's model and the points, and read the model. Image names become relative to a
    folder that contains all images."""
    every = {name: os.path.abspath(path) for name, path in paths.items()}
    root = os.path.commonpath([os.path.dirname(path) for path in every.values()])
    for image in whole.images.values():
        if image.name in every:
            image.name = Path(os.path.relpath(every[image.name], root)).as_posix()
    (model,) = write_models(out, [whole], Path(root))
    return model


def _same_poses(cameras: Mapping[str, Location]) -> tuple[str, ...]:
    """A warning for each pair of cameras whose poses differ by less than their expected errors."""
    warnings = []
    for (name1, one), (name2, two) in combinations(cameras.items(), 2):
        assert one.R is not None and two.R is not None and one.centre is not None
        angle = rotation_angle_deg(one.R @ two.R.T)
        apart = float(np.linalg.norm(one.centre - two.centre))
        turn, shift = (
            sum(getattr(of, error) or 0.0 for of in (one, two))
            for error in ("rotation_error_90_deg", "position_error_90")
        )
        if angle < turn and apart < shift:
            differ = f"{angle:.2g} degrees and {apart:.2g} apart"
            warnings.append(f"{name1} and {name2} have the same pose: they are {differ}")
    return tuple(warnings)
