"""What a training run does: network, length, pairs, starting weights, what learns."""

from dataclasses import dataclass, field
from typing import Literal

from dgc_pose.errors import InputError
from dgc_pose.network.config import NetworkConfig, preset
from dgc_pose.system.options import MAX_SEED, check_options, option
from dgc_pose.training.schedule import Schedule
from dgc_pose.training.synthesis.options import PairOptions

InitPart = Literal["all", "encoder"]


@dataclass(frozen=True)
class TrainingOptions:
    """One training run. Raises InputError, naming the field, for a value out of range."""

    preset: str = option("dgcm-lite0", "Network: dgc, dgcm or dgcm-lite0.")
    minutes: float | None = option(
        None, "Length of the training schedule, minutes.", above=0, max=10**7
    )
    steps: int | None = option(
        None, "Length of the schedule in steps; such a run repeats exactly.", min=1, max=10**9
    )
    ablations: tuple[str, ...] = option(
        (),
        "Change of the network, as in the paper: no-l2, flow, no-dilation or local-correlation; "
        "may be given several times. The first and the third also change dgcm-lite0.",
        flag="--ablation",
    )
    seed: int = option(0, "Seed of all random draws.", min=0, max=MAX_SEED)
    schedule: Schedule = option(
        Schedule(),
        "Shares of the time for encoder, decoders and polish, in percent. A frozen encoder has "
        "none; the others divide its share.",
        flag="--split",
        parse=Schedule.parse,
        text="45,45,10",
    )
    pairs: PairOptions = field(default_factory=PairOptions)
    init: str | None = option(None, "Weights to initialise from: a file, or a shipped name.")
    init_part: InitPart = option(
        "all", "Part of the --init weights to use; the rest is initialised at random."
    )
    encoder: str | None = option(
        None,
        "ImageNet weights for the encoder (.pth or .safetensors): of VGG-16 in torchvision's "
        "layout, frozen, for dgc and dgcm; of EfficientNet-Lite0, to start from, for dgcm-lite0.",
    )
    rate: float = option(
        1.0,
        "Factor of the learning rates; with --init, choose less, such as 0.1.",
        above=0,
        max=1000,
    )
    batch: int | None = option(None, "Pairs a step; default: the stage's own.", min=1, max=2**16)
    validation_count: int = option(
        64, "Pairs of held-back photographs.", flag="--validation-pairs", min=1, max=2**20
    )
    half_precision: bool = option(
        False, "Convolutions in bfloat16, everything else in single precision."
    )
    validate_minutes: float = 5.0  # between validations
    save_minutes: float = 1.0  # between checkpoints
    average_decay: float = 0.998  # at most, of the exponential moving average of the weights

    def __post_init__(self) -> None:
        check_options(self)
        preset(self.network)  # raises InputError for a name of no network
        if (self.minutes is None) == (self.steps is None):
            raise InputError("a run needs its length, in minutes or in steps, and one of them only")
        if self.encoder is not None and self.init is not None and self.init_part == "encoder":
            raise InputError("encoder and init_part=encoder both set the encoder")
        if self.schedule.encoder == 1 and self.encoder_is_frozen:
            raise InputError(
                f"the schedule trains the encoder of {self.network} alone: it is frozen"
            )

    @property
    def network(self) -> str:
        """The name of the network: the preset and its ablations, as `preset` takes it."""
        return "+".join([self.preset, *self.ablations])

    @property
    def config(self) -> NetworkConfig:
        return preset(self.network)

    @property
    def encoder_is_frozen(self) -> bool:
        """Whether no stage trains the encoder: VGG-16's of ImageNet, as in the paper."""
        is_vgg = self.config.pyramid != "efficientnet-lite0"
        return is_vgg and self.encoder is not None

    @property
    def stages(self) -> Schedule:
        """The schedule, without the share of an encoder that is frozen."""
        return self.schedule.without_encoder() if self.encoder_is_frozen else self.schedule
