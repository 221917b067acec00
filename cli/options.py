"""Options that several commands share: each decorator hands its options over as one object."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import click

from dgc_pose.camera import Camera, camera_for, guess_camera
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions, EstimatorName
from dgc_pose.image import Image
from dgc_pose.matching import DEFAULT_WEIGHTS, MatchingOptions
from dgc_pose.matching.selection import FinestLevel
from dgc_pose.refinement import AlignmentOptions, FlowOptions, RefinementOptions, SourceName

if TYPE_CHECKING:
    from dgc_pose.matching import Matcher

Command = Callable[..., Any]

ESTIMATION = EstimationOptions()  # where the defaults in the help come from
MATCHING = MatchingOptions()
REFINEMENT = RefinementOptions()
NO_REFINEMENT = "none"


def split_names(text: str) -> list[str]:
    """The names in a list with commas between; blanks around them and empty ones do not count."""
    return [name for name in (part.strip() for part in text.split(",")) if name]


@dataclass(frozen=True)
class CameraChoice:
    """What the user said about the cameras."""

    k: str | None  # for both images
    k1: str | None  # these override k
    k2: str | None
    guess_focal: bool  # take the focal length from EXIF, or guess it, where no K is given

    def resolve(self, image1: Image, image2: Image) -> tuple[Camera, Camera]:
        """The cameras of both images, checked. Raises InputError, naming the option, if one is
        missing, unusable, or does not fit its image."""
        return self._camera(1, self.k1, image1), self._camera(2, self.k2, image2)

    def _camera(self, number: int, own: str | None, image: Image) -> Camera:
        name, text = ("--K", self.k) if own is None else (f"--K{number}", own)
        if text is not None:
            return camera_for(text, image.size, name)
        if self.guess_focal:
            return guess_camera(Path(image.name))
        raise InputError(
            f"image {number} has no K: give --K or --K{number}, or --guess-focal for a rough guess"
        )


@dataclass(frozen=True)
class MatcherChoice:
    """Which network to match with, and how."""

    weights: str
    device: str
    matching: MatchingOptions
    refinement: RefinementOptions | None  # None: the matches of the dense map

    def load(self) -> Matcher:
        from dgc_pose.matchers import load_matcher  # imports torch

        return load_matcher(
            self.weights,
            device=self.device,
            matching=self.matching,
            refinement=self.refinement,
        )


def camera_options(command: Command) -> Command:
    """--K, --K1, --K2 and --guess-focal, as `cameras: CameraChoice`."""

    @click.option(
        "--K",
        "k",
        metavar="K",
        help="Camera of both images: fx,fy,cx,cy, a 3x3 text or .npy file, or a COLMAP camera "
        "MODEL,w,h,params.",
    )
    @click.option("--K1", "k1", metavar="K", help="Camera of image 1 alone.")
    @click.option("--K2", "k2", metavar="K", help="Camera of image 2 alone.")
    @click.option(
        "--guess-focal",
        is_flag=True,
        help="Without a K, take the focal length from EXIF or guess it. Poses get much worse.",
    )
    @functools.wraps(command)
    def wrapper(
        *args: Any, k: str | None, k1: str | None, k2: str | None, guess_focal: bool, **kwargs: Any
    ) -> Any:
        return command(*args, cameras=CameraChoice(k, k1, k2, guess_focal), **kwargs)

    return wrapper


def device_option(command: Command) -> Command:
    """--device, as it is."""
    return click.option(
        "--device",
        type=click.Choice(["auto", "cpu", "cuda"]),
        default="auto",
        show_default=True,
        help="Where the network runs.",
    )(command)


def matchability_option(command: Command) -> Command:
    """--matchability, as `matchability: float`."""
    return click.option(
        "--matchability",
        type=float,
        metavar="T",
        default=MATCHING.matchability,
        show_default=True,
        help="Least matchability of a match, 0 to 1.",
    )(command)


def filter_options(command: Command) -> Command:
    """--matchability, --cycle and --max-matches, as `filters: MatchingOptions`."""

    @matchability_option
    @click.option(
        "--cycle",
        "cycle_px",
        type=float,
        metavar="PX",
        default=MATCHING.cycle_px,
        help="Compute the reverse map too, and drop matches of a larger cycle error.",
    )
    @click.option(
        "--max-matches",
        type=int,
        metavar="N",
        default=MATCHING.max_matches,
        show_default=True,
        help="Keep an even subsample of at most N matches.",
    )
    @functools.wraps(command)
    def wrapper(
        *args: Any, matchability: float, cycle_px: float | None, max_matches: int, **kwargs: Any
    ) -> Any:
        options = MatchingOptions(
            matchability=matchability, cycle_px=cycle_px, max_matches=max_matches
        )
        return command(*args, filters=options, **kwargs)

    return wrapper


def refine_option(command: Command) -> Command:
    """--refine, as `refine: SourceName | None`, None for none."""
    return click.option(
        "--refine",
        type=click.Choice([NO_REFINEMENT, *get_args(SourceName)]),
        default=REFINEMENT.source,
        show_default=True,
        callback=lambda _context, _option, value: None if value == NO_REFINEMENT else value,
        help="Which matches are aligned on the original photographs: the map's, those of the "
        "encoder's features at native resolution, or those of optical flow guided by the map; "
        "auto: the features', and the map's if those are few.",
    )(command)


def refinement_options(
    source: SourceName | None, filters: MatchingOptions
) -> RefinementOptions | None:
    """The options that --refine and the filters stand for; None for no refinement."""
    if source is None:
        return None
    return RefinementOptions(
        source=source,
        flow=FlowOptions(matchability=filters.matchability, max_matches=filters.max_matches),
        alignment=AlignmentOptions(max_matches=filters.max_matches),
    )


def matcher_options(command: Command) -> Command:
    """--weights, --device, --finest, the filters and --refine, as `matcher: MatcherChoice`."""

    @click.option(
        "--weights",
        default=DEFAULT_WEIGHTS,
        show_default=True,
        help="Shipped weights by name, or a path to .safetensors or to an authors' .pth.",
    )
    @device_option
    @click.option(
        "--finest",
        type=click.Choice([str(size) for size in get_args(FinestLevel)]),
        default=str(MATCHING.finest),
        show_default=True,
        help="Cells a side of the dense map: the coarser, the faster.",
    )
    @filter_options
    @refine_option
    @functools.wraps(command)
    def wrapper(
        *args: Any,
        weights: str,
        device: str,
        finest: str,
        filters: MatchingOptions,
        refine: SourceName | None,
        **kwargs: Any,
    ) -> Any:
        size = next(one for one in get_args(FinestLevel) if str(one) == finest)
        matching = replace(filters, finest=size)
        choice = MatcherChoice(weights, device, matching, refinement_options(refine, filters))
        return command(*args, matcher=choice, **kwargs)

    return wrapper


def estimator_options(command: Command) -> Command:
    """Estimator, runs, iterations, threshold and seed, as `estimation: EstimationOptions`."""

    @click.option(
        "--estimator",
        type=click.Choice(get_args(EstimatorName)),
        default=ESTIMATION.estimator,
        show_default=True,
        help="Library behind the robust estimation.",
    )
    @click.option(
        "--runs", default=ESTIMATION.runs, show_default=True, help="Runs of RANSAC, the best kept."
    )
    @click.option(
        "--iterations",
        default=ESTIMATION.iterations,
        show_default=True,
        help="Iterations of each run.",
    )
    @click.option(
        "--threshold",
        "threshold_px",
        type=float,
        metavar="PX",
        default=ESTIMATION.threshold_px,
        help="Largest epipolar error of an inlier, original pixels; by default "
        f"{ESTIMATION.threshold_factor:g} times the error that the matcher expects.",
    )
    @click.option(
        "--seed", default=ESTIMATION.seed, show_default=True, help="The same seed, the same pose."
    )
    @functools.wraps(command)
    def wrapper(
        *args: Any,
        estimator: EstimatorName,
        runs: int,
        iterations: int,
        threshold_px: float | None,
        seed: int,
        **kwargs: Any,
    ) -> Any:
        options = EstimationOptions(
            estimator=estimator,
            runs=runs,
            iterations=iterations,
            threshold_px=threshold_px,
            seed=seed,
        )
        return command(*args, estimation=options, **kwargs)

    return wrapper
