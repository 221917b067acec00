"""`dgc-pose judge`: the verdict of matches that another program made."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dgc_pose.batch.options import BatchOptions
from dgc_pose.cli.batch import PAIRS_SHOWN, echo_pairs, report, run_source
from dgc_pose.cli.estimate import NO_POSE
from dgc_pose.cli.guard import STDOUT, NamedPath, OutputFolder
from dgc_pose.cli.options import KChoice, dataclass_options, output_file
from dgc_pose.cli.process import to_stderr
from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions
from dgc_pose.system.files import save_text, scratch_folder, staged
from dgc_pose.system.options import option
from dgc_pose.system.texts import json_text

if TYPE_CHECKING:
    from dgc_pose.batch.pairs import PairRow

_ESTIMATION = ("runs", "iterations", "threshold_px", "seed", "min_probability")
_NUMBERS = ("probability", "rotation_error_90_deg", "translation_error_90_deg")
_COLUMNS = (
    *("name1", "name2", "status", "claimed", *_NUMBERS, "folder_probability"),
    *("num_inliers", "num_matches", "qw", "qx", "qy", "qz", "tx", "ty", "tz", "reason"),
)


@dataclass(frozen=True)
class Outputs:
    """The files to write."""

    out: str | None = output_file(
        "Write a COLMAP database: a copy of SOURCE's, or hloc's key points and matches. Its "
        "two-view geometries are the claimed poses and rotations with their inliers.",
        "DB",
    )
    json: str | None = output_file(
        "Write the pairs as JSON, those in doubt first; - for stdout.", "PATH|-", stdout=True
    )
    csv: str | None = output_file("Write the pairs as a table, in the same order.", "PATH.csv")
    batch: Path | None = option(
        None,
        "Write the files of `dgc-pose batch` there. --resume goes on with a stopped run there.",
        metavar="DIR",
        type=OutputFolder(path_type=Path),
    )


@click.command()
@click.argument("source", metavar="SOURCE", type=NamedPath(path_type=Path))
@click.option(
    "--images",
    type=NamedPath(path_type=Path),
    metavar="FOLDER",
    help="Folder of the photographs: EXIF data, and what surrounds the matches, count too.",
)
@dataclass_options(Outputs, "outputs")
@dataclass_options(KChoice, "cameras")
@dataclass_options(EstimationOptions, "estimation", only=_ESTIMATION)
@dataclass_options(BatchOptions, "work")
def judge(
    source: Path,
    images: Path | None,
    outputs: Outputs,
    cameras: KChoice,
    estimation: EstimationOptions,
    work: BatchOptions,
) -> int:
    """Judge matches that another program made: which pairs have a right pose?

    SOURCE is a COLMAP database; a folder with hloc's .h5 of features and of matches; or a folder
    of .npz, one for each pair, with points1, points2 (N, 2) and optionally confidence (N,),
    error_px, key_points (False), image1 and image2, the names, by default those of
    NAME1_NAME2.npz.

    Prints a table of the pairs: the claimed ones, the least probable first, then the others. Poses
    refer to the pixels as SOURCE has them. Without --K, cameras of known focal length are the
    database's, and other focal lengths are estimated. An unusable pair has the status bad_input.
    Exits with 3 if no pair has a pose, with 2 if no pair can be judged.
    """
    from dgc_pose.batch.given import read_given
    from dgc_pose.batch.judge import by_doubt, require_judged
    from dgc_pose.batch.pairs import BAD_INPUT
    from dgc_pose.batch.source import given_source
    from dgc_pose.colmap.judged import require_key_points, write_judged

    if work.resume and outputs.batch is None:
        raise InputError(ArgumentName("resume"), "needs", ArgumentName("batch"))
    given = read_given(source)
    opened = given_source(given, images)
    if outputs.out is not None:
        require_key_points(given)
    json_file = None if outputs.json == STDOUT else outputs.json
    with (
        staged(outputs.out, json_file, outputs.csv) as stage,
        _folder(outputs.batch) as folder,
    ):
        done = run_source(opened, folder, cameras, MatcherOptions(), estimation, work)
        for line in given.notes:
            to_stderr(line)
        require_judged(done.rows)
        rows = by_doubt(done.rows)
        data = json_text({"pairs": [json.loads(row.to_json()) for row in rows]})
        if json_file is not None:
            save_text(stage(json_file), data)
        if outputs.csv is not None:
            save_text(stage(outputs.csv), _table(rows))
        if outputs.out is not None:
            count = write_judged(done, given, stage(outputs.out))
    if outputs.json == STDOUT:
        click.echo(data, nl=False)
    else:
        echo_pairs(rows)
        unusable = [row for row in rows if row.status == BAD_INPUT and not row.bad_images]
        for row in unusable[:PAIRS_SHOWN]:
            to_stderr(f"bad input {' '.join(row.names)}: {row.reason}")
        report(done, source)
        if outputs.out is not None:
            click.echo(f"{outputs.out}: {count} pairs, for `colmap mapper`")
    return 0 if done.summary["poses"] else NO_POSE


@contextmanager
def _folder(batch: Path | None) -> Iterator[Path]:
    """The folder of the batch; without one, a folder that is removed at the end."""
    if batch is not None:
        yield batch
        return
    with scratch_folder() as scratch:
        yield scratch / "batch"


def _table(rows: Sequence[PairRow]) -> str:
    """The rows as CSV: cam2_from_cam1 is a unit quaternion, w first, and t."""
    from dgc_pose.geometry.rotation import quaternion_wxyz

    table = io.StringIO()
    lines = csv.writer(table, lineterminator="\n")
    lines.writerow(_COLUMNS)
    for row in rows:
        pose = row.pose
        numbers = [getattr(pose, name, None) for name in _NUMBERS]
        R = None if pose is None else pose.R
        t = None if pose is None else pose.t
        q = [None] * 4 if R is None else quaternion_wxyz(R).tolist()
        along = [None] * 3 if t is None else t.tolist()
        claimed = int(row.success and not row.rejected)
        counts = row.folder_probability, row.num_inliers, row.num_matches
        reason = "the other pairs contradict it" if row.rejected else row.reason
        lines.writerow([*row.names, row.status, claimed, *numbers, *counts, *q, *along, reason])
    return table.getvalue()
