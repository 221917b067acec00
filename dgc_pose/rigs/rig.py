"""The poses of fixed cameras in one frame, from photographs of a walk between them.

The walk becomes a model, each camera is located in it, and one bundle adjustment refines the walk
and the cameras. Without a walk, the cameras' own pictures become the model.
"""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dgc_pose.batch.options import BatchOptions
from dgc_pose.batch.result import Batch
from dgc_pose.batch.run import Progress, run_batch
from dgc_pose.batch.source import BATCH, PAGE, PairChoice, Source
from dgc_pose.cameras.by_image import Calibration
from dgc_pose.cameras.camera import colmap_camera
from dgc_pose.colmap.database import NoPairError
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.colmap.reconstruction import (
    MODEL,
    POINTS,
    MappingError,
    NoModelError,
    mapped,
    to_metres,
    write_models,
)
from dgc_pose.errors import ArgumentName, DgcPoseError, InputError, shortened
from dgc_pose.estimation import EstimationOptions
from dgc_pose.geometry.rotation import rotation_angle_deg
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.image import load_image, mask_file, masked
from dgc_pose.localization.locate import Locator
from dgc_pose.localization.location import Location
from dgc_pose.matchers import MatcherOptions
from dgc_pose.model import Model, upright_model
from dgc_pose.rigs.adjustment import WALK, adjusted, adjusted_own, extended, in_metres
from dgc_pose.rigs.files import FILES
from dgc_pose.rigs.inputs import (
    FixedCameras,
    Photographs,
    RigInputs,
    RigOptions,
    fixed_cameras,
    images_in_model,
    metres_of,
    require_new_rig,
    walk_photographs,
)
from dgc_pose.system.colmap_library import pycolmap
from dgc_pose.system.files import only_writer

if TYPE_CHECKING:
    from dgc_pose.pose import CameraSource

_SIMILAR = 6  # each photograph of the walk is paired with this number of similar ones
_MATCHED = 6  # pictures of the model with each camera; more hardly change the adjustment
_LEAST_AGREEING = 2  # pictures of the model that must agree with a location


@dataclass(frozen=True, eq=False)
class Rig:
    """Fixed cameras in one frame.

    Attributes:
        cameras: By camera name, the pose in the frame of the rig, or why the camera has none.
        model: The walk and the placed cameras with 3D points; None if no camera is placed.
        metric: The unit, the frame and the error of the scale; empty up to scale.
        warnings: Sentences for the user.
        not_in_metres: The error for which the rig is up to scale in spite of an option for metres.
    """

    cameras: Mapping[str, Location]
    model: Model | None = None
    metric: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    not_in_metres: DgcPoseError | None = None

    @property
    def placed(self) -> dict[str, Location]:
        """The cameras with a pose, by name."""
        return {name: place for name, place in self.cameras.items() if place.success}


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
    folder of frames. Frames in another position than most, and parts that move between frames, are
    not matched. out: folder for the model and the cameras' pictures. walk: photographs taken
    between the cameras: a folder, a video, or a finished model, which is not changed; None if the
    cameras' views overlap. K: by camera name, as for `estimate_relative_pose`; the focal length and
    lens of all others are estimated. walk_K: of the walk, a text as for --K. reconstruction:
    includes the options for metres. progress: called with the stage, the number done, and the
    total.

    A camera whose picture is unusable has the status "bad_input"; without a model, all others have
    "nowhere". Metres that the located cameras do not determine leave the rig up to scale, see
    `Rig.not_in_metres`. Raises InputError, before the matching, for an unusable K or scale, for
    cameras with one name or picture, for a marker or positions that the images lack, and for an
    existing result without `resume` in `work`; ImageError; OSError.
    """
    out = Path(out)
    options = RigOptions(
        matcher or MatcherOptions(),
        estimation or EstimationOptions(),
        reconstruction or ReconstructionOptions(),
        work or BatchOptions(),
    )
    require_new_rig(Path(frames), out, walk, resume=options.work.resume)
    between = walk_photographs(walk, walk_K, out)
    cameras = fixed_cameras(Path(frames), out, walk, K or {}, options.reconstruction)
    images = images_in_model(cameras, between)
    known = metres_of(cameras, images, options.reconstruction)
    inputs = RigInputs(out, between, cameras, images, known, options)
    made = _made_models(inputs, progress)
    return _placed_rig(inputs, made, progress)


@dataclass(frozen=True, eq=False)
class _MadeModels:
    models: Sequence[Model]  # the largest first
    batch: Batch | None = None  # that they are made of; None for a finished model
    are_own: bool = False  # whether their images are the cameras' pictures
    why_none: str = ""
    warnings: tuple[str, ...] = ()


def _made_models(inputs: RigInputs, progress: Progress) -> _MadeModels:
    """The finished model, or the models of the walk or of the cameras' own pictures."""
    if not inputs.cameras.pictures:
        return _MadeModels([])
    walk = inputs.walk
    if isinstance(walk, Model):
        return _MadeModels([walk], warnings=walk.warnings)
    estimation = inputs.options.estimation
    pairs = PairChoice("exhaustive")
    if walk is None:
        photographs = _own_photographs(inputs.cameras)
        mapping = replace(inputs.options.reconstruction, min_images=2, refine_centres=False)
        no_model = "the cameras' own pictures make no model"
        hint = "; photographs between them would"
    else:
        photographs = walk
        mapping = replace(inputs.options.reconstruction, refine_centres=True)
        no_model = "the walk makes no model"
        hint = ""
        if len(walk.source.names) > _SIMILAR + 1:
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
    bad = batch.summary["bad_images"]
    warnings = (*photographs.source.skipped, *(f"{name}: {why}" for name, why in bad.items()))
    try:
        with only_writer(inputs.out):
            found, _ = mapped(batch, inputs.out, mapping)
    except (NoModelError, NoPairError):
        why_none = f"{no_model} ({_pairs_text(batch)}){hint}"
        return _MadeModels([], batch, walk is None, why_none, warnings)
    models = [upright_model(model, batch.plan.root) for model in found]
    return _MadeModels(models, batch, walk is None, warnings=warnings)


