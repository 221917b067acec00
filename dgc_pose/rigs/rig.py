"""The poses of fixed cameras in one frame, from photographs of a walk between them.

The walk becomes a model, each camera is located in it, and one bundle adjustment refines the walk
and the cameras. Without a walk, the cameras' own pictures become the model.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dgc_pose.batch.options import BatchOptions
from dgc_pose.batch.run import Progress, run_batch
from dgc_pose.batch.source import BATCH, PAGE, PairChoice, Source, open_source
from dgc_pose.cameras.by_image import Calibration
from dgc_pose.cameras.calibration import image_camera, read_calibration
from dgc_pose.cameras.camera import Camera, colmap_camera
from dgc_pose.colmap.database import NoPairError
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.colmap.reconstruction import (
    MODEL,
    POINTS,
    NoModelError,
    known_metres,
    reconstruct,
    require_new,
    to_metres,
    write_models,
)
from dgc_pose.errors import ArgumentName, ImageError, InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.geometry.rotation import rotation_angle_deg
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.folder import frames_folder
from dgc_pose.images.image import load_image
from dgc_pose.localization.locate import Locator
from dgc_pose.localization.location import Location
from dgc_pose.matchers import MatcherOptions
from dgc_pose.model import Model
from dgc_pose.rigs.adjustment import WALK, adjusted, extended, in_metres, in_model_of_batch
from dgc_pose.rigs.files import FILES
from dgc_pose.rigs.frames import camera_frames, still_pictures
from dgc_pose.system.colmap_library import pycolmap
from dgc_pose.system.files import replaced_folder

if TYPE_CHECKING:
    from dgc_pose.pose import CameraSource

# Folders in that of a rig: for the cameras' pictures and masks, and for the frames of videos
_OWN = "rig_pictures"
PICTURES, _CAMERAS, _WALK_OF = f"{_OWN}/cameras", f"{_OWN}/frames", f"{_OWN}/walk_of_"
_WALK_FRAMES = 20  # taken from a video
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
    frames, out, work = Path(frames), Path(out), work or BatchOptions()
    estimation, matcher = estimation or EstimationOptions(), matcher or MatcherOptions()
    options = reconstruction or ReconstructionOptions()
    walk = Path(walk) if isinstance(walk, str) else walk
    given = {"frames": frames} | ({"walk": walk} if isinstance(walk, Path) else {})
    require_new(out, (BATCH, MODEL, POINTS, PAGE, *FILES), resume=work.resume)
    for argument, path in given.items():
        inner, outer = (out / _OWN).resolve(), path.resolve()
        if outer in inner.parents or inner in (outer, *outer.parents):
            neither = f"{path} overlaps the results in {out}"
            raise InputError(ArgumentName(argument), neither)
    found, unreadable, skipped = camera_frames(frames, out / _CAMERAS, [*given.values()])
    exact = _exact_cameras(K or {}, found)
    walked = dict[str, Path]()
    if isinstance(walk, Model):
        skipped = (*skipped, *walk.warnings)
        walked = {name: walk.root / name for name in walk.poses}
    elif walk is not None:
        source = open_source(frames_folder(walk, _WALK_FRAMES, out / f"{_WALK_OF}{walk.name}"))
        skipped += source.skipped
        walked = {name: source.root / name for name in source.names}
        calibration = read_calibration(walk_K, "walk_K")
    if options.scale or options.gps:  # raise before the matching
        first = {name: next(iter(paths), frames / name) for name, paths in found.items()}
        known_metres(first if options.scale else walked or first, options)

    for file in (*FILES, PAGE):  # of an earlier run
        (out / file).unlink(missing_ok=True)
    (out / _OWN).mkdir(parents=True, exist_ok=True)
    with replaced_folder(out / PICTURES) as folder:
        stills, bad, lines = still_pictures(found, unreadable, folder)
    files = {name: path.name for name, path in stills.items()}
    skipped += lines
    unusable = {name: Location("bad_input", why, ()) for name, why in bad.items()}
    pictures = {name: out / PICTURES / file for name, file in files.items()}
    if options.scale:
        *pair, metres = options.scale.split(",")
        for name in sorted(bad.keys() & {*pair}):
            unusable_picture = f"names {name}, whose picture cannot be used: {bad[name]}"
            raise InputError(ArgumentName("scale"), unusable_picture)
        options = replace(options, scale=",".join([*(files[name] for name in pair), metres]))
    if not pictures:
        return Rig(unusable, warnings=skipped)
    if isinstance(walk, Model):
        models = [walk]
    else:
        pairs, fast = PairChoice("exhaustive"), estimation
        up_to_scale = replace(options, gps=False, scale=None, marker=None)
        if walk is None:
            names = tuple(sorted(files.values()))
            source = Source(out / PICTURES, names, None, {}, masks=out / PICTURES)
            by_file = {files[name]: camera for name, camera in exact.items() if name in files}
            calibration = Calibration("K", by_file, auto="two")
            up_to_scale = replace(up_to_scale, min_images=2, refine_centres=False)
        else:
            if len(source.names) > _SIMILAR + 1:
                pairs = PairChoice("auto", _SIMILAR)
            if estimation.effort == "auto":  # corners are aligned at full resolution later
                fast = replace(estimation, effort="fast")
            up_to_scale = replace(up_to_scale, refine_centres=True)
        batch = run_batch(
            *(source, calibration, pairs, out / BATCH),
            matcher=matcher,
            estimation=fast,
            options=work,
            progress=progress,
        )
        skipped += tuple(f"{name}: {why}" for name, why in batch.summary["bad_images"].items())
        try:
            models, *_ = reconstruct(batch, out, up_to_scale)
        except (NoModelError, NoPairError) as error:
            reason = "the cameras' own pictures make no model; photographs between them would"
            if walk is not None:
                reason = f"the walk makes no model: {error}"
            none = {name: Location("nowhere", reason, ()) for name in pictures}
            return Rig(none | unusable, warnings=skipped)

    loaded = matcher.load(ImageCache())
    locators = [Locator(of_model, loaded, estimation, out / PICTURES) for of_model in models]
    model, cameras = _located(locators, pictures, exact, progress, own=walk is None)
    skipped += tuple(why for locator in locators for why in locator.bad.values())
    if (count := len(model.poses)) < len(walked):
        skipped += (f"{count} of {len(walked)} photographs of the walk are in its model",)
    if walk is None:
        cameras = in_model_of_batch(cameras, files, model, batch)
    placed = {name: of for name, of in cameras.items() if of.success}
    if not placed:
        return Rig(cameras | unusable, warnings=skipped)

    if walk is None:
        assert model.colmap is not None  # of `reconstruct`
        whole = model.colmap
        by_name = {image.name: image.image_id for image in whole.images.values()}
        ids = {name: by_name[files[name]] for name in placed}
    elif isinstance(walk, Model):
        whole, ids = extended(model, placed, pictures)
    else:
        whole, ids, placed = adjusted(model, placed, pictures)
    paths = {WALK + name: path for name, path in walked.items()}
    paths |= {file: out / PICTURES / file for file in files.values()}
    before = _spread(whole)
    metric = to_metres(whole, paths, options)
    scale = _spread(whole) / before
    poses = {name: whole.images[ids[name]].cam_from_world().matrix() for name in placed}
    placed = {name: in_metres(of, poses[name], scale) for name, of in placed.items()}
    model = _written(whole, paths, out)
    warnings = (*skipped, *metric.pop("warnings", ()), *_same_poses(placed))
    return Rig({**cameras, **placed, **unusable}, model, metric, warnings)


def _exact_cameras(
    K: Mapping[str, CameraSource], found: Mapping[str, Sequence[Path]]
) -> dict[str, Camera]:
    """The cameras with a given K, by name. found: the frames of each camera."""
    if unknown := sorted({*K} - {*found}):
        names = ", ".join(found)
        raise InputError(ArgumentName("K"), f"is of {unknown[0]}, and the cameras are {names}")
    exact = {}
    for name, value in K.items():
        for path in found[name]:
            with suppress(ImageError):
                exact[name] = image_camera(value, load_image(path), f"K of {name}")
                colmap_camera(exact[name], name)  # raises for a skew
                break
    return exact


def _located(
    locators: Sequence[Locator],
    pictures: Mapping[str, Path],
    exact: Mapping[str, Camera],
    progress: Progress,
    *,
    own: bool,
) -> tuple[Model, dict[str, Location]]:
    """The model in which most cameras are located, and the locations in it. For a camera located
    only in another model, the reason states it. own: whether the models contain the pictures."""
    each = list[dict[str, Location]]()
    for locator in locators:
        each.append({})
        for name, picture in pictures.items():
            itself = [picture.name] if own else []
            location = locator.locate(picture, exact.get(name), excluded=itself, whole=True)
            each[-1][name] = _checked(location, name, locator)
            progress("cameras", sum(map(len, each)), len(locators) * len(pictures))
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
