"""Where the time of a pair goes, beside floors: `python -m dgc_pose.benchmarks.performance`.

The pipeline stage by stage and SIFT through the same estimator; the network as torch runs it and
as `for_inference` makes it. The floors are measured in the same run: the network's multiply-adds
at the rate of a large matrix product, the estimator against PoseLib alone with the same runs and
iterations. Everything is measured in turn, as often as --repetitions says, and medians are shown.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import TypeVar

import click
import cv2
import numpy as np
import torch

from dgc_pose.benchmarks.forwards import (
    Forward,
    forwards_text,
    matrix_rate,
    milliseconds,
    multiply_adds,
    time_forwards,
)
from dgc_pose.benchmarks.pair_list import read_pairs
from dgc_pose.benchmarks.table import aligned
from dgc_pose.camera import Camera, check_size, parse_camera
from dgc_pose.cli.options import split_names
from dgc_pose.errors import DgcPoseError, InputError
from dgc_pose.estimation import EstimationOptions, estimate_pose
from dgc_pose.estimation.poselib_backend import run_poselib
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.estimation.ransac import run_seeds
from dgc_pose.files import staged
from dgc_pose.image import load_image
from dgc_pose.matchers import refined
from dgc_pose.matches import Matches
from dgc_pose.matching import (
    DEFAULT_WEIGHTS,
    DenseMatcher,
    MatchResult,
    load_dense_matcher,
    select_matches,
)
from dgc_pose.matching.dense import network_input
from dgc_pose.matching.sift import SiftMatcher
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import load_network
from dgc_pose.refinement import RefinementOptions, Refiner

SIZE = (1600, 1200)  # of the bundled pair, enlarged
TOTAL, SIFT_TOTAL = "dgc-pose, in all", "sift, in all"
_UPRIGHT = "the map, without turning"

Value = TypeVar("Value")
Seconds = dict[str, float]


@dataclass(frozen=True)
class Setup:
    """What is measured: two images with their cameras, a matcher and the estimator's options."""

    path1: Path
    path2: Path
    camera1: Camera
    camera2: Camera
    dense: DenseMatcher
    refiner: Refiner  # of `dense`
    estimation: EstimationOptions


@dataclass(frozen=True)
class Stage:
    """One line of the table of stages."""

    name: str
    seconds: float  # median over the repetitions
    share: float  # of the whole, 0 to 1
    floor_seconds: float | None  # median; None where there is no floor


class Stopwatch:
    """Wall-clock seconds by name, added up where a name comes again."""

    def __init__(self) -> None:
        self.seconds: Seconds = {}

    def __call__(self, name: str, work: Callable[[], Value]) -> Value:
        start = time.perf_counter()
        result = work()
        passed = time.perf_counter() - start
        self.seconds[name] = self.seconds.get(name, 0.0) + passed
        return result


@torch.inference_mode()
def time_stages(setup: Setup) -> Seconds:
    """Seconds of every stage of a pair, once; with those of SIFT and of PoseLib alone."""
    watch, dense, refiner = Stopwatch(), setup.dense, setup.refiner
    paths = (setup.path1, setup.path2)
    first, second = images = watch("read", lambda: [load_image(path) for path in paths])
    net = dense.net
    device = next(net.parameters()).device
    inputs = watch("resize", lambda: [network_input(image.pixels, device) for image in images])
    source, target = watch("encoder", lambda: [net.features(one) for one in inputs])
    watch("decoders", lambda: net.decode(source, target, dense.options.finest))
    upright = DenseMatcher(net, replace(dense.options, rotate_below=0.0))
    watch(_UPRIGHT, lambda: upright.correspondence_maps([(first, second)]))
    (found,) = watch("the map", lambda: dense.correspondence_maps([(first, second)]))
    selected = watch("selection", lambda: select_matches(found, dense.options))
    given = MatchResult(selected, found)
    matches = watch("refinement", lambda: refiner.refine(first, second, given)).matches
    _time_pose(watch, "pose", setup, matches)
    watch("poselib alone", _poselib_alone(setup, matches))

    sift = watch("sift, matching", lambda: SiftMatcher().match(first, second)).matches
    _time_pose(watch, "sift, pose", setup, sift)
    seconds = watch.seconds
    read = seconds["read"]
    parts = seconds["the map"] + seconds["selection"] + seconds["refinement"] + seconds["pose"]
    return seconds | {
        "map in pixels": seconds[_UPRIGHT]
        - sum(seconds[name] for name in ("resize", "encoder", "decoders")),
        "turned tries": seconds["the map"] - seconds[_UPRIGHT],
        TOTAL: read + parts,
        SIFT_TOTAL: read + seconds["sift, matching"] + seconds["sift, pose"],
    }