def _pairs_text(batch: Batch) -> str:
    """How many pairs have a pose, and the statuses of the others, the most frequent first."""
    posed = sum(row.success for row in batch.rows)
    others = Counter(row.status for row in batch.rows if not row.success)
    counts = [f"{count} {status}" for status, count in others.most_common()]
    return ", ".join([f"{posed} of {len(batch.rows)} pairs have a pose", *counts])


def _remove_results(out: Path) -> None:
    """Remove the results of an earlier run, which `require_new_rig` allowed to replace."""
    for file in (*FILES, PAGE, POINTS):
        (out / file).unlink(missing_ok=True)
    if (out / MODEL).exists():
        shutil.rmtree(out / MODEL)


def _own_photographs(cameras: FixedCameras) -> Photographs:
    """The cameras' pictures as photographs of a model."""
    files = {name: picture.name for name, picture in cameras.pictures.items()}
    exact = {files[name]: camera for name, camera in cameras.exact.items() if name in files}
    root = next(iter(cameras.pictures.values())).parent
    source = Source(root, tuple(sorted(files.values())), None, {}, masks=cameras.masks)
    return Photographs(source, Calibration("K", exact, auto="two"))


def _placed_rig(inputs: RigInputs, made: _MadeModels, progress: Progress) -> Rig:
    """The cameras placed in a model, adjusted with it, in metres, and written with it."""
    _remove_results(inputs.out)
    located = _located(inputs, made, progress)
    unusable = inputs.cameras.unusable.items()
    cameras = located.cameras | {name: Location("bad_input", why, ()) for name, why in unusable}
    placed = {name: location for name, location in cameras.items() if location.success}
    warnings = (*inputs.cameras.warnings, *made.warnings, *located.warnings)
    if located.model is None or not placed:
        return Rig(cameras, warnings=warnings)

    whole, ids, placed = _adjusted(inputs, made, located.model, placed)
    before = _spread(whole)
    metric: dict[str, Any] = {}
    not_in_metres: DgcPoseError | None = None
    try:
        _require_scaled_placed(inputs.options.reconstruction.scale, placed)
        metric = to_metres(whole, inputs.images, inputs.options.reconstruction, inputs.known)
    except (MappingError, InputError) as error:
        not_in_metres = error
    scale = _spread(whole) / before
    for name, location in placed.items():
        pose = whole.images[ids[name]].cam_from_world().matrix()
        placed[name] = in_metres(location, pose, scale)
    model = _in_one_folder(whole, inputs.images)
    write_models(inputs.out, [model])
    warnings += (*metric.pop("warnings", ()), *_same_poses(placed, metric.get("unit", "")))
    return Rig(cameras | placed, model, metric, warnings, not_in_metres)


@dataclass(frozen=True, eq=False)
class _Located:
    """The cameras in the model that places most of them."""

    cameras: dict[str, Location]  # by name
    model: Model | None = None  # None: there is no model
    warnings: tuple[str, ...] = ()


def _located(inputs: RigInputs, made: _MadeModels, progress: Progress) -> _Located:
    """The cameras located in each model. For a camera located only in another model than the best,
    the reason states it."""
    pictures = inputs.cameras.pictures
    if not made.models:
        return _Located(dict.fromkeys(pictures, Location("nowhere", made.why_none, ())))
    matcher = inputs.options.matcher.load(ImageCache())
    masks = inputs.cameras.masks if made.are_own else None
    locators = [Locator(model, matcher, inputs.options.estimation, masks) for model in made.models]
    each = list[dict[str, Location]]()
    for locator in locators:
        each.append({})
        for name, picture in pictures.items():
            image = masked(load_image(picture), mask_file(inputs.cameras.masks, picture.name))
            itself = [picture.name] if made.are_own else []
            K = inputs.cameras.exact.get(name)
            location = locator.locate(image, K, excluded=itself, whole=True, most=_MATCHED)
            each[-1][name] = _checked(location, name, locator)
            progress("cameras", sum(map(len, each)), len(locators) * len(pictures))
        if all(location.success for location in each[-1].values()):
            break  # no further model places more
    counts = [sum(location.success for location in found.values()) for found in each]
    best = int(np.argmax(counts))
    cameras = dict(each[best])
    for found in each:
        for name, location in found.items():
            if location.success and not cameras[name].success:
                why = "located in another model of the walk: take pictures that connect the two"
                cameras[name] = replace(cameras[name], reason=why)
    model = made.models[best]
    warnings = [why for locator in locators for why in locator.bad.values()]
    walked = [name.removeprefix(WALK) for name in inputs.images if name.startswith(WALK)]
    if missing := [name for name in walked if name not in model.poses]:
        count = f"{len(missing)} of {len(walked)} photographs of the walk are not in its model"
        warnings.append(f"{count}: {shortened(', '.join(missing))}")
    if made.are_own:
        cameras = _in_own_model(cameras, {n: pictures[n].name in model.poses for n in cameras})
    return _Located(cameras, model, tuple(warnings))


