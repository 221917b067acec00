"""Options that several commands share: dataclasses that `dataclass_options` makes options of."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from dgc_pose.cameras.camera import Camera, camera_for, guess_camera
from dgc_pose.errors import InputError
from dgc_pose.images.image import Image
from dgc_pose.matching import DEFAULT_WEIGHTS, MatchingOptions
from dgc_pose.refinement import AlignmentOptions, RefinementOptions, SourceName
from dgc_pose.runtime.load import RuntimeName
from dgc_pose.system.options import option

if TYPE_CHECKING:
    from dgc_pose.matching import Matcher

DeviceName = Literal["auto", "cpu", "cuda"]
RUNTIME_HELP = (
    "What runs the network: ONNX Runtime, on the CPU, or torch; auto: ONNX Runtime for shipped "
    "weights on the CPU, torch for all others."
)


def split_names(text: str) -> list[str]:
    """The names in a comma-separated list, without blanks around them; empty ones are dropped."""
    return [name for name in (part.strip() for part in text.split(",")) if name]


@dataclass(frozen=True)
class CameraChoice:
    """What the user said about the cameras. --K1 and --K2 override --K."""

    k: str | None = option(
        None,
        "Camera of both images: fx,fy,cx,cy, a 3x3 text or .npy file, or a COLMAP camera "
        "MODEL,w,h,params.",
        flag="--K",
        metavar="K",
    )
    k1: str | None = option(None, "Camera of image 1 alone.", flag="--K1", metavar="K")
    k2: str | None = option(None, "Camera of image 2 alone.", flag="--K2", metavar="K")
    guess_focal: bool = option(
        False,
        "Without a K, take the focal length from EXIF or guess it. Poses get much worse.",
    )

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
class RefineChoice:
    """The source of refinement, or none."""

    source: Literal["none", SourceName] = option(
        "auto",
        "Which matches are aligned on the original photographs: those of the map, or those of the "
        "encoder's features at native resolution; auto: the features', and the map's if those are "
        "few.",
        flag="--refine",
    )

    def options(self, matching: MatchingOptions) -> RefinementOptions | None:
        """Refinement with the number of matches of the selection."""
        if self.source == "none":
            return None
        alignment = AlignmentOptions(max_matches=matching.max_matches)
        return RefinementOptions(source=self.source, alignment=alignment)


@dataclass(frozen=True)
class MatcherChoice:
    """Which network to match with, and how."""

    weights: str = option(
        DEFAULT_WEIGHTS,
        "Shipped weights by name, or a path to .safetensors or to an authors' .pth.",
    )
    device: DeviceName = option("auto", "Where the network runs.")
    runtime: RuntimeName = option("auto", RUNTIME_HELP)
    half_precision: bool = option(
        False, "Convolutions in bfloat16, by torch: less exact, faster on a device that has it."
    )
    matching: MatchingOptions = field(default_factory=MatchingOptions)
    refine: RefineChoice = field(default_factory=RefineChoice)

    def load(self) -> Matcher:
        """Raises WeightsError if weights cannot be loaded, InputError without such a device."""
        from dgc_pose.matchers import load_matcher

        return load_matcher(
            self.weights,
            device=self.device,
            runtime=self.runtime,
            half_precision=self.half_precision,
            matching=self.matching,
            refinement=self.refine.options(self.matching),
        )
