"""`dgc-pose rig`: the poses of fixed cameras in one frame."""

from __future__ import annotations

import os
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dgc_pose.batch.options import BatchOptions
from dgc_pose.cli.batch import OUT
from dgc_pose.cli.estimate import NO_POSE
from dgc_pose.cli.options import dataclass_options
from dgc_pose.cli.process import name_bad_images, progress_bars, to_stderr
from dgc_pose.colmap.options import ReconstructionOptions
from dgc_pose.errors import ArgumentName, InputError, printable
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions
from dgc_pose.system.options import option

if TYPE_CHECKING:
    from dgc_pose.cameras.by_image import Calibration
    from dgc_pose.cameras.camera import Camera
    from dgc_pose.rigs.rig import Rig


@dataclass(frozen=True, kw_only=True)
class RigChoice:
    """The options of a rig: the walk, the known cameras, and the options of each step."""

    walk: str | None = option(
        None, "Photographs between the cameras: a folder or a video.", metavar="SOURCE"
    )
    model: Path | None = option(None, "A model in place of the walk.", metavar="SOURCE")
    images: Path | None = option(None, "Folder of the model's images.", metavar="FOLDER")
    start: Path | None = option(
        None, "An older calibration: which cameras have moved since.", metavar="FILE"
    )
    k: tuple[str, ...] = option(
        (),
        "Camera NAME, as --K of estimate; or a file that names cameras. Repeat it.",
        flag="--K",
        metavar="NAME=K|FILE",
        section="cameras",
    )
    walk_k: str = option(
        "auto", "Camera of the walk.", flag="--walk-K", metavar="K|FILE|auto", section="cameras"
    )
    work: BatchOptions
    matcher: MatcherOptions
    estimation: EstimationOptions
    reconstruction: ReconstructionOptions


@click.command()
@click.argument("frames", metavar="FRAMES", type=click.Path(path_type=Path))
@OUT
@dataclass_options(RigChoice, "choice")
def rig(frames: Path, out: Path, choice: RigChoice) -> int:
    """Place fixed cameras in one frame.

    FRAMES is a folder with an entry for each camera: an image, a video, or a folder of frames. The
    entry's name is the camera's name. --walk gives photographs taken between the cameras, some of
    which must share views with each camera. Without --walk, the cameras must share views.

    Writes calibration.toml (anipose, Pose2Sim), camera_array.toml (caliscope), rig_config.json
    (COLMAP), stereo.yml (OpenCV, for two cameras), rig.json with the expected errors, sparse/
    (COLMAP model of walk and cameras), points.ply and model.html. A camera whose picture cannot be
    used is named and not placed. Exits with 3 if no camera could be placed, with 2 if the rig stays
    up to scale in spite of --gps, --scale or --marker.
    """
    from dgc_pose.batch.source import PAGE
    from dgc_pose.cameras.formats.recognise import read_file
    from dgc_pose.colmap.reconstruction import MappingError
    from dgc_pose.model import load_model
    from dgc_pose.rigs.files import FILES, RIG, compared, write_rig
    from dgc_pose.rigs.inputs import PICTURES
    from dgc_pose.rigs.rig import estimate_rig
    from dgc_pose.system.files import require_no_input, write_text
    from dgc_pose.viz.model_page import model_page

    walk = choice.walk
    if (choice.model is None) != (choice.images is None) or (walk and choice.model):
        raise InputError(ArgumentName("model"), "needs --images, and no --walk")
    before = None if choice.start is None else read_file(choice.start)
    if before is not None and not before.poses:
        raise InputError(ArgumentName("start"), f"{choice.start} has no poses of cameras")
    names = _names(frames)
    if before is not None and choice.start is not None:
        require_no_input([out / name for name in FILES], [choice.start])
        if names and len(names & before.poses.keys()) < 2:
            these = f"two of {', '.join(sorted(names))} are needed"
            known_ones = ", ".join(before.poses)
            raise InputError(ArgumentName("start"), f"has the poses of {known_ones}, and {these}")
    stated = [camera for text in choice.k for camera in _stated(text, frames)]
    known = dict(stated)
    if len(known) < len(stated):
        raise InputError(ArgumentName("K"), "states a camera twice")
    with progress_bars() as progress:
        found = estimate_rig(
            frames,
            out,
            load_model(choice.model, choice.images) if choice.model and choice.images else walk,
            K=known,
            walk_K=choice.walk_k,
            matcher=choice.matcher,
            estimation=choice.estimation,
            reconstruction=choice.reconstruction,
            work=choice.work,
            progress=progress,
        )
    unit = found.metric.get("unit", "")
    bad = {
        name: location.reason
        for name, location in found.cameras.items()
        if location.status == "bad_input"
    }
    name_bad_images(bad, found.cameras)
    click.echo(rig_text(found))
    warnings = list(found.warnings)
    if found.not_in_metres is not None:
        warnings.append(f"not in metres: {found.not_in_metres}")
    for path in write_rig(out, found.cameras, found.metric, warnings):
        click.echo(str(path))
    if found.model is None:
        return NO_POSE
    write_text(out / PAGE, model_page(found.model, unit, cameras=out / PICTURES))
    click.echo(f"{out / PAGE}: cameras with their pictures, and points, for a browser")
    if before is not None:
        try:
            for change in compared(before.poses, found.placed, before.by_name):
                click.echo(change.text(unit))
        except InputError as error:  # the rig itself is written
            to_stderr(f"warning: {error}")
    if found.not_in_metres is not None:
        hint = ArgumentName("resume"), "with another scale keeps the matches:"
        raise MappingError(out / RIG, "is up to scale, and", *hint, *found.not_in_metres.args)
    return 0


