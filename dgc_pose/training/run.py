"""A training run: stages by the clock, a checkpoint that survives a kill, a log."""

from __future__ import annotations

import csv
import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from dgc_pose.errors import InputError, WeightsError
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import load_checkpoint, save_weights
from dgc_pose.training.pairs import PairOptions, TrainingPairs, make_pairs
from dgc_pose.training.photos import Photos
from dgc_pose.training.schedule import STAGES, Schedule, StageName, learning_rate
from dgc_pose.training.stages import DecoderStage, EncoderStage
from dgc_pose.training.validation import validate, validation_pairs

CHECKPOINT = "checkpoint.pt"


@dataclass(frozen=True)
class RunOptions:
    """What a run trains, for how long, and how often it looks and saves."""

    preset: str
    minutes: float  # of training; the schedule is complete after them
    seed: int = 0
    schedule: Schedule = field(default_factory=Schedule)
    pairs: PairOptions = field(default_factory=PairOptions)
    validation_count: int = 64  # pairs
    validate_minutes: float = 5.0  # between validations
    save_minutes: float = 1.0  # between checkpoints
    batch: int | None = None  # pairs; None: the stage's own

    def __post_init__(self) -> None:
        preset(self.preset)
        if not self.minutes > 0:
            raise InputError(f"minutes must be positive, not {self.minutes}")


Report = Callable[[dict[str, Any]], None]


