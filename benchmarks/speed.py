"""Where the time of a pair goes, beside floors measured in the same run.

The pipeline stage by stage, and SIFT through the same estimator. The floors are the network's
multiply-adds at the rate of a large matrix product, and PoseLib alone with the estimator's runs and
iterations. Beside them the ways to run a network. All are measured in turn in each repetition, and
medians are reported.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar, get_args

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from dgc_pose.cameras.calibration import pair_cameras
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import bundled_pair
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions, RelativePose
from dgc_pose.estimation.options import Effort
from dgc_pose.estimation.poselib_calls import MINIMAL, essential_matrix, run_seeds
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.files.tables import aligned
from dgc_pose.images.image import Image, load_image
from dgc_pose.matches import Matches
from dgc_pose.matching import DenseMatcher, MatchResult, select_matches
from dgc_pose.matching.sift import SiftMatcher
from dgc_pose.network.config import INPUT_SIZE
from dgc_pose.network.correspondence_net import CorrespondenceNet
from dgc_pose.network.inference import for_inference
from dgc_pose.network.weights import build_network
from dgc_pose.pose import pose_of_matches, pose_of_pair
from dgc_pose.refinement import Refiner

SIZE = (1600, 1200)  # of the bundled pair, enlarged
TOTAL = "in all"
SIFT, READ = "sift", "read"  # parts beside the steps of a pose and its efforts
_UPRIGHT = "the map, without rotations"
_ESTIMATION = EstimationOptions()
_MATRIX = 2048  # rows and columns of the matrix product that the machine's rate is taken from

FORWARD_COLUMNS = {
    "network": "{0.network}",
    "way": "{0.way}",
    "ms": "{0.milliseconds:.1f}",
    "times faster": "{0.times_faster:.2f}",
    "over floor": "{0.over_floor:.2f}",
    "apart px": "{0.apart_px:.1e}",
}
Value = TypeVar("Value")
Seconds = dict[str, float]


@dataclass(frozen=True)
class Setup:
    """What is measured: two images with their cameras, and a matcher."""

    path1: Path
    path2: Path
    camera1: Camera
    camera2: Camera
    dense: DenseMatcher
    refiner: Refiner  # of `dense`
    device: str  # that the network runs on

    @property
    def cameras(self) -> tuple[Camera, Camera]:
        return self.camera1, self.camera2


@dataclass(frozen=True)
class Stage:
    """One line of a table."""

    part: str  # what it is a stage of: the step "quick" or "match", "sift", or an effort
    name: str
    seconds: float  # median over the repetitions
    share: float  # of its part, 0 to 1
    floor_seconds: float | None  # median; None if there is no floor


def time_parts(setup: Setup) -> dict[str, Seconds]:
    """Seconds of a pair, once, by part and stage: the steps "quick" and "match", SIFT through the
    same estimator, and the whole by each effort, step by step. Beside them PoseLib alone."""
    timed: dict[str, Seconds] = {}
    timed["match"] = _stages_of(setup, setup.dense, setup.refiner)
    coarse, quick = setup.dense.coarser(), setup.refiner.quick
    if coarse is not None and quick is not None:
        timed["quick"] = _stages_of(setup, coarse, quick)
    watch = _Watch(setup.device)
    images = watch(READ, lambda: _read(setup))
    matched = watch("matching", lambda: SiftMatcher().match(*images))
    watch("pose", lambda: _pose(setup, matched))
    timed[SIFT] = watch.with_total()
    for effort in get_args(Effort):
        watch = _Watch(setup.device)
        first, second = watch(READ, lambda: _read(setup))
        options = EstimationOptions(effort=effort)
        pose, _ = pose_of_pair(setup.refiner, first, second, *setup.cameras, options)
        watch.seconds.update(pose.seconds)
        timed[effort] = watch.with_total()
    return timed


def _stages_of(setup: Setup, dense: DenseMatcher, refiner: Refiner) -> Seconds:
    """Of a step; all that a pair costs by it alone but reading the images."""
    watch = _Watch(setup.device)
    engine = dense.engine
    first, second = images = _read(setup)
    source, target = watch("encoder", lambda: [engine.encode(image.pixels) for image in images])
    watch("decoders", lambda: engine.decode([source], [target], dense.options.finest))
    upright = DenseMatcher(engine, replace(dense.options, search_below=0.0))
    watch(_UPRIGHT, lambda: upright.correspondence_maps([(first, second)]))
    (dense_map,) = watch("the map", lambda: dense.correspondence_maps([(first, second)]))
    selected = watch("selection", lambda: select_matches(dense_map, dense.options))
    result = MatchResult(selected, dense_map)
    refined = watch("refinement", lambda: refiner.refine(first, second, result))
    watch("pose", lambda: _pose(setup, refined))
    watch("poselib alone", _poselib_alone(setup, refined.matches))
    seconds = watch.seconds
    return {
        "encoder": seconds["encoder"],
        "decoders": seconds["decoders"],
        "map in pixels": seconds[_UPRIGHT] - seconds["encoder"] - seconds["decoders"],
        "rotated tries": seconds["the map"] - seconds[_UPRIGHT],
        **{name: seconds[name] for name in ("selection", "refinement", "pose", "poselib alone")},
        TOTAL: sum(seconds[name] for name in ("the map", "selection", "refinement", "pose")),
    }


class _Watch:
    """Seconds of pieces of work, by name. device: whose work counts too, which it waits for."""

    def __init__(self, device: str) -> None:
        self.device = device
        self.seconds: Seconds = {}

    def __call__(self, name: str, work: Callable[[], Value]) -> Value:
        start = time.perf_counter()
        result = work()
        if self.device == "cuda":
            torch.cuda.synchronize()
        self.seconds[name] = time.perf_counter() - start
        return result

    def with_total(self) -> Seconds:
        return self.seconds | {TOTAL: sum(self.seconds.values())}


def _read(setup: Setup) -> tuple[Image, Image]:
    return load_image(setup.path1), load_image(setup.path2)


def _pose(setup: Setup, result: MatchResult) -> RelativePose:
    return pose_of_matches(
        result.matches, *setup.cameras, _ESTIMATION, map_matches=result.map_matches
    )


def stages(setup: Setup, repetitions: int, rate: Callable[[], float]) -> list[Stage]:
    """Every stage of every part, with its share of the part and its floor.

    rate: measures the machine's multiply-adds a second. A stage that is the difference of two
    others, as the rotated tries, may be slightly negative.
    """
    # Of a network of the same configuration, before its layers are folded.
    encoder, decoders = multiply_adds(build_network(setup.dense.engine.config).eval())
    time_parts(setup)  # the first pass pays for what is set up once
    rows, rates = [], []
    for _ in range(repetitions):
        rows.append(time_parts(setup))
        rates.append(rate())
    fastest = float(np.median(rates))
    stages = []
    for part, names in rows[0].items():
        median = {
            name: float(np.median([row[part].get(name, 0.0) for row in rows])) for name in names
        }
        floors = {}
        if "poselib alone" in median:
            floors = {"encoder": encoder / fastest, "pose": median.pop("poselib alone")}
        if part == "match":
            floors["decoders"] = decoders / fastest
        stages += [
            Stage(part, name, seconds, seconds / median[TOTAL], floors.get(name))
            for name, seconds in median.items()
        ]
    return stages


def bundled_setup(folder: Path) -> tuple[Path, Path, Camera, Camera]:
    """The bundled pair enlarged to 1600 x 1200 and written into a folder, with its cameras."""
    pair = bundled_pair()
    paths, cameras = [], []
    for path, camera in ((pair.path1, pair.camera1), (pair.path2, pair.camera2)):
        image = load_image(path)
        large = cv2.resize(image.pixels, SIZE, interpolation=cv2.INTER_CUBIC)
        paths.append(folder / f"{path.stem}.png")
        cv2.imwrite(str(paths[-1]), cv2.cvtColor(large, cv2.COLOR_RGB2BGR))
        cameras.append(Camera(camera.K, image.size).resized(SIZE))
    return paths[0], paths[1], cameras[0], cameras[1]


def user_setup(path1: Path, path2: Path | None, k: str | None) -> tuple[Path, Path, Camera, Camera]:
    """The user's pair. Raises ImageError if an image is unusable, InputError if K is, or if an
    argument is missing."""
    if path2 is None or k is None:
        raise InputError("give both images and K, or nothing")
    cameras = pair_cameras(k, k, load_image(path1), load_image(path2), ("K", "K"))
    return path1, path2, *cameras


def stages_text(timed: Sequence[Stage]) -> str:
    """The stages as a table with aligned columns."""
    rows = [("of", "stage", "ms", "share", "floor ms", "over floor")]
    for stage in timed:
        floor = ("", "")
        if stage.floor_seconds is not None:
            over = stage.seconds / stage.floor_seconds
            floor = (f"{1000 * stage.floor_seconds:.1f}", f"{over:.2f}")
        rows.append(
            (stage.part, stage.name, f"{1000 * stage.seconds:.1f}", f"{stage.share:.0%}", *floor)
        )
    return aligned(rows)


@dataclass(frozen=True)
class Forward:
    """One way to run a network on a pair, 240 x 240."""

    network: str
    way: str
    seconds: float  # median over the repetitions
    times_faster: float  # than torch's eager pass: median of the ratios of each repetition
    over_floor: float  # its seconds over those of its multiply-adds at the machine's rate
    apart_px: float  # median distance of its map from the eager one's, pixels of 240 x 240

    @property
    def milliseconds(self) -> float:
        return 1000 * self.seconds


def multiply_adds(net: CorrespondenceNet) -> tuple[int, int]:
    """Multiply-adds of the convolutions for a pair: of both images' encoder, and of the decoders.

    Correlations are left out: they are hardly a hundredth.
    """
    image = torch.zeros(1, 3, INPUT_SIZE, INPUT_SIZE, device=next(net.parameters()).device)
    with torch.inference_mode():
        with FlopCounterMode(display=False) as encoder:
            features = net.features(image)
        with FlopCounterMode(display=False) as decoders:
            net.decode(features, features)
    counts = [
        int(counter.get_flop_counts()["Global"][torch.ops.aten.convolution]) // 2
        for counter in (encoder, decoders)
    ]
    return 2 * counts[0], counts[1]


def matrix_rate(device: str) -> float:
    """Multiply-adds a second of a large matrix product in single precision, on a device."""
    matrix = torch.ones(_MATRIX, _MATRIX, device=device)
    watch = _Watch(device)
    watch("product", lambda: torch.mm(matrix, matrix))
    return _MATRIX**3 / watch.seconds["product"]


def time_forwards(
    name: str,
    net: CorrespondenceNet,
    images: Sequence[Tensor],
    repetitions: int,
    rate: Callable[[], float],
) -> list[Forward]:
    """The ways to run a network on two images (1, 3, 240, 240), the eager one first."""
    half = for_inference(net)
    half.half_precision = True
    eager = "torch, eager"
    ways = {eager: net, "batch norm folded": for_inference(net), "bfloat16": half}
    seconds: dict[str, list[float]] = {way: [] for way in ways}
    rates = []
    with torch.inference_mode():
        maps = {way: variant(*images).maps[-1] for way, variant in ways.items()}
        for _ in range(repetitions):
            watch = _Watch(images[0].device.type)
            for way, variant in ways.items():
                watch(way, partial(variant, *images))
                seconds[way].append(watch.seconds[way])
            rates.append(rate())
    floor = sum(multiply_adds(net)) / float(np.median(rates))
    return [
        Forward(
            name,
            way,
            float(np.median(taken)),
            float(np.median(np.divide(seconds[eager], taken))),
            float(np.median(taken)) / floor,
            float((maps[way] - maps[eager]).norm(dim=1).median()) * INPUT_SIZE / 2,
        )
        for way, taken in seconds.items()
    ]


def _poselib_alone(setup: Setup, matches: Matches) -> Callable[[], None]:
    """PoseLib's runs on all the matches, with the options' iterations and threshold."""
    problem = TwoViewProblem.of(matches, setup.camera1, setup.camera2, _ESTIMATION)

    def run() -> None:
        for seed in run_seeds(_ESTIMATION) if len(problem) >= MINIMAL else ():
            essential_matrix(
                problem.points1,
                problem.points2,
                threshold=problem.threshold,
                iterations=_ESTIMATION.iterations,
                seed=seed,
            )

    return run