def _names(frames: Path) -> set[str]:
    from dgc_pose.rigs.frames import camera_name

    return {*map(camera_name, frames.iterdir())} if frames.is_dir() else set()


def _stated(text: str, frames: Path) -> Sequence[tuple[str, str | Camera]]:
    """The cameras of an option --K, each with its name and K. From a file, only cameras that are in
    FRAMES."""
    from dgc_pose.cameras.formats.recognise import read_file

    names = _names(frames)
    name, equals, K = text.partition("=")
    for longer in names:  # a name may contain =
        if text.startswith(f"{longer}=") and len(longer) > len(name):
            name = longer
            K = text.removeprefix(f"{longer}=")
    if equals and not os.path.lexists(text):
        return [(unicodedata.normalize("NFC", name), K)]
    file: Calibration = read_file(Path(text))
    cameras = file.parts or file.by_name
    stated = [(name, camera) for name, camera in cameras.items() if name in names]
    if not stated:
        raise InputError(
            ArgumentName("K"), f"{text} names no camera of {frames}: NAME=K states one"
        )
    return stated


def rig_text(found: Rig) -> str:
    """A rig for people: a line for each camera."""
    from dgc_pose.cli.output import row_lines
    from dgc_pose.estimation.status import percent_text

    unit = found.metric.get("unit", "")
    lines = []
    for name, location in found.cameras.items():
        if location.centre is None or location.camera is None:
            lines.append(f"{name}: not placed: {location.reason}")
            continue
        likely = (
            ""
            if location.probability is None
            else f", probability {percent_text(location.probability)}"
        )
        centre = (
            f"{row_lines(location.centre)[0]} +- {location.position_error_90:.2g} {unit}".rstrip()
        )
        focal = f"f = {location.camera.focal:.1f} px"
        turn = f"R +- {location.rotation_error_90_deg:.2f} deg"
        lines.append(f"{name}: centre {centre}, {turn}, {focal}{likely}")
    own = [
        f"{name}: {text}" for name, location in found.cameras.items() for text in location.warnings
    ]
    lines += [f"warning: {warning}" for warning in (*found.warnings, *own)]
    lines += [f"{fact.replace('_', ' ')}: {value}" for fact, value in found.metric.items()]
    return "\n".join(map(printable, lines))
