"""`dgc-pose locate`: the poses of queries in a model."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dgc_pose.cli.estimate import NO_POSE
from dgc_pose.cli.guard import STDOUT, OutputFolder
from dgc_pose.cli.options import KChoice, dataclass_options, output_file
from dgc_pose.cli.output import camera_text, closing_lines, row_lines
from dgc_pose.cli.process import name_bad_images, progress_bars, to_stderr
from dgc_pose.errors import ArgumentName, ImageError, InputError, printable
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.status import probability_text
from dgc_pose.images.cache import ImageCache
from dgc_pose.images.decoding import image_header
from dgc_pose.matchers import MatcherOptions
from dgc_pose.system.files import save_text, staged
from dgc_pose.system.options import option
from dgc_pose.system.texts import json_text

if TYPE_CHECKING:
    from dgc_pose.cameras.by_image import Calibration
    from dgc_pose.localization.location import Location


@dataclass(frozen=True)
class Place:
    """The model and the files to write."""

    model: Path = option(
        help="The model: a folder of COLMAP's or of `dgc-pose reconstruct`; transforms.json; or a "
        ".csv with name, qw, qx, qy, qz, tx, ty, tz, fx, fy, cx, cy.",
        metavar="SOURCE",
    )
    images: Path = option(help="Folder of the model's images.", metavar="FOLDER")
    masks: Path | None = option(
        None,
        "Folder with the mask NAME.jpg.png of NAME.jpg, of the model or a QUERY: black is not "
        "matched.",
        metavar="DIR",
    )
    json: str | None = output_file(
        "Write the locations as JSON, by query; - for stdout.", "PATH|-", stdout=True
    )
    plot: str | None = output_file(
        "Draw a single query's place and matches with database images.", "PATH.png", picture=True
    )
    add: Path | None = option(
        None,
        "Write the model with the located queries, as COLMAP's.",
        metavar="DIR",
        type=OutputFolder("cameras.bin", "images.bin", "points3D.bin", path_type=Path),
    )


@click.command()
@click.argument("queries", metavar="QUERY...", nargs=-1, required=True, type=click.Path())
@dataclass_options(Place, "place")
@dataclass_options(KChoice, "cameras")
@dataclass_options(MatcherOptions, "matcher")
@dataclass_options(EstimationOptions, "estimation")
def locate(
    queries: Sequence[str],
    place: Place,
    cameras: KChoice,
    matcher: MatcherOptions,
    estimation: EstimationOptions,
) -> int:
    """Place photographs, the queries, in a model of known camera poses.

    Prints cam_from_world, x = R X + t, and the camera centre, in the frame and unit of the model,
    with the expected errors. If a query is not located, prints the reason and exits with 3. A query
    that cannot be read is named, and the others are located; if none can be read, exits with 2.
    """
    from dgc_pose.cameras.calibration import read_calibration
    from dgc_pose.localization.locate import Locator
    from dgc_pose.model import load_model, model_path
    from dgc_pose.viz import save_figure
    from dgc_pose.viz.pose_figure import plot_location

    if place.plot is not None and len(queries) > 1:
        raise InputError(ArgumentName("plot"), f"draws a single query, not {len(queries)}")
    if place.masks is not None and not place.masks.is_dir():
        raise InputError(ArgumentName("masks"), f"{place.masks}: no such folder")
    queries = [*dict.fromkeys(queries)]
    _require_fit(read_calibration(cameras.k or "auto", "--K", cameras.details), queries)
    model = load_model(place.model, place.images)
    if place.add is not None:
        if place.add.exists() and place.add.samefile(model_path(place.model)):
            raise InputError(ArgumentName("add"), f"{place.add} is the model itself, an input")
        model.require_addable(place.add, queries)
    for warning in model.warnings:
        to_stderr(f"warning: {warning}")
    locator = Locator(model, matcher.load(ImageCache()), estimation, place.masks)
    with progress_bars() as progress:
        locator.describe(partial(progress, "images"))
    name_bad_images(locator.bad, model.poses)
    json_file = None if place.json == STDOUT else place.json
    locations: dict[str, Location] = {}
    bad: dict[str, str] = {}
    with staged(json_file, place.plot) as stage:
        for query, location in zip(
            queries, locator.locate_all(queries, cameras.k, cameras.details), strict=True
        ):
            locations[query] = location
            if location.status == "bad_input":
                bad[query] = location.reason
            elif place.json != STDOUT:
                click.echo(location_text(query, location))
            elif not location.success:
                to_stderr(f"{query}: {location.status}, {location.reason}")
        data = json_text({query: location.to_dict() for query, location in locations.items()})
        if json_file is not None:
            save_text(stage(json_file), data)
        if place.plot is not None and not bad:
            figure = plot_location(model, queries[0], locations[queries[0]])
            save_figure(figure, stage(place.plot))
    if place.json == STDOUT:
        click.echo(data, nl=False)
    name_bad_images(bad, queries)
    if place.add is not None:  # last: COLMAP models cannot hold every camera
        added = {
            Path(query): (location.camera, location.cam_from_world)
            for query, location in locations.items()
            if location.camera is not None and location.cam_from_world is not None
        }
        if added:
            model.write(place.add, added)
    return 0 if all(location.success for location in locations.values()) else NO_POSE


def _require_fit(K: Calibration, queries: Sequence[str]) -> None:
    """Raise InputError if K fits none of the queries."""
    failures = list[InputError]()
    for query in queries:
        with suppress(ImageError):
            header = image_header(Path(query))
            try:
                K.camera(Path(), query, header)
            except InputError as error:
                failures.append(error)
            else:
                return
    if failures:
        raise failures[0]


def location_text(query: str, location: Location) -> str:
    """A location for people."""
    name = printable(query)
    lines = [f"{name}: {location.status}, {location.reason}"]
    if location.success:
        lines = [f"{name}: cam_from_world (x = R X + t), in the frame and unit of the model"]
    if location.R is not None:
        lines += [f"  R  {line}" for line in row_lines(*location.R)]
    if location.t is not None and location.centre is not None:
        lines.append(f"  t  {row_lines(location.t)[0]}")
        lines.append(f"  centre  {row_lines(location.centre)[0]}")
    if location.direction is not None:
        direction = row_lines(location.direction)[0]
        lines.append(f"  direction from {location.direction_from}  {direction}")
    rotation = location.rotation_error_90_deg
    position = location.position_error_90
    if rotation is not None and position is not None:
        lines.append(
            f"expected error: R within {rotation:.3f} deg, centre within {position:.3g} in "
            "90 % of cases, if the location is right"
        )
        event = "that R is within 5 deg and the centre within 5 % of the model's extent"
        lines.append(probability_text(location.probability, event))
    camera = location.camera
    if location.success and camera is not None and (text := camera_text(camera, camera)):
        lines.append(f"camera: {text}")
    matched = location.database_images
    used = [image.name for image in matched if image.agrees]
    agree = f"database images: {len(used)} of {len(matched)} agree"
    lines.append(": ".join([agree, ", ".join(used)] if used else [agree]))
    return "\n".join(map(printable, lines + closing_lines(location.warnings, location.seconds)))
