"""Where the time of a pair goes, beside floors measured in the same run.

The pipeline stage by stage, and SIFT through the same estimator. The floors are the network's
multiply-adds at the rate of a large matrix product, and PoseLib alone with the estimator's runs and
iterations. Beside them the ways to run a network. All are measured in turn in each repetition, and
medians are reported.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from dgc_pose.benchmarks.table import aligned
from dgc_pose.cameras.calibration import pair_cameras
from dgc_pose.cameras.camera import Camera
from dgc_pose.cameras.pair_list import bundled_pair
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions, RelativePose
from dgc_pose.estimation.poselib_calls import MINIMAL, essential_matrix, run_seeds
from dgc_pose.estimation.problem import TwoViewProblem
from dgc_pose.images.image import load_image
from dgc_pose.matches import Matches
from dgc_pose.matching import DenseMatcher, MatchResult, select_matches
from dgc_pose.matching.sift import SiftMatcher
from dgc_pose.network.config import INPUT_SIZE
from dgc_pose.network.inference import for_inference
from dgc_pose.network.net import DGCNet
from dgc_pose.pose import pose_of_matches, search_again
from dgc_pose.refinement import Refiner

SIZE = (1600, 1200)  # of the bundled pair, enlarged
TOTAL, SIFT_TOTAL = "dgc-pose, in all", "sift, in all"
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
_NAMES = (
    *("read", "encoder", "decoders", "map in pixels", "rotated tries", "selection", "refinement"),
    *("pose", "search", TOTAL, "sift, matching", "sift, pose", SIFT_TOTAL),
)

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


@dataclass(frozen=True)
class Stage:
    """One line of the table of stages."""

    name: str
    seconds: float  # median over the repetitions
    share: float  # of the whole, 0 to 1
    floor_seconds: float | None  # median; None if there is no floor


def time_stages(setup: Setup) -> Seconds:
    """Seconds of every stage of a pair, once; with those of SIFT and of PoseLib alone."""
    seconds: Seconds = {}

    def watch(name: str, work: Callable[[], Value]) -> Value:
        start = time.perf_counter()
        result = work()
        seconds[name] = time.perf_counter() - start
        return result

    cameras = setup.camera1, setup.camera2

    def pose(result: MatchResult) -> RelativePose:
        map_matches = result.map_matches
        return pose_of_matches(result.matches, *cameras, _ESTIMATION, map_matches=map_matches)

    dense, refiner = setup.dense, setup.refiner
    paths = (setup.path1, setup.path2)
    first, second = images = watch("read", lambda: [load_image(path) for path in paths])
    engine = dense.engine
    source, target = watch("encoder", lambda: [engine.encode(image.pixels) for image in images])
    watch("decoders", lambda: engine.decode([source], [target], dense.options.finest))
    upright = DenseMatcher(engine, replace(dense.options, search_below=0.0))
    watch(_UPRIGHT, lambda: upright.correspondence_maps([(first, second)]))
    (dense_map,) = watch("the map", lambda: dense.correspondence_maps([(first, second)]))
    selected = watch("selection", lambda: select_matches(dense_map, dense.options))
    result = MatchResult(selected, dense_map)
    refined = watch("refinement", lambda: refiner.refine(first, second, result))
    found = watch("pose", lambda: pose(refined))
    watch(
        "search",
        lambda: search_again(refiner, first, second, refined, found, *cameras, _ESTIMATION),
    )
    watch("poselib alone", _poselib_alone(setup, refined.matches))

    sift = watch("sift, matching", lambda: SiftMatcher().match(first, second))
    watch("sift, pose", lambda: pose(sift))
    network = seconds["encoder"] + seconds["decoders"]
    parts = ("the map", "selection", "refinement", "pose", "search")
    return seconds | {
        "map in pixels": seconds[_UPRIGHT] - network,
        "rotated tries": seconds["the map"] - seconds[_UPRIGHT],
        TOTAL: seconds["read"] + sum(seconds[name] for name in parts),
        SIFT_TOTAL: seconds["read"] + seconds["sift, matching"] + seconds["sift, pose"],
    }


def stages(setup: Setup, repetitions: int, rate: Callable[[], float]) -> list[Stage]:
    """Every stage with its share of the whole and its floor.

    rate: measures the machine's multiply-adds a second. A stage that is the difference of two
    others, as the rotated tries, may be slightly negative.
    """
    # Of a network of the same configuration, before its layers are folded.
    encoder, decoders = multiply_adds(DGCNet(setup.dense.engine.config).eval())
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
    return [
        Stage(
            name,
            median[name],
            median[name] / median[SIFT_TOTAL if name.startswith("sift") else TOTAL],
            floors.get(name),
        )
        for name in _NAMES
    ]


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
    rows = [("stage", "ms", "share", "floor ms", "over floor")]
    for stage in timed:
        floor = ("", "")
        if stage.floor_seconds is not None:
            over = stage.seconds / stage.floor_seconds
            floor = (f"{1000 * stage.floor_seconds:.1f}", f"{over:.2f}")
        rows.append((stage.name, f"{1000 * stage.seconds:.1f}", f"{stage.share:.0%}", *floor))
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


def multiply_adds(net: DGCNet) -> tuple[int, int]:
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


def matrix_rate() -> float:
    """Multiply-adds a second of a large matrix product in single precision, on this machine."""
    matrix = torch.ones(_MATRIX, _MATRIX)
    start = time.perf_counter()
    torch.mm(matrix, matrix)
    return _MATRIX**3 / (time.perf_counter() - start)


def time_forwards(
    name: str, net: DGCNet, images: Sequence[Tensor], repetitions: int, rate: Callable[[], float]
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
            for way, variant in ways.items():
                start = time.perf_counter()
                variant(*images)
                seconds[way].append(time.perf_counter() - start)
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