class Trainer:
    """Trains one network as `RunOptions` say, in the folder `out`.

    `out` then holds checkpoint.pt (everything a resumed run needs), for each stage the logs
    `<stage>_steps_log.csv` and `<stage>_validation_log.csv` and, at the end,
    `<preset>.safetensors`. Raises InputError where `out` already holds a run and `resume` is
    False, WeightsError where a checkpoint belongs to another preset.
    """

    def __init__(
        self,
        photos: tuple[Photos, Photos],
        out: str | Path,
        options: RunOptions,
        *,
        device: torch.device | str = "cpu",
        resume: bool = False,
    ) -> None:
        self.options = options
        self.out = Path(out)
        self.out.mkdir(parents=True, exist_ok=True)
        path = self.out / CHECKPOINT
        if path.exists() and not resume:
            raise InputError(f"{path} is there already: --resume goes on with it")
        self.device = torch.device(device)
        self.photos, held_back = (p.to(self.device) for p in photos)
        self.elapsed = 0.0  # seconds trained, over all sessions of the run
        self.step = 0
        self.stage: StageName | None = None
        self._validation = validation_pairs(
            held_back, options.validation_count, min(8, options.validation_count), options.pairs
        )
        torch.manual_seed(options.seed)
        self.generator = torch.Generator().manual_seed(options.seed)
        self.net = DGCNet(preset(options.preset)).to(self.device)
        self._enter("encoder" if options.schedule.encoder > 0 else "decoders")
        if path.exists():
            self._load(path)

    def run(self, report: Report = lambda row: None) -> DGCNet:
        """Train until the minutes are spent. `report` gets a row after each step."""
        last_saved = last_validated = self.elapsed
        budget = 60 * self.options.minutes
        while self.elapsed < budget:
            started = time.perf_counter()
            row = self.train_step(self.elapsed / budget)
            self.elapsed += time.perf_counter() - started
            row |= {
                "minutes": self.elapsed / 60,
                "pairs_per_second": row.pop("pairs") / row["seconds"],
            }
            done = self.elapsed >= budget
            if done or self.elapsed - last_validated > 60 * self.options.validate_minutes:
                row |= self.validate()
                last_validated = self.elapsed
            report(row)
            self._log(row)
            if done or self.elapsed - last_saved > 60 * self.options.save_minutes:
                self.save()
                last_saved = self.elapsed
        self.export()
        return self.net

    def train_step(self, progress: float) -> dict[str, Any]:
        """One optimiser step at a progress of the whole run (0 to 1): its figures."""
        started = time.perf_counter()
        stage, within = self.options.schedule.at(progress)
        if stage != self.stage:
            self._leave()
            self._enter(stage)
        stage_options = STAGES[stage]
        rate = learning_rate(stage_options, within)
        for group in self._optimizer.param_groups:
            group["lr"] = rate
        batch = self.options.batch or stage_options.batch
        size = stage_options.size
        pairs = make_pairs(self.photos, batch, size, self.generator, self.options.pairs)
        made = time.perf_counter()
        loss, figures = self._loss(pairs, within)
        self._optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self._parameters, 5.0)
        self._optimizer.step()
        self.step += 1
        now = time.perf_counter()
        return {
            "step": self.step,
            "stage": stage,
            "rate": rate,
            "loss": float(loss.detach()),
            "pairs": batch,
            "seconds": now - started,
            "seconds_making_pairs": made - started,
            **figures,
        }

    def validate(self) -> dict[str, float]:
        """Figures on the held-back photographs, each named `val_...`."""
        if isinstance(self._module, EncoderStage):
            generator = torch.Generator().manual_seed(0)
            self._module.eval()
            with torch.no_grad():
                rows = [self._module.loss(pairs, generator)[1] for pairs in self._validation]
            self._module.train()
            return {f"val_{k}": sum(r[k] for r in rows) / len(rows) for k in rows[0]}
        return {f"val_{k}": v for k, v in validate(self.net, self._validation).items()}

    def export(self) -> Path:
        """Write the network's weights, half precision, beside the checkpoint."""
        self._leave()
        path = self.out / f"{self.options.preset}.safetensors"
        save_weights(self.net, path)
        return path

    def save(self) -> None:
        """Write the checkpoint: to a temporary file first, so that a kill leaves a whole one."""
        state = {
            "preset": self.options.preset,
            "options": asdict(self.options),
            "elapsed": self.elapsed,
            "step": self.step,
            "stage": self.stage,
            "net": self.net.state_dict(),
            "module": self._module.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "generator": self.generator.get_state(),
        }
        temporary = self.out / (CHECKPOINT + ".part")
        torch.save(state, temporary)
        os.replace(temporary, self.out / CHECKPOINT)

    def _load(self, path: Path) -> None:
        state = load_checkpoint(path, self.device)
        if state["preset"] != self.options.preset:
            raise WeightsError(
                f"{path}: a run of preset {state['preset']}, not {self.options.preset}"
            )
        self.net.load_state_dict(state["net"])
        self._enter(state["stage"])
        self._module.load_state_dict(state["module"])
        self._optimizer.load_state_dict(state["optimizer"])
        self.generator.set_state(state["generator"].cpu())
        self.elapsed, self.step = state["elapsed"], state["step"]

    def _enter(self, stage: StageName) -> None:
        self.stage = stage
        options = STAGES[stage]
        self._module: EncoderStage | DecoderStage
        if stage == "encoder":
            self._module = EncoderStage(self.net).to(self.device)
            self._parameters = list(self._module.parameters())
        else:
            self._module = DecoderStage(self.net, end_to_end=stage == "polish")
            self._parameters = self._module.trainable()
        self._module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._module.train()
        self._optimizer = torch.optim.AdamW(
            self._parameters, lr=options.learning_rate, weight_decay=options.weight_decay
        )

    def _leave(self) -> None:
        """Put what the stage has trained beside the network into the network."""
        if isinstance(self._module, EncoderStage):
            self._module.write(self.net)

    def _loss(self, pairs: TrainingPairs, within: float) -> tuple[Tensor, dict[str, float]]:
        if isinstance(self._module, EncoderStage):
            return self._module.loss(pairs, self.generator)
        noise_share = 0.0 if self.stage == "polish" else max(0.1, 0.6 * (1 - 2 * within))
        return self._module.loss(pairs, self.generator, noise_share)

    def _log(self, row: dict[str, Any]) -> None:
        """Append a row; a file a stage, since each stage has columns of its own."""
        validated = any(key.startswith("val_") for key in row)
        if not validated and self.step % 10:
            return
        kind = "validation" if validated else "steps"
        path = self.out / f"{self.stage}_{kind}_log.csv"
        is_new = not path.exists()
        with path.open("a", newline="") as file:
            writer = csv.DictWriter(file, fieldnames=list(row))
            if is_new:
                writer.writeheader()
            writer.writerow(row)