def _time_pose(watch: Stopwatch, name: str, setup: Setup, matches: Matches) -> None:
    watch(name, lambda: estimate_pose(matches, setup.camera1, setup.camera2, setup.estimation))


def _poselib_alone(setup: Setup, matches: Matches) -> Callable[[], None]:
    """PoseLib's runs on all the matches, with the options' iterations and threshold."""
    options = setup.estimation
    problem = TwoViewProblem.of(matches, setup.camera1, setup.camera2, options)

    def run() -> None:
        for seed in run_seeds(options) if len(problem) >= 5 else ():
            run_poselib(
                problem.points1,
                problem.points2,
                threshold=problem.threshold,
                iterations=options.iterations,
                seed=seed,
            )

    return run


def stages(setup: Setup, repetitions: int, rate: Callable[[], float]) -> list[Stage]:
    """Every stage with its share of the whole and its floor. A stage that is the difference of two
    others, as the turned tries, may come out a little below nothing."""
    # Of a network of the same configuration, whose convolutions are all torch's.
    encoder, decoders = multiply_adds(DGCNet(setup.dense.net.config).eval())
    time_stages(setup)  # the first pass pays for what is set up once
    rows, rates = [], []
    for _ in range(repetitions):
        rows.append(time_stages(setup))
        rates.append(rate())
    median = {name: float(np.median([row[name] for row in rows])) for name in rows[0]}
    fastest = float(np.median(rates))
    floors = {
        "encoder": encoder / fastest,
        "decoders": decoders / fastest,
        "pose": median["poselib alone"],
    }
    names = ["read", "resize", "encoder", "decoders", "map in pixels", "turned tries", "selection"]
    names += ["refinement", "pose", TOTAL, "sift, matching", "sift, pose", SIFT_TOTAL]
    return [
        Stage(
            name,
            median[name],
            median[name] / median[SIFT_TOTAL if name.startswith("sift") else TOTAL],
            floors.get(name),
        )
        for name in names
    ]


def bundled_setup(folder: Path) -> tuple[Path, Path, Camera, Camera]:
    """The bundled pair enlarged to 1600 x 1200 and written into a folder, with its cameras."""
    pair = read_pairs(Path(str(files("dgc_pose") / "data" / "demo" / "pair.txt")))[0]
    paths, cameras = [], []
    for path, camera in ((pair.path1, pair.camera1), (pair.path2, pair.camera2)):
        image = load_image(path)
        large = cv2.resize(image.pixels, SIZE, interpolation=cv2.INTER_CUBIC)
        paths.append(folder / f"{path.stem}.png")
        cv2.imwrite(str(paths[-1]), cv2.cvtColor(large, cv2.COLOR_RGB2BGR))
        cameras.append(Camera(camera.K, image.size).resized(SIZE))
    return paths[0], paths[1], cameras[0], cameras[1]


def given_setup(path1: Path, path2: Path, k: str) -> tuple[Path, Path, Camera, Camera]:
    """The user's pair. Raises ImageError or InputError where something is of no use."""
    camera = parse_camera(k, "K")
    for path in (path1, path2):
        check_size(camera, load_image(path).size, "K")
    return path1, path2, camera, camera


def stages_text(found: Sequence[Stage]) -> str:
    """The stages as a table with aligned columns."""
    rows = [("stage", "ms", "share", "floor ms", "over floor")]
    for stage in found:
        floor = stage.floor_seconds
        beside = ("", "")
        if floor is not None:
            beside = (milliseconds(floor), f"{stage.seconds / floor:.2f}")
        rows.append((stage.name, milliseconds(stage.seconds), f"{stage.share:.0%}", *beside))
    return aligned(rows)


