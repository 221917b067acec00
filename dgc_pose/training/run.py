"""A training run: stages by the clock, a checkpoint that survives a kill, a log."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from copy import deepcopy
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from dgc_pose.errors import DgcPoseError, InputError, WeightsError
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.statistics import normalise
from dgc_pose.network.weights import load_checkpoint, save_weights
from dgc_pose.training.average import MovingAverage
from dgc_pose.training.batch import TrainingPairs
from dgc_pose.training.compact import expanded
from dgc_pose.training.curriculum import Curriculum
from dgc_pose.training.depth_scenes import DepthScenes
from dgc_pose.training.draws import Draws, seeded
from dgc_pose.training.log import Meter, Row, append
from dgc_pose.training.pairs import PairOptions, make_pairs
from dgc_pose.training.photos import Photos
from dgc_pose.training.processes import agreed, join_batch_norms, joint_sum, process_count, rank
from dgc_pose.training.schedule import STAGES, Schedule, StageName, learning_rate
from dgc_pose.training.stages import CoarsestStage, DecoderStage, EncoderStage, Thawed
from dgc_pose.training.start import InitPart, adopt, adopt_imagenet, rate_groups, take_up
from dgc_pose.training.teacher import Teacher
from dgc_pose.training.validation import validate, validation_pairs

CHECKPOINT = "checkpoint.pt"
_STEPS_A_ROW = 10  # of the log; between rows nothing is read from a GPU
_LARGEST_GRADIENT = 5.0  # norm over all parameters


@dataclass(frozen=True)
class RunOptions:
    """What a run trains, for how long, and how often it looks and saves."""

    preset: str
    # The schedule is complete after so many minutes of training, or after so many steps: then a
    # run repeats, whatever else the machine does. One of the two.
    minutes: float | None = None
    steps: int | None = None
    seed: int = 0
    schedule: Schedule = field(default_factory=Schedule)
    pairs: PairOptions = field(default_factory=PairOptions)
    curriculum: Curriculum | None = None  # None: the full ranges from the start
    validation_count: int = 64  # pairs
    validate_minutes: float = 5.0  # between validations
    save_minutes: float = 1.0  # between checkpoints
    batch: int | None = None  # pairs of all processes together; None: the stage's own
    # The batch is made in so many parts, each with random numbers of its own; None: one a process.
    # One process with two parts trains as two processes do.
    parts: int | None = None
    rate: float = 1.0  # times the stages' own learning rates; less for trained weights
    # Convolutions in bfloat16, all else in single precision.
    half_precision: bool = False
    average_decay: float = 0.998  # at most, of the exponential moving average of the weights
    init: str | None = None  # weights to start from; None: random ones
    init_part: InitPart = "all"  # of them; the rest starts from random ones
    body: str | None = None  # EfficientNet-Lite0's own weights, for the encoder to start from
    thaw: Thawed | None = None  # what of the encoder goes on learning beside the decoders
    teacher: str | None = None  # weights of a net to learn from, or none
    teacher_weight: float = 0.5  # of the teacher's map in the loss, beside the truth's 1

    def __post_init__(self) -> None:
        preset(self.preset)
        if (self.minutes is None) == (self.steps is None):
            raise InputError("a run needs its length, in minutes or in steps, and one of them only")
        for name in ("minutes", "rate"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise InputError(f"{name} must be positive, not {value}")
        if not 0 <= self.average_decay < 1:
            raise InputError(f"average_decay must lie in [0, 1), not {self.average_decay}")
        if self.teacher_weight < 0:
            raise InputError(f"teacher_weight must not be negative, not {self.teacher_weight}")
        for name in ("steps", "batch", "parts", "validation_count"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise InputError(f"{name} must be at least 1, not {value}")


Report = Callable[[Row], None]


class Trainer:
    """Trains one network as `RunOptions` say, in the folder `out`.

    `out` then holds checkpoint.pt (everything a resumed run needs), for each stage the logs
    `<stage>_steps_log.csv` and `<stage>_validation_log.csv` and, at the end,
    `<preset>.safetensors`. Raises InputError where `out` already holds a run and `resume` is
    False, or a batch cannot be shared out evenly; WeightsError where a checkpoint belongs to
    another preset, or weights to start from or learn from are of no use.

    Where torchrun started several processes, each trains on its part of every batch; the first
    alone writes and reports.
    """

    def __init__(
        self,
        photos: tuple[Photos, Photos],
        out: str | Path,
        options: RunOptions,
        *,
        real: DepthScenes | None = None,
        device: torch.device | str = "cpu",
        resume: bool = False,
    ) -> None:
        self.options = options
        self.out = Path(out)
        path = self.out / CHECKPOINT
        if path.exists() and not resume:
            raise InputError(f"{path} is there already: --resume goes on with it")
        self.device = torch.device(device)
        self._share_out()
        torch.manual_seed(options.seed)
        self.net = DGCNet(preset(options.preset))
        if options.init is not None:
            adopt(self.net, options.init, options.init_part)
        self.net.to(self.device).half_precision = options.half_precision
        self._teacher = None
        if options.teacher is not None:
            self._teacher = Teacher.load(
                options.teacher, options.teacher_weight, self.device, options.half_precision
            )
        self.out.mkdir(parents=True, exist_ok=True)
        self.photos, held_back = (p.to(self.device) for p in photos)
        self.real = None if real is None else real.to(self.device)
        self._validation = validation_pairs(
            held_back,
            options.validation_count,
            min(8, options.validation_count),
            replace(options.pairs, real_share=0.0),
        )
        if options.body is not None:
            adopt_imagenet(self.net, options.body, normalise(self._validation[0].image1))
        self.elapsed = 0.0  # seconds trained, over all sessions of the run
        self.step = 0
        self.stage: StageName | None = None
        self._meter = Meter(self.device)
        self.parameters: list[nn.Parameter]  # those that the stage trains
        self._module: EncoderStage | CoarsestStage
        self._average: MovingAverage[EncoderStage | CoarsestStage]
        self._enter(options.schedule.at(0.0)[0])
        if path.exists():
            self._load(path)

    @property
    def complete(self) -> bool:
        return self.progress >= 1

    @property
    def progress(self) -> float:
        """How much of the whole run is done, 0 to 1."""
        if self.options.minutes is None:
            assert self.options.steps is not None
            return self.step / self.options.steps
        return self.elapsed / (60 * self.options.minutes)

    def run(self, report: Report = lambda row: None, minutes: float | None = None) -> DGCNet:
        """Train to the end of the run, or for so many `minutes` more of it.

        `report` gets a row every few steps. Returns the network by its averaged weights; a complete
        run's weights are written too. Raises DgcPoseError where training has diverged.
        """
        end = math.inf if minutes is None else self.elapsed + 60 * minutes
        last_saved = last_validated = self.elapsed
        origin = time.perf_counter() - self.elapsed
        while not self.complete and self.elapsed < end:
            self.train_step(self.progress)
            self.elapsed = agreed(time.perf_counter() - origin)
            done = self.complete or self.elapsed >= end
            validates = done or self.elapsed - last_validated > 60 * self.options.validate_minutes
            if validates or self.step % _STEPS_A_ROW == 0:
                row = self._row()
                paused = time.perf_counter()
                if validates:
                    row |= self.validate()
                    last_validated = self.elapsed
                if rank() == 0:
                    report(row)
                    kind = "validation" if validates else "steps"
                    append(self.out / f"{self.stage}_{kind}_log.csv", row)
                if done or self.elapsed - last_saved > 60 * self.options.save_minutes:
                    self.save()
                    last_saved = self.elapsed
                origin += time.perf_counter() - paused
        net = self.averaged()
        if self.complete and rank() == 0:
            save_weights(net, self.weights_path)
        return net

    @property
    def weights_path(self) -> Path:
        """Where a complete run's weights lie."""
        return self.out / f"{self.options.preset}.safetensors"

    def train_step(self, progress: float) -> dict[str, Tensor]:
        """One optimiser step at a progress of the whole run (0 to 1): its loss and figures.

        They are this process's parts of the joint ones, still on the device.
        """
        stage, within = self.options.schedule.at(progress)
        if stage != self.stage:
            self.net.load_state_dict(self.averaged().state_dict())
            self._enter(stage)
        self._learning_rate = self.options.rate * learning_rate(STAGES[stage], within)
        for group in self._optimizer.param_groups:
            group["lr"] = self._learning_rate * group.get("share", 1.0)
        began = self._meter.mark()
        pairs = self._make_pairs(progress)
        made = self._meter.mark()
        with _convolving(self.device):
            loss, figures = self._loss(pairs, within)
            self._optimizer.zero_grad(set_to_none=True)
            # Gradients are averaged over the processes, and the loss is the sum of their parts.
            (loss * process_count()).backward()
        norm = torch.nn.utils.clip_grad_norm_(self.parameters, _LARGEST_GRADIENT)
        self._optimizer.step()
        self._average.update(self._module)
        self.step += 1
        figures = {"loss": loss.detach(), "gradient": norm / process_count(), **figures}
        self._meter.add(self._batch(stage), (began, made, self._meter.mark()), figures)
        return figures

    def validate(self) -> dict[str, float]:
        """Figures of the averaged weights on the held-back photographs, each named `val_...`."""
        module = self._average.module
        if isinstance(module, CoarsestStage):
            return {f"val_{k}": v for k, v in validate(module.net, self._validation).items()}
        draws = Draws(seeded("validation"), self.device)
        with torch.no_grad():
            rows = [module(pairs, draws)[1] for pairs in self._validation]
        # The same pairs in every process, so that none waits in vain for the others' counts.
        sums = {key: torch.stack([row[key] for row in rows]).mean() for key in rows[0]}
        return {f"val_{key}": float(joint_sum(value)) for key, value in sums.items()}

    def averaged(self) -> DGCNet:
        """A copy of the network by the averaged weights of the stage."""
        module = self._average.module
        if isinstance(module, CoarsestStage):
            return deepcopy(module.net)
        net = deepcopy(self.net)
        module.write(net)
        return net

    def save(self) -> None:
        """Write the checkpoint: to a temporary file first, so that a kill leaves a whole one."""
        if rank() > 0:
            return
        temporary = self.out / (CHECKPOINT + ".part")
        torch.save(self.state(), temporary)
        os.replace(temporary, self.out / CHECKPOINT)

    def state(self) -> dict[str, Any]:
        """Everything that a resumed run needs, as tensors and plain values.

        The decoders' stages hold the whole network; in the encoder's, all but the encoder is as
        the seed, or the weights to start from, made it.
        """
        return {
            "preset": self.options.preset,
            "options": asdict(self.options),
            "elapsed": self.elapsed,
            "step": self.step,
            "stage": self.stage,
            "module": self._module.state_dict(),
            "average": self._average.state_dict(),
            "optimizer": self._optimizer.state_dict(),
        }

    def _load(self, path: Path) -> None:
        state = expanded(load_checkpoint(path, self.device))
        if state["preset"] != self.options.preset:
            raise WeightsError(
                f"{path}: a run of preset {state['preset']}, not {self.options.preset}"
            )
        try:
            self._enter(state["stage"])
            self._module.load_state_dict(state["module"])
            if "average" in state:
                self._average.load_state_dict(state["average"])
            else:
                self._average = MovingAverage(self._module, self.options.average_decay)
            self._optimizer.load_state_dict(state["optimizer"])
        except (RuntimeError, ValueError) as error:
            raise WeightsError(
                f"{path}: its weights do not fit the present {self.options.preset}"
            ) from error
        self.elapsed, self.step = state["elapsed"], state["step"]

    def _enter(self, stage: StageName) -> None:
        self.stage = stage
        options = STAGES[stage]
        if stage == "encoder":
            self._module = EncoderStage(self.net).to(self.device)
            if self.options.init is not None:
                take_up(self.net, self._module, normalise(self._validation[0].image1))
            self.parameters = [p for p in self._module.parameters() if p.requires_grad]
        else:
            if stage == "coarsest":
                self._module = CoarsestStage(self.net, self.options.thaw or "coarsest")
            else:
                self._module = DecoderStage(
                    self.net, end_to_end=stage == "polish", thawed=self.options.thaw
                )
            self.parameters = self._module.trainable()
        self._module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._module.train()
        self._shared: nn.Module = self._module
        if process_count() > 1:
            join_batch_norms(self._module)
            self._shared = DistributedDataParallel(self._module)
        self._optimizer = torch.optim.AdamW(
            rate_groups(self._module),
            lr=options.learning_rate,
            weight_decay=options.weight_decay,
        )
        self._average = MovingAverage(self._module, self.options.average_decay)

    def _batch(self, stage: StageName) -> int:
        options = STAGES[stage]
        own = options.gpu_batch if self.device.type == "cuda" else options.batch
        return self.options.batch or own

    def _share_out(self) -> None:
        """Raise InputError where a stage's batch does not divide into equal parts."""
        parts = self.options.parts or process_count()
        if parts % process_count():
            raise InputError(f"{process_count()} processes cannot share {parts} parts of a batch")
        for stage in STAGES:
            if self._batch(stage) % parts:
                raise InputError(f"{self._batch(stage)} pairs do not divide into {parts} parts")

    def _make_pairs(self, progress: float) -> TrainingPairs:
        """This process's pairs of the step."""
        assert self.stage is not None
        options = self.options.pairs
        if self.options.curriculum is not None:
            options = self.options.curriculum.at(progress, options)
        parts = self.options.parts or process_count()
        each, own = self._batch(self.stage) // parts, parts // process_count()
        size = STAGES[self.stage].size
        made = []
        for part in range(rank() * own, (rank() + 1) * own):
            generator = seeded(self.options.seed, self.step, "pairs", part)
            made.append(make_pairs(self.photos, each, size, generator, options, self.real))
        return made[0] if own == 1 else TrainingPairs.joined(made)

    def _loss(self, pairs: TrainingPairs, within: float) -> tuple[Tensor, dict[str, Tensor]]:
        draws = Draws(seeded(self.options.seed, self.step, "stage"), self.device)
        if not isinstance(self._module, DecoderStage):
            result: tuple[Tensor, dict[str, Tensor]] = self._shared(pairs, draws)
            return result
        noise_share = 0.0 if self.stage == "polish" else max(0.1, 0.6 * (1 - 2 * within))
        lesson = None
        if self._teacher is not None:
            pairs, lesson = self._teacher.teach(pairs)
        result = self._shared(pairs, draws, noise_share, lesson)
        return result

    def _row(self) -> Row:
        """Raises DgcPoseError where a step has gone wrong, before anything of it is saved."""
        row = self._whole_row()
        if not (math.isfinite(row["loss"]) and math.isfinite(row["gradient"])):
            raise DgcPoseError(
                f"{self.out}: the loss or its gradient is no number at step {self.step} of the "
                f"{self.stage} stage; the checkpoint is from before"
            )
        return row

    def _whole_row(self) -> Row:
        return {
            "step": self.step,
            "stage": self.stage,
            "minutes": self.elapsed / 60,
            "rate": self._learning_rate,
            **self._meter.row(),
        }


def _convolving(device: torch.device) -> AbstractContextManager[None]:
    """cuDNN free to choose for the network's shapes, which stay the same from step to step.

    TF32 for its convolutions only: matrix products make places, which need all their digits.
    """
    if device.type != "cuda":
        return nullcontext()
    context: AbstractContextManager[None] = torch.backends.cudnn.flags(
        enabled=True, benchmark=True, allow_tf32=True
    )
    return context
