"""What a rig is estimated from. What can be refused is refused here, before the matching."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dgc_pose.batch.options import BatchOptions
from dgc_pose.batch.source import BATCH, PAGE, Source, open_source
from dgc_pose.cameras.by_image import Calibration
from dgc_pose.cameras.calibration import image_camera, read_calibration
from dgc_pose.cameras.camera import Camera, colmap_camera
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.colmap.reconstruction import MODEL, POINTS, KnownMetres, known_metres, require_new
from dgc_pose.errors import ArgumentName, ImageError, InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.images.folder import frames_folder
from dgc_pose.images.image import load_image
from dgc_pose.matchers import MatcherOptions
from dgc_pose.model import Model
from dgc_pose.rigs.adjustment import WALK
from dgc_pose.rigs.files import FILES
from dgc_pose.rigs.frames import CameraFrames, StillPictures, camera_frames, still_pictures
from dgc_pose.system.files import replaced_folder

if TYPE_CHECKING:
    from dgc_pose.pose import CameraSource

# Folders in that of a rig: for the cameras' pictures and masks, and for the frames of videos
_OWN = "rig_pictures"
PICTURES = f"{_OWN}/cameras"
_MASKS = f"{_OWN}/masks"
_FRAMES = f"{_OWN}/frames"
_WALK_OF = f"{_OWN}/walk_of_"
_WALK_FRAMES = 20  # taken from a video


@dataclass(frozen=True)
class RigOptions:
    """The options of each step of a rig."""

    matcher: MatcherOptions
    estimation: EstimationOptions
    reconstruction: ReconstructionOptions  # includes those for metres
    work: BatchOptions


@dataclass(frozen=True, eq=False)
class Photographs:
    """Photographs that a model is made of, and what is stated of their cameras."""

    source: Source
    calibration: Calibration


@dataclass(frozen=True, eq=False)
class FixedCameras:
    """The cameras of a rig, by name."""

    pictures: Mapping[str, Path]  # upright and still, of the usable cameras; all in one folder
    masks: Path  # folder of the pictures' masks, see `mask_file`
    exact: Mapping[str, Camera]  # the given cameras
    unusable: Mapping[str, str]  # why the other cameras have no picture
    warnings: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class RigInputs:
    """What a rig is estimated from, after everything that can be refused before the matching."""

    out: Path
    walk: Photographs | Model | None  # between the cameras; None: the cameras share views
    cameras: FixedCameras
    images: Mapping[str, Path]  # of the walk and the cameras, by their names in the final model
    known: KnownMetres  # by the same names
    options: RigOptions


def require_new_rig(
    frames: Path, out: Path, walk: str | Path | Model | None, *, resume: bool
) -> None:
    """Raise InputError if `out` has a rig and `resume` is False, or files that are not part of a
    model where the model is written; and if an input overlaps the pictures that are written."""
    require_new(out, (BATCH, MODEL, POINTS, PAGE, *FILES), resume=resume)
    inner = (out / _OWN).resolve()
    inputs = {"frames": frames}
    if isinstance(walk, str | Path):
        inputs["walk"] = Path(walk)
    for argument, path in inputs.items():
        outer = path.resolve()
        if outer in inner.parents or inner in (outer, *outer.parents):
            neither = f"{path} overlaps the results in {out}"
            raise InputError(ArgumentName(argument), neither)


def walk_photographs(
    walk: str | Path | Model | None, walk_K: str, out: Path
) -> Photographs | Model | None:
    """The photographs of the walk, which may be the frames of a video. walk_K: a text as for --K.
    Raises InputError if they are unusable; OSError."""
    if walk is None or isinstance(walk, Model):
        return walk
    path = Path(walk)
    source = open_source(frames_folder(path, _WALK_FRAMES, out / f"{_WALK_OF}{path.name}"))
    return Photographs(source, read_calibration(walk_K, "walk_K"))


def fixed_cameras(
    frames: Path,
    out: Path,
    walk: str | Path | Model | None,
    K: Mapping[str, CameraSource],
    options: ReconstructionOptions,
) -> FixedCameras:
    """The cameras in the folder `frames`, with their pictures in `out`. walk: is no camera, if it
    is in `frames`.

    Raises InputError for what `camera_frames` refuses; for a K of no camera, or one that does not
    fit its camera; and if the option `scale` names others than two usable cameras; OSError.
    """
    walk_paths = [Path(walk)] if isinstance(walk, str | Path) else []
    found = camera_frames(frames, out / _FRAMES, walk_paths)
    exact = _exact_cameras(K, found)
    if options.scale:
        known_metres({name: frames / name for name in found.frames}, options)
    (out / _OWN).mkdir(parents=True, exist_ok=True)
    with replaced_folder(out / PICTURES) as folder, replaced_folder(out / _MASKS) as masks:
        stills = still_pictures(found, folder, masks)
        if options.scale:
            _require_scaled(stills, options.scale)
    pictures = {name: out / PICTURES / path.name for name, path in stills.pictures.items()}
    warnings = (*found.skipped, *stills.lines)
    return FixedCameras(pictures, out / _MASKS, exact, stills.bad, warnings)


def _exact_cameras(K: Mapping[str, CameraSource], found: CameraFrames) -> dict[str, Camera]:
    """The cameras with a given K, by name."""
    if unknown := sorted({*K} - {*found.frames}):
        names = ", ".join(found.frames)
        raise InputError(ArgumentName("K"), f"is of {unknown[0]}, and the cameras are {names}")
    exact = {}
    for name, value in K.items():
        for path in found.frames[name]:
            with suppress(ImageError):
                exact[name] = image_camera(value, load_image(path), f"K of {name}")
                colmap_camera(exact[name], name)  # raises for a skew
                break
    return exact


def _require_scaled(stills: StillPictures, scale: str) -> None:
    """Raise InputError if the option `scale` names a camera whose picture cannot be used."""
    for name in scale.split(",")[:2]:
        if name in stills.bad:
            unusable = f"names {name}, whose picture cannot be used: {stills.bad[name]}"
            raise InputError(ArgumentName("scale"), unusable)


def images_in_model(cameras: FixedCameras, walk: Photographs | Model | None) -> dict[str, Path]:
    """The images of the walk and the pictures of the cameras, by their names in the final model."""
    images: dict[str, Path] = {}
    if isinstance(walk, Model):
        images = {WALK + name: walk.root / name for name in walk.poses}
    elif walk is not None:
        images = {WALK + name: walk.source.root / name for name in walk.source.names}
    return images | {picture.name: picture for picture in cameras.pictures.values()}


def metres_of(
    cameras: FixedCameras, images: Mapping[str, Path], options: ReconstructionOptions
) -> KnownMetres:
    """What `known_metres` finds in the images, by name; `scale` names cameras. Raises as it
    does."""
    if not options.scale:
        return known_metres(images, options)
    by_camera, frame = known_metres(cameras.pictures, options)
    return {cameras.pictures[name].name: metres for name, metres in by_camera.items()}, frame
