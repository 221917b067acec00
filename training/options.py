"""The options of a training run: network, length, pairs, initial weights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from dgc_pose.errors import ArgumentName, InputError
from dgc_pose.network.config import NetworkConfig, preset
from dgc_pose.system.options import MAX_SEED, check_options, option


class Shares(NamedTuple):
    """The share of each kind of pairs; a kind without data gets no pairs."""

    photos: float = 0.20  # warped photographs
    light: float = 0.08  # warped photographs of one place in different light
    rooms: float = 0.20  # ray-cast
    posed: float = 0.52  # posed photographs of known depth

    def __str__(self) -> str:
        return ",".join(f"{100 * share:g}" for share in self)

    @classmethod
    def parse(cls, text: str) -> Shares:
        """Parse percentages such as "20,8,20,52". Raises InputError for any other text."""
        try:
            shares = [float(part) / 100 for part in text.split(",")]
        except ValueError:
            shares = []
        if len(shares) != 4 or not min(shares) >= 0 or not 0 < sum(shares) < float("inf"):
            raise InputError(f"shares must be four percentages, such as 20,8,20,52, not {text}")
        return cls(*shares)


@dataclass(frozen=True)
class TrainingOptions:
    """One training run. Raises InputError, naming the field, for a value out of range."""

    preset: str = option("dgcm-lite0", "Network: dgc, dgcm or dgcm-lite0.")
    seconds: float | None = option(None, "Length of the run.", above=0, max=10**9)
    steps: int | None = option(
        None, "Length of the run in steps; on a CPU such a run repeats exactly.", min=1, max=10**9
    )
    seed: int = option(0, "Seed of all random draws.", min=0, max=MAX_SEED)
    encoder_share: float = option(
        0.7, "Share of the run for the encoder; VGG-16 stays as it is.", min=0, max=1
    )
    shares: Shares = option(
        Shares(),
        "Percentages of the pairs: warped photographs, those in other light, rooms, posed "
        "photographs. A kind without data has none.",
        parse=Shares.parse,
        text="20,8,20,52",
    )
    init: str | None = option(None, "Weights to initialise from: a file, or a shipped name.")
    encoder: str | None = option(
        None,
        "ImageNet's VGG-16 for the encoder of dgc and dgcm, .pth or .safetensors in torchvision's "
        "layout; it stays as it is.",
    )
    rate: float = option(
        1.0, "Factor of the learning rates; with --init, choose less.", above=0, max=1000
    )
    batch: int | None = option(
        None,
        "Pairs a step, of 240x240 pixels; default: on a GPU 84 and 64, on a CPU 4.",
        min=1,
        max=2**16,
    )

    def __post_init__(self) -> None:
        check_options(self)
        own = self.config.any_shape  # raises InputError for an unknown network
        if (self.seconds is None) == (self.steps is None):
            raise InputError("set the length of the run, either in seconds or in steps")
        if own and self.encoder is not None:
            raise InputError(ArgumentName("encoder"), f"is VGG-16, not for {self.preset}")
        if not own and self.encoder is None and self.init is None:
            needs = f"or init is needed: the VGG-16 of {self.preset} is not trained"
            raise InputError(ArgumentName("encoder"), needs)

    @property
    def config(self) -> NetworkConfig:
        return preset(self.preset)
