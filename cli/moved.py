"""`dgc-pose moved`: whether a fixed camera has moved since a reference picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dgc_pose.cli.guard import STDOUT
from dgc_pose.cli.options import KChoice, dataclass_options, output_file
from dgc_pose.cli.process import name_bad_images, progress_bars, to_stderr
from dgc_pose.errors import ImageError, InputError, printable
from dgc_pose.matchers import MatcherOptions
from dgc_pose.system.files import save_text, scratch_folder, staged
from dgc_pose.system.options import option
from dgc_pose.system.texts import aligned, json_text

if TYPE_CHECKING:
    from dgc_pose.motion import CameraMotion

# Exit codes
MOVED = 1
CANNOT_SAY = 3
PERCENT = 100.0
CHANGED = {"moved", "zoomed"}  # verdicts
_COLUMNS = (
    "picture",
    "verdict",
    "middle (px)",
    "worst (px)",
    "zoom (%)",
    "angle (deg)",
    "shift (% of depth)",
)


@dataclass(frozen=True)
class Watch:
    """The frames of a video and the file to write."""

    frames: int = option(40, "Frames taken of a video.", metavar="N", min=1, max=10**6)
    json: str | None = output_file(
        "Write the motions as JSON, by picture; - for stdout.", "PATH|-", stdout=True
    )


@click.command()
@click.argument("reference", metavar="REFERENCE", type=click.Path())
@click.argument("now", metavar="NOW...", nargs=-1, required=True, type=click.Path())
@dataclass_options(KChoice, "cameras")
@dataclass_options(MatcherOptions, "matcher")
@dataclass_options(Watch, "watch")
def moved(
    reference: str, now: Sequence[str], cameras: KChoice, matcher: MatcherOptions, watch: Watch
) -> int:
    """Tell whether a fixed camera has moved since the picture REFERENCE.

    NOW are later pictures of the same camera: files, folders, or videos. Prints for each picture
    the verdict; how far the picture moves at its middle and at its worst place; the zoom; the angle
    of the rotation, and the shift over the median depth of the scene. Errors after +- hold in nine
    cases of ten. A picture that moves by less than 0.05 degrees is `still`, also if it is larger or
    smaller by less than 2 %, as by a focus that breathes; from 2 % on it is `zoomed`. Without --K,
    the focal length is assumed.

    Exits with 0 if all pictures are still, 1 if one has moved or zoomed, 3 if none has and one
    verdict is `cannot say`. A picture that cannot be read is named and has the verdict `cannot
    say`; if none can be read, exits with 2. An unexpected error also exits with 1; its line begins
    with error.
    """
    from dgc_pose.cameras.calibration import read_calibration
    from dgc_pose.images.image import load_image, require_matchable
    from dgc_pose.motion import CameraMotion, FixedCamera

    json_file = None if watch.json == STDOUT else watch.json
    motions: dict[str, CameraMotion] = {}
    with staged(json_file) as stage, scratch_folder() as scratch, progress_bars() as progress:
        read_calibration(cameras.k or "auto", "--K", cameras.details)  # an error names the option
        first = load_image(reference)
        require_matchable(first)
        fixed = FixedCamera(first, cameras.k, matcher=matcher.load(), details=cameras.details)
        pictures: dict[str, Path | str] = {}
        bad: dict[str, str] = {}
        for number, source in enumerate(now):
            pictures |= _pictures(source, watch.frames, scratch / str(number))
        for name, file in pictures.items():
            try:
                if isinstance(file, str):
                    raise ImageError(file)
                motions[name] = fixed.motion(replace(load_image(file), name=name))
            except ImageError as error:  # go on with the other pictures
                bad[name] = str(error)
                motions[name] = CameraMotion("cannot say", bad[name])
            except InputError as error:  # of this picture, which can be read
                motions[name] = CameraMotion("cannot say", str(error))
            progress("pictures", len(motions), len(pictures))
        data = json_text({name: motion.to_dict() for name, motion in motions.items()})
        if json_file is not None:
            save_text(stage(json_file), data)
    if watch.json == STDOUT:
        click.echo(data, nl=False)
    name_bad_images(bad, pictures)
    for warning in fixed.camera.warnings:
        to_stderr(f"warning: {warning}")
    if watch.json != STDOUT:
        click.echo(motions_text(motions))
    verdicts = {motion.verdict for motion in motions.values()}
    if verdicts & CHANGED:
        return MOVED
    return CANNOT_SAY if "cannot say" in verdicts else 0


def _pictures(source: str, frames: int, folder: Path) -> dict[str, Path | str]:
    """The pictures of a file, folder or video by name: the file, or why it cannot be read. folder:
    receives the frames of a video."""
    from dgc_pose.images.folder import frames_folder, search_images

    try:
        path = frames_folder(Path(source), frames, folder)
        if not path.is_dir():
            return {source: path}
        found = search_images(path)
    except InputError as error:
        return {source: str(error)}
    except OSError as error:
        return {source: error.strerror or str(error)}
    for line in found.skipped:
        to_stderr(f"warning: {line}")
    entries: dict[str, Path | str] = {name: path / name for name in found.names}
    entries |= found.bad
    if not entries:
        return {source: "no image is in this folder"}
    return {(Path(source) / name).as_posix(): entries[name] for name in sorted(entries)}


def motions_text(motions: dict[str, CameraMotion]) -> str:
    """A table of the motions for people, and the first picture that has moved or zoomed."""
    rows = [tuple(_COLUMNS)]
    for name, motion in motions.items():
        cells = (
            _cell(motion.middle_px, motion.middle_error_90_px, 2),
            _cell(motion.worst_px, motion.worst_error_90_px, 2),
            _cell(motion.zoom, motion.zoom_error_90, 2, PERCENT),
            _cell(motion.angle_deg, motion.angle_error_90_deg, 3),
            _cell(motion.shift, motion.shift_error_90, 2, PERCENT),
        )
        rows.append((printable(name), motion.verdict, *cells))
    reasons = ["", *(motion.reason for motion in motions.values())]
    lines = map("{}  {}".format, aligned(rows).splitlines(), reasons)
    unsure = sum(motion.verdict == "cannot say" for motion in motions.values())
    last = f"no verdict on {unsure} of {len(motions)}" if unsure else "none has moved"
    for name, motion in motions.items():
        if motion.verdict in CHANGED:
            last = f"the first that has {motion.verdict}: {printable(name)}"
            break
    return "\n".join([*(line.rstrip() for line in lines), last])


def _cell(value: float | None, error: float | None, digits: int, scale: float = 1.0) -> str:
    """A value with its error, times `scale`; - if it is not known."""
    if value is None or error is None:
        return "-"
    return f"{scale * value:.{digits}f} +- {scale * error:.{digits}f}"