def _in_own_model(
    cameras: Mapping[str, Location], in_model: Mapping[str, bool]
) -> dict[str, Location]:
    """The locations in the model of the cameras' own pictures: those of at least two cameras that
    are in the model."""
    found = dict(cameras)
    for name, location in cameras.items():
        if location.success and not in_model[name]:
            reason = "it has a pose, and COLMAP did not take it into the model"
            found[name] = Location("nowhere", reason, location.database_images)
    placed = [name for name, location in found.items() if location.success]
    if len(placed) == 1:
        reason = "no other camera has a place, and photographs between them would give one"
        found[placed[0]] = Location("nowhere", reason, found[placed[0]].database_images)
    return found


def _checked(location: Location, name: str, locator: Locator) -> Location:
    """The location if enough pictures of the model agree; otherwise "nowhere", with the reason and
    the most similar picture."""
    matched = location.database_images
    reason = location.reason
    if location.success:
        agreeing = sum(image.agrees for image in matched)
        usable = len(locator.model.poses) - len(locator.bad)
        if agreeing < min(_LEAST_AGREEING, usable - 1):
            reason = f"its pose agrees with {agreeing} of {len(matched)} pictures"
        elif location.camera is not None:
            try:
                colmap_camera(location.camera, name)
            except InputError as error:  # as a cylinder
                return Location("nowhere", str(error), matched, warnings=location.warnings)
            return location
    if matched:
        reason += f"; pictures between {name} and {matched[0].name} would connect it"
    return Location("nowhere", reason, matched, warnings=location.warnings)


def _adjusted(
    inputs: RigInputs, made: _MadeModels, model: Model, placed: dict[str, Location]
) -> tuple[pycolmap.Reconstruction, dict[str, int], dict[str, Location]]:
    """COLMAP's form of the model with the placed cameras, their image ids, and their locations
    after the adjustment; a finished model stays as it is."""
    pictures = inputs.cameras.pictures
    if made.batch is None:
        return *extended(model, placed, pictures), placed
    adjust = adjusted_own if made.are_own else adjusted
    return adjust(model, placed, pictures, made.batch.plan.cameras)


def _require_scaled_placed(scale: str | None, placed: Mapping[str, Location]) -> None:
    """Raise InputError if the option `scale` names a camera without a place."""
    for name in scale.split(",")[:2] if scale else ():
        if name not in placed:
            raise InputError(ArgumentName("scale"), f"names {name}, which has no place")


def _spread(whole: pycolmap.Reconstruction) -> float:
    """The root of the summed squared distances of the images' centres from their mean."""
    centres = np.array([i.projection_center() for i in whole.images.values() if i.has_pose])
    return float(np.linalg.norm(centres - centres.mean(0)))


def _in_one_folder(whole: pycolmap.Reconstruction, images: Mapping[str, Path]) -> Model:
    """The model of images by their names relative to a folder that contains all of them. images:
    by their names before, the files."""
    paths = {name: os.path.abspath(path) for name, path in images.items()}
    root = os.path.commonpath([os.path.dirname(path) for path in paths.values()])
    for image in whole.images.values():
        if image.name in paths:
            image.name = Path(os.path.relpath(paths[image.name], root)).as_posix()
    return upright_model(whole, Path(root))


def _same_poses(cameras: Mapping[str, Location], unit: str) -> tuple[str, ...]:
    """A warning for each pair of cameras whose poses differ by less than their expected errors.
    cameras: located, by name. unit: of length, or "" up to scale."""
    warnings = []
    for (name1, one), (name2, two) in combinations(cameras.items(), 2):
        assert one.R is not None and two.R is not None and one.centre is not None
        angle = rotation_angle_deg(one.R @ two.R.T)
        apart = float(np.linalg.norm(one.centre - two.centre))
        turn, shift = (
            sum(getattr(location, error) or 0.0 for location in (one, two))
            for error in ("rotation_error_90_deg", "position_error_90")
        )
        if angle < turn and apart < shift:
            distance = f"{apart:.2g} {unit}".rstrip()
            differ = f"{angle:.2g} degrees and {distance} apart"
            warnings.append(f"{name1} and {name2} have the same pose: they are {differ}")
    return tuple(warnings)