def result_data(
    facts: Mapping[str, object], found: Sequence[Stage], ways: Sequence[Forward]
) -> dict[str, object]:
    """What is written as JSON."""
    seconds = {stage.name: stage.seconds for stage in found}
    return {
        **facts,
        "stages": [asdict(stage) for stage in found],
        "sift_over_dgc_pose": seconds[SIFT_TOTAL] / seconds[TOTAL],
        "forwards": [asdict(one) for one in ways],
    }


@click.command()
@click.argument("image1", required=False, type=click.Path(path_type=Path))
@click.argument("image2", required=False, type=click.Path(path_type=Path))
@click.argument("k", metavar="[K]", required=False)
@click.option("--weights", default=DEFAULT_WEIGHTS, show_default=True, help="A name or a path.")
@click.option(
    "--forward",
    "networks",
    default="dgcm",
    show_default=True,
    help="Presets, of random weights, whose passes are compared beside the weights' own; with "
    "commas between.",
)
@click.option("--repetitions", type=click.IntRange(1), default=7, show_default=True)
@click.option("--threads", type=click.IntRange(1), help="Of torch and OpenCV; default: their own.")
@click.option("--json", "json_path", metavar="PATH", help="Write all figures as JSON.")
def main(
    image1: Path | None,
    image2: Path | None,
    k: str | None,
    weights: str,
    networks: str,
    repetitions: int,
    threads: int | None,
    json_path: str | None,
) -> None:
    """Where the time of a pair goes. Without images the bundled pair, enlarged to 1600x1200."""
    try:
        with staged(json_path) as stage, tempfile.TemporaryDirectory() as folder:
            if threads is not None:
                torch.set_num_threads(threads)
                cv2.setNumThreads(threads)
            configs = {f"{name}, random": preset(name) for name in split_names(networks)}
            dense = load_dense_matcher(weights, device="cpu")
            refiner = refined(dense, RefinementOptions())
            pair = _pair(image1, image2, k, Path(folder))
            nets = {refiner.name: load_network(weights)}
            for name, config in configs.items():
                torch.manual_seed(0)
                nets[name] = DGCNet(config).eval().requires_grad_(False)
            setup = Setup(*pair, dense, refiner, EstimationOptions())
            data = _measure(setup, nets, repetitions, {})
            if json_path is not None:
                stage(json_path).write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    except DgcPoseError as error:
        raise click.ClickException(str(error)) from error


def _pair(
    image1: Path | None, image2: Path | None, k: str | None, folder: Path
) -> tuple[Path, Path, Camera, Camera]:
    if image1 is None:
        return bundled_setup(folder)
    if image2 is None or k is None:
        raise InputError("give both images and K, or nothing")
    return given_setup(image1, image2, k)


def _measure(
    setup: Setup, nets: Mapping[str, DGCNet], repetitions: int, how: Mapping[str, object]
) -> dict[str, object]:
    """Measure, print, and return what is written as JSON."""
    images = [load_image(path) for path in (setup.path1, setup.path2)]
    facts = {
        "weights": setup.refiner.name,
        **how,
        "size": "x".join(map(str, images[0].size)),
        "repetitions": repetitions,
        "torch_threads": torch.get_num_threads(),
        "opencv_threads": cv2.getNumThreads(),
        "torch": torch.__version__,
    }
    click.echo(", ".join(f"{name} {value}" for name, value in facts.items()))
    found = stages(setup, repetitions, matrix_rate)
    click.echo("\n" + stages_text(found) + "\n")
    inputs = [network_input(image.pixels, torch.device("cpu")) for image in images]
    ways = [
        way
        for name, net in nets.items()
        for way in time_forwards(name, net, inputs, repetitions, matrix_rate)
    ]
    click.echo(forwards_text(ways) + "\n")
    data = result_data(facts, found, ways)
    click.echo(f"sift over dgc-pose, in all: {data['sift_over_dgc_pose']:.2f}")
    return data


if __name__ == "__main__":
    main()
