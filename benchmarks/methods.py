"""Methods by name: a matcher with its options, and the cameras that it gets.

A method is `NAME[/all]`. NAME is a matcher (see `load_matcher`), `dis`, or the name of stored
matches. `NAME/all` takes every pixel whose point on the map of NAME lies in image 1, whatever its
matchability, without refinement.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from dgc_pose.benchmarks.other_matchers import FLOW, FileMatcher, FlowMatcher, Names
from dgc_pose.benchmarks.posed_pairs import PosedPair
from dgc_pose.cameras.by_image import checked_camera
from dgc_pose.cameras.calibration import pair_cameras
from dgc_pose.cameras.camera import Camera
from dgc_pose.errors import InputError
from dgc_pose.estimation import EstimationOptions
from dgc_pose.matchers import MatcherOptions, RuntimeName
from dgc_pose.matching import Matcher
from dgc_pose.runtime.engine import Engine
from dgc_pose.system.options import check_options, option

EVERYWHERE = "/all"


@dataclass(frozen=True)
class CameraTrial:
    """The cameras that methods get. Errors are always computed with the list's K.

    Raises InputError, naming the field, on a value out of range, and for a K that is both withheld
    and scaled.
    """

    k: Literal["list", "auto", "auto:shared", "auto:two"] | None = option(
        None,
        "Also report focal lengths and warnings. list: the K of LIST; auto: K is withheld; "
        "auto:shared: one camera took both images; auto:two: two cameras did.",
        flag="--K",
    )
    k_scale: float = option(
        1.0, "Multiply the focal lengths of K.", flag="--K-scale", metavar="F", above=0, max=1000
    )

    def __post_init__(self) -> None:
        check_options(self)
        if self.k not in (None, "list") and self.k_scale != 1:
            raise InputError(f"K is {self.k}: a K that is withheld cannot be scaled")

    @property
    def reports(self) -> bool:
        """Whether a field is set, so that focal lengths and warnings are reported."""
        return self != CameraTrial()

    def cameras(self, pair: PosedPair) -> tuple[Camera, Camera]:
        """The cameras that a method gets for a pair, with the warnings that a user would get.

        Raises InputError if a user's command would reject the cameras.
        """
        if not self.reports:
            return pair.camera1, pair.camera2
        if self.k not in (None, "list"):
            return pair_cameras(self.k, self.k, pair.image1, pair.image2)
        camera1, camera2 = (
            checked_camera(camera.with_focal(self.k_scale * camera.focal), image.size, name)
            for name, camera, image in (
                ("K1", pair.camera1, pair.image1),
                ("K2", pair.camera2, pair.image2),
            )
        )
        return camera1, camera2


@dataclass(frozen=True)
class Method:
    """One row of the summary."""

    name: str  # as the user wrote it
    matcher: MatcherOptions
    estimation: EstimationOptions
    cameras: CameraTrial
    everywhere: bool = False  # whether it takes every pixel, whatever the matchability


def parse_methods(
    names: Sequence[str],
    matcher: MatcherOptions | None = None,
    estimation: EstimationOptions | None = None,
    stored: Sequence[str] = (),
    cameras: CameraTrial | None = None,
) -> list[Method]:
    """Parse the names of methods.

    Args:
        names: as described at the top of this file.
        matcher, estimation: options of all methods; only networks are refined.
        stored: names of stored matches, which take precedence over other matchers. Those without a
            method in `names` become methods, last.
        cameras: the cameras that all methods get.

    Raises InputError without methods, for a method that is named twice, and for `/all` with a
    matcher of key points.
    """
    matcher = matcher or MatcherOptions()
    estimation = estimation or EstimationOptions()
    cameras = cameras or CameraTrial()
    methods = list[Method]()
    named = {name.removesuffix(EVERYWHERE) for name in names}
    for text in [*names, *(name for name in stored if name not in named)]:
        if any(text == method.name for method in methods):
            raise InputError(f"the method {text!r} is named twice")
        weights = text.removesuffix(EVERYWHERE)
        used = replace(matcher, weights=weights)
        everywhere = text != weights
        if weights in (FLOW, *stored) or everywhere or not used.is_network:
            used = replace(used, matching=replace(used.matching, aligned="none"))
        if everywhere and not used.is_network and weights not in (FLOW, *stored):
            raise InputError(f"{text}: {weights} has no dense map, which {EVERYWHERE} needs")
        methods.append(Method(text, used, estimation, cameras, everywhere))
    if not methods:
        raise InputError("no methods named")
    return methods


def load_matchers(
    methods: Sequence[Method],
    *,
    device: str,
    runtime: RuntimeName = "auto",
    stored: Mapping[str, Mapping[Names, Path]] | None = None,
) -> list[Matcher]:
    """Load the matcher of each method; a network is read once.

    stored: files of stored matches by name. Methods share nothing computed from an image, so that
    each method's seconds cover its whole work.

    Raises WeightsError if weights cannot be loaded, InputError for an option that does not fit.
    """
    engines: dict[str, Engine | None] = {}
    matchers: list[Matcher] = []
    for options in (method.matcher for method in methods):
        if stored and options.weights in stored:
            files = stored[options.weights]
            matchers.append(FileMatcher(options.weights, files, options.matching))
            continue
        if options.weights == FLOW:
            matchers.append(FlowMatcher(options.matching))
            continue
        used = replace(options, device=device, runtime=runtime)
        matcher = used.load(engine=engines.get(options.weights))
        engines[options.weights] = matcher.engine
        matchers.append(matcher)
    return matchers
