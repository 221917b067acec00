"""`dgc-pose batch`: the poses and matches of many pairs, from a folder, a list or a database."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dgc_pose.batch.options import BatchOptions
from dgc_pose.cli.estimate import NO_POSE
from dgc_pose.cli.guard import OutputFolder
from dgc_pose.cli.options import KChoice, dataclass_options
from dgc_pose.cli.process import name_bad_images, name_missing_second, progress_bars, to_stderr
from dgc_pose.errors import InputError, printable
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions
from dgc_pose.system.options import option

if TYPE_CHECKING:
    from dgc_pose.batch.pairs import PairRow
    from dgc_pose.batch.result import Batch
    from dgc_pose.batch.source import PairChoice, Source

CAMERAS_SHOWN = 5
PAIRS_SHOWN = 20
_FOLDER = OutputFolder(path_type=Path)
OUT = click.option(
    "--out", type=_FOLDER, required=True, metavar="DIR", help="Folder of the results."
)


@dataclass(frozen=True, kw_only=True)
class BatchChoice(KChoice):
    """The options of a batch: its images, pairs and cameras, and the options of each step."""

    root: Path | None = option(None, "Folder of a list's image names; default: the list's folder.")
    masks: Path | None = option(
        None, "Folder with the mask NAME.jpg.png of NAME.jpg: black is not matched.", metavar="DIR"
    )
    pairs: str | None = option(
        None,
        "exhaustive; sequential:W, images at most W apart in the order of their names; auto:K, the "
        "K most similar images of each. Default: exhaustive for up to 20 images of a folder, "
        "auto:10 for more.",
        metavar="WAY",
    )
    frames: int = option(40, "Frames taken of a video.", metavar="N", min=2, max=10**6)
    work: BatchOptions
    matcher: MatcherOptions
    estimation: EstimationOptions

    def open(self, source: str, out: Path) -> Source:
        """The source of the batch in `out`. Frames of a video are kept in a folder beside `out`."""
        from dgc_pose.batch.source import open_source
        from dgc_pose.images.folder import frames_folder

        out = Path(os.path.abspath(out))  # has a name, even for "."
        frames = out.with_name(f"{out.name}_{self.frames}_frames_of_{Path(source).name}")
        path = frames_folder(Path(source), self.frames, frames)
        return open_source(path, self.root, self.masks)


def work_through(source: str, out: Path, choice: BatchChoice, min_images: int = 2) -> Batch:
    """Run a batch and show its progress. Raises InputError for fewer images than `min_images`."""
    from dgc_pose.batch.source import parse_pair_choice

    images = choice.open(source, out)
    for line in images.skipped:
        to_stderr(f"warning: {line}")
    if len(images.names) < min_images:
        raise InputError(f"{source}: {len(images.names)} images, and a model needs {min_images}")
    pairs = None if choice.pairs is None else parse_pair_choice(choice.pairs)
    return run_source(
        images, out, choice, choice.matcher, choice.estimation, choice.work, pairs=pairs
    )


def run_source(
    images: Source,
    out: Path,
    cameras: KChoice,
    matcher: MatcherOptions,
    estimation: EstimationOptions,
    work: BatchOptions,
    *,
    pairs: PairChoice | None = None,
) -> Batch:
    """`run_batch` with its progress, and a line on the images without a camera."""
    from dgc_pose.batch.run import run_batch
    from dgc_pose.batch.source import without_camera
    from dgc_pose.cameras.calibration import read_calibration

    calibration = read_calibration(cameras.k, "--K", cameras.details)
    lacking = without_camera(images, calibration)
    some = ""
    if 0 < len(lacking) < len(images.names):
        some = f" for {len(lacking)} of {len(images.names)} images (first: {lacking[0]})"
    if cameras.k is None and lacking:
        to_stderr(f"K is not stated{some}: the focal lengths are estimated (--K auto)")
    elif some:
        to_stderr(f"warning: {calibration.where} has no camera{some}")
    with progress_bars() as progress:
        return run_batch(
            images,
            calibration,
            pairs,
            out,
            matcher=matcher,
            estimation=estimation,
            options=work,
            progress=progress,
        )


def report(batch: Batch, where: Path | None = None) -> None:
    """Print the summary of a batch, its unusable images, and the first warning. where: the name of
    the batch, by default its folder."""
    from dgc_pose.batch.groups import joining
    from dgc_pose.batch.look_alikes import MOST_PAIRS
    from dgc_pose.batch.pairs import FAILED
    from dgc_pose.batch.result import MISSING
    from dgc_pose.cli.output import SOURCES

    summary = batch.summary
    name_bad_images(summary["bad_images"], batch.plan.names)
    if failed := [row for row in batch.rows if row.status == FAILED]:
        pairs = counted(len(failed), "pair")
        first = failed[0]
        which = f"{first.name1} {first.name2}: {first.reason}"
        to_stderr(f"{pairs} failed (first: {which}): --resume matches them again")
    if warnings := [text for camera in batch.plan.cameras.values() for text in camera.warnings]:
        more = f" (and {len(warnings) - 1} more images)" if len(warnings) > 1 else ""
        to_stderr(f"warning: {warnings[0]}{more}")
    if summary["poses"] and not summary["judged_together"]:
        to_stderr(f"more than {MOST_PAIRS} pairs have a pose: the look-alike check is skipped")
    if batch.plan.settings.get("second") == MISSING and joining(batch.rows):
        name_missing_second()
    if summary["rejected"]:
        number = sum(entry["pairs"] for entry in summary["rejected"])
        judged = counted(summary["judged_together"], "pair")
        to_stderr(f"{number} of {judged} rejected as look-alike places:")
    for entry in summary["rejected"][:CAMERAS_SHOWN]:
        groups = [
            f"{counted(len(g), 'image')} ({printable(g[0])}{', ...' * (len(g) > 1)})"
            for g in entry["groups"]
        ]
        places = "between " + " and ".join(groups) if len(groups) > 1 else f"among {groups[0]}"
        to_stderr(f"  {entry['pairs']} {places}")
    lines = []
    for camera in summary["cameras"]:
        focal = camera["focal_px"]
        std = camera["focal_std"]
        source = f"by {counted(camera['pairs'], 'pair')}"
        if camera["focal_source"] != "matches":
            source = SOURCES[camera["focal_source"]] + ": no pair determines it" * (std > 0)
        why = f" ({camera['first_image']}: {camera['why']})" if camera["why"] else ""
        lines.append((camera["images"], f"f = {focal:.0f} +- {focal * std:.0f} px {source}{why}"))
    echo_each_camera(lines, "cameras.csv")
    statuses = ", ".join(f"{name} {count}" for name, count in summary["by_status"].items())
    poses = f"{where or batch.folder}: {summary['poses']} poses"
    click.echo(
        f"{poses} of {summary['pairs']} pairs ({statuses}), "
        f"{summary['images']} images, {summary['matched_now']} pairs in {summary['seconds']:.0f} s"
    )


def counted(number: int, noun: str) -> str:
    """`1 pair`, `2 pairs`."""
    return f"{number} {noun}{'s' * (number != 1)}"


def echo_each_camera(cameras: Sequence[tuple[int, str]], file: str | Path) -> None:
    """Print the first cameras (number of images, text) and the file that lists the others."""
    for number, (images, text) in enumerate(cameras[:CAMERAS_SHOWN], start=1):
        click.echo(f"camera {number} ({counted(images, 'image')}): {text}")
    if (more := len(cameras) - CAMERAS_SHOWN) > 0:
        click.echo(f"{more} more cameras: see {file}")


def echo_pairs(rows: Sequence[PairRow]) -> None:
    """Print a table of the first pairs, and the number of the others."""
    from dgc_pose.estimation.status import percent_text
    from dgc_pose.geometry.rotation import rotation_angle_deg
    from dgc_pose.system.texts import aligned

    lines = ["pair,status,probability,rotation,R within,t within,inliers".split(",")]
    for row in rows[:PAIRS_SHOWN]:
        degrees: list[float | None] = [None] * 3
        if (pose := row.pose) is not None:
            angle = None if pose.R is None else rotation_angle_deg(pose.R)
            degrees = [angle, pose.rotation_error_90_deg, pose.translation_error_90_deg]
        shown = ["-" if value is None else f"{value:.2f} deg" for value in degrees]
        likely = "-" if row.probability is None else percent_text(row.probability)
        names = f"{row.name1} {row.name2}"
        inliers = f"{row.num_inliers} of {row.num_matches}"
        status = f"{row.status}, rejected" if row.rejected else row.status
        lines.append([printable(names), status, likely, *shown, inliers])
    click.echo(aligned(lines))
    if len(rows) > PAIRS_SHOWN:
        click.echo(f"... and {len(rows) - PAIRS_SHOWN} more")
    click.echo("within: in 90 % of cases, if the pose is right; probability: R and t within 10 deg")


@click.command()
@click.argument("source", metavar="SOURCE")
@OUT
@dataclass_options(BatchChoice, "choice")
def batch(source: str, out: Path, choice: BatchChoice) -> int:
    """Match many pairs of photographs and estimate their poses.

    SOURCE is a folder of photographs, a video, a list of pairs (two names per line, SuperGlue's
    format, or a .csv), or a COLMAP database (.db).

    Writes pairs.jsonl with a row for each pair (status, R, t, expected errors, counts); matches.h5
    with the matches in hloc's layout; and summary.json. If K is not known, also writes cameras.csv
    with the cameras estimated from all pairs together; --K reads this file. An unusable image is
    reported and does not stop the batch. --resume continues a stopped batch. Exits with 3 if no
    pair has a pose, with 2 if no image can be used.
    """
    from dgc_pose.batch.result import CAMERAS, MATCHES, PAIRS

    done = work_through(source, out, choice)
    echo_pairs(done.rows)
    report(done)
    click.echo(f"{out / PAIRS}: status, R, t and errors of each pair")
    click.echo(f"{out / MATCHES}: the matches, in hloc's layout")
    if done.plan.uncertain:
        click.echo(f"{out / CAMERAS}: the cameras, which --K reads")
    if done.summary["poses"]:
        folder = shlex.quote(str(out))
        click.echo(f"for COLMAP: dgc-pose export-colmap {folder} --database database.db")
    return 0 if done.summary["poses"] else NO_POSE
