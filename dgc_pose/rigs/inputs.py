"""What a rig is estimated from. What can be refused is refused here, before the matching."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
from dgc_pose.localization.location import Location
from dgc_pose.matchers import MatcherOptions
from dgc_pose.model import Model
from dgc_pose.rigs.adjustment import WALK
from dgc_pose.rigs.files import FILES
from dgc_pose.rigs.frames import StillPictures, camera_frames, still_pictures
from dgc_pose.system.files import replaced_folder

if TYPE_CHECKING:
    from dgc_pose.pose import CameraSource

# Folders in that of a rig: for the cameras' pictures and masks, and for the frames of videos
_OWN = "rig_pictures"
PICTURES = f"{_OWN}/cameras"
_CAMERAS = f"{_OWN}/frames"
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
class RigInputs:
    """What a rig is estimated from, after everything that can be refused."""

    out: Path
    pictures: Mapping[str, Path]  # upright and still, by camera name; of the usable cameras
    unusable: Mapping[str, Location]  # the other cameras: "bad_input", with the reason
    exact: Mapping[str, Camera]  # the cameras with a given K, by camera name
    walk: Photographs | Model | None  # between the cameras; None: they share views
    images: Mapping[str, Path]  # of the walk and of the cameras, by their names in the final model
    known: KnownMetres  # by the same names
    options: RigOptions
    warnings: tuple[str, ...]

    @property
    def masks(self) -> Path:
        """Folder of the masks of the cameras' pictures, see `mask_file`."""
        return self.out / PICTURES


def rig_inputs(
    frames: Path,
    out: Path,
    walk: Path | Model | None,
    K: Mapping[str, CameraSource],
    walk_K: str,
    options: RigOptions,
) -> RigInputs:
    """Check the arguments of `estimate_rig` and write the cameras' still pictures.

    Raises what `estimate_rig` raises. Removes the results of an earlier run, if nothing is refused.
    """
    require_new(out, (BATCH, MODEL, POINTS, PAGE, *FILES), resume=options.work.resume)
    places = {"frames": frames} | ({"walk": walk} if isinstance(walk, Path) else {})
    _require_apart(out, places)
    found = camera_frames(frames, out / _CAMERAS, places.values())
    exact = _exact_cameras(K, found.frames)
    walk_images: dict[str, Path] = {}
    between: Photographs | Model | None = None
    warnings = found.skipped
    if isinstance(walk, Model):
        between = walk
        walk_images = {WALK + name: walk.root / name for name in walk.poses}
        warnings += walk.warnings
    elif walk is not None:
        source = open_source(frames_folder(walk, _WALK_FRAMES, out / f"{_WALK_OF}{walk.name}"))
        between = Photographs(source, read_calibration(walk_K, "walk_K"))
        walk_images = {WALK + name: source.root / name for name in source.names}
        warnings += source.skipped
    if options.reconstruction.scale:  # names cameras: raises before anything is written
        known_metres({name: frames / name for name in found.frames}, options.reconstruction)

    (out / _OWN).mkdir(parents=True, exist_ok=True)
    with replaced_folder(out / PICTURES) as folder:
        stills = still_pictures(found, folder)
        known = _known_metres(stills, walk_images, options.reconstruction)
    for file in (*FILES, PAGE):  # of an earlier run
        (out / file).unlink(missing_ok=True)
    pictures = {name: out / PICTURES / path.name for name, path in stills.pictures.items()}
    return RigInputs(
        out,
        pictures,
        {name: Location("bad_input", why, ()) for name, why in stills.bad.items()},
        exact,
        between,
        walk_images | {path.name: path for path in pictures.values()},
        known,
        options,
        (*warnings, *stills.lines),
    )


def _require_apart(out: Path, places: Mapping[str, Path]) -> None:
    """Raise InputError if an input, by argument, overlaps the pictures that are written."""
    inner = (out / _OWN).resolve()
    for argument, path in places.items():
        outer = path.resolve()
        if outer in inner.parents or inner in (outer, *outer.parents):
            neither = f"{path} overlaps the results in {out}"
            raise InputError(ArgumentName(argument), neither)


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


def _known_metres(
    stills: StillPictures, walk_images: Mapping[str, Path], options: ReconstructionOptions
) -> KnownMetres:
    """What `known_metres` finds in the images, by their names in the final model. Raises as it
    does; InputError if `scale` names a camera whose picture cannot be used."""
    if not options.scale:
        cameras = {path.name: path for path in stills.pictures.values()}
        return known_metres({**walk_images, **cameras}, options)
    named = {**stills.pictures, **dict.fromkeys(stills.bad, Path())}
    by_camera, frame = known_metres(named, options)
    for name in sorted(by_camera.keys() & stills.bad.keys()):
        unusable = f"names {name}, whose picture cannot be used: {stills.bad[name]}"
        raise InputError(ArgumentName("scale"), unusable)
    return {stills.pictures[name].name: metres for name, metres in by_camera.items()}, frame
