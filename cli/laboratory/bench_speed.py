"""`dgc-pose bench-speed`: where the time of a pair goes."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import get_args

import click

from dgc_pose.cameras.calibration import pair_cameras
from dgc_pose.cli.dataclass_options import dataclass_options
from dgc_pose.estimation import EstimationOptions
from dgc_pose.estimation.options import Effort
from dgc_pose.files.tables import aligned
from dgc_pose.images.image import load_image
from dgc_pose.matchers import MatcherOptions
from dgc_pose.system.options import option

SIFT = "sift"  # through the same estimator
TOTAL = "in all"
_WHAT = ("weights", "device", "runtime", "half_precision")  # of `MatcherOptions`


@dataclass(frozen=True)
class SpeedOptions:
    """What is timed."""

    k: str = option("auto", "Camera of both images, as for estimate.", flag="--K", metavar="K|FILE")
    repetitions: int = option(7, "Times that each is measured, in turn.", min=1, max=10**6)


@click.command()
@click.argument("image1", metavar="IMG1", type=click.Path(path_type=Path))
@click.argument("image2", metavar="IMG2", type=click.Path(path_type=Path))
@dataclass_options(SpeedOptions, "speed")
@dataclass_options(MatcherOptions, "matcher", only=_WHAT)
def bench_speed(image1: Path, image2: Path, speed: SpeedOptions, matcher: MatcherOptions) -> None:
    """Time a pair step by step, by each effort, and SIFT through the same estimator.

    Prints medians in milliseconds; "load" is the reading of the images.
    """
    images = load_image(image1), load_image(image2)
    pair_cameras(speed.k, speed.k, *images, ("--K", "--K"))  # refused before a matcher is loaded
    from dgc_pose.pose import estimate_relative_pose  # heavy

    loaded, sift = matcher.load(), replace(matcher, weights=SIFT).load()
    ways = {effort: (loaded, EstimationOptions(effort=effort)) for effort in get_args(Effort)}
    ways[SIFT] = sift, EstimationOptions()
    timed: dict[str, list[Mapping[str, float]]] = {name: [] for name in ways}
    for repetition in range(1 + speed.repetitions):
        for name, (used, options) in ways.items():
            start = time.perf_counter()
            images = load_image(image1), load_image(image2)
            cameras = pair_cameras(speed.k, speed.k, *images, ("--K", "--K"))
            seconds = time.perf_counter() - start
            pose = estimate_relative_pose(*images, *cameras, matcher=used, options=options)
            if repetition:  # the first pass pays for what is set up once
                timed[name].append({**pose.seconds, "load": seconds})
    rows = [("effort", "step", "ms")]
    for name, measured in timed.items():
        steps = {step: median(row[step] for row in measured) for step in measured[0]}
        steps[TOTAL] = median(sum(row.values()) for row in measured)
        rows += [(name, step, f"{1000 * seconds:.1f}") for step, seconds in steps.items()]
    click.echo(aligned(rows))
