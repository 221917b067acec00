"""A training run: stages by the clock, checkpoints that a killed run resumes from, a log."""

import json
import math
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save
from torch import Tensor, nn

from dgc_pose.errors import ArgumentName, DgcPoseError, InputError, WeightsError
from dgc_pose.files.outputs import replaced, write_text, writing
from dgc_pose.network.config import INPUT_SIZE
from dgc_pose.network.net import DGCNet
from dgc_pose.network.stored import COUNTER
from dgc_pose.network.weights import load_checkpoint
from dgc_pose.training.active_stage import ActiveStage
from dgc_pose.training.card import card
from dgc_pose.training.data import TRAINING
from dgc_pose.training.draw import Draw
from dgc_pose.training.initialise import initialise_encoder, initialise_from
from dgc_pose.training.map_pairs import MapPairs
from dgc_pose.training.options import TrainingOptions
from dgc_pose.training.pairs import PairSource
from dgc_pose.training.stages import SHAPES, StageName
from dgc_pose.training.views import Shape

CHECKPOINT, LOG, DEPTHS = "checkpoint.pt", "log.jsonl", "depths.pt"
_SQUARE = (INPUT_SIZE, INPUT_SIZE)
_STEPS_A_ROW = 10  # of the log; between rows nothing is read from a GPU
_BATCH = 4  # pairs of 240x240 pixels a step, on a CPU
_GPU_BATCH: dict[StageName, int] = {"encoder": 84, "decoders": 64}
_VALIDATION_BATCH = 8
_HALF_MAX = torch.finfo(torch.float16).max

Row = dict[str, Any]


class Trainer:
    """Trains one network by `TrainingOptions`, in the folder `out`.

    `out` then holds checkpoint.pt (everything a resumed run needs), the figures as log.jsonl and,
    at the end, `<network>.safetensors` with its card, `<network>.md`. data: see `load_data`; on
    `device`. Raises InputError if `out` already holds a run and `resume` is False; WeightsError if
    a checkpoint belongs to another network, or weights to initialise from are unusable.
    """

    def __init__(
        self,
        data: Mapping[str, PairSource],
        out: str | Path,
        options: TrainingOptions,
        device: torch.device | str = "cpu",
        resume: bool = False,
    ) -> None:
        self.options, self.out, self.data = options, Path(out), data
        path = self.out / CHECKPOINT
        if path.exists() and not resume:
            raise InputError(f"{path} exists already:", ArgumentName("resume"), "continues it")
        if self.weights_path.exists() and not path.exists():
            raise InputError(f"{self.weights_path} exists already, and is of no run in this folder")
        self.device = torch.device(device)
        torch.manual_seed(options.seed)
        net = DGCNet(options.config)
        if options.init is not None:
            initialise_from(options.init, net)
        if options.encoder is not None:
            initialise_encoder(options.encoder, net)
        net.to(self.device).half_precision = options.half_precision or self.device.type == "cuda"
        self._validation = {
            name: self._validation_pairs(name, source)
            for name, source in data.items()
            if name != TRAINING
        }
        self.out.mkdir(parents=True, exist_ok=True)
        self.elapsed = 0.0  # seconds of the run, over all its sessions
        self.step = 0
        self.stages: dict[str, Row] = {}  # of those begun: steps, pairs, seconds and figures
        self._stage = self._enter(self._place(0.0)[0], net)
        if path.exists():
            self._load(path, net)

    @property
    def complete(self) -> bool:
        return self.progress >= 1

    @property
    def progress(self) -> float:
        """The share of the whole run that is done, 0 to 1."""
        if self.options.seconds is None:
            assert self.options.steps is not None
            return self.step / self.options.steps
        return self.elapsed / self.options.seconds

    @property
    def parameters(self) -> list[nn.Parameter]:
        """Those that the present stage trains."""
        return self._stage.parameters

    @property
    def weights_path(self) -> Path:
        """The file of a complete run's weights."""
        return self.out / f"{self.options.network}.safetensors"

    def run(self, seconds: float | None = None) -> DGCNet:
        """Train to the end of the run, or for so many `seconds` more of it.

        A line of progress goes to standard error every few steps. Returns the network by its
        averaged weights, and writes them and their card if the run is complete. Raises DgcPoseError
        if training has diverged.
        """
        end = math.inf if seconds is None else self.elapsed + seconds
        last_saved = last_validated = last_row = self.elapsed
        origin, pairs = time.perf_counter() - self.elapsed, 0
        if self.step == 0 and self.options.init is not None:
            # The first steps may spoil what later ones regain.
            self._write({"stage": self._stage.name, "step": 0, "seconds": 0.0} | self.validate())
        while not self.complete and self.elapsed < end:
            figures, count = self.train_step()
            pairs += count
            before, self.elapsed = self.elapsed, time.perf_counter() - origin
            stage = self.stages[self._stage.name]
            stage["seconds"] += self.elapsed - before
            changes = self._place(self.progress)[0] != self._stage.name
            done = self.complete or self.elapsed >= end
            validates = done or changes
            validates |= self.elapsed - last_validated > self.options.validate_seconds
            if validates or self.step % _STEPS_A_ROW == 0:
                row = self._row(figures, pairs / max(self.elapsed - last_row, 1e-9))
                if validates:
                    row |= self.validate()
                    last_validated = self.elapsed
                self._write(row)
                pairs, last_row = 0, time.perf_counter() - origin
                if done or self.elapsed - last_saved > self.options.save_seconds:
                    self.save()
                    last_saved = self.elapsed
        net = self._stage.average.finished()
        if self.complete:
            save_weights(net, self.weights_path)
            text = card(self.options, self.data, self.device, self.stages)
            write_text(self.weights_path.with_suffix(".md"), text)
        return net

    def train_step(self) -> tuple[dict[str, Tensor], int]:
        """One optimiser step: its loss and figures, still on the device, and its pairs."""
        name, within = self._place(self.progress)
        if name != self._stage.name:
            self._stage = self._enter(name, self._stage.average.finished())
        self._learning_rate = self._stage.set_rate(within)
        draw = Draw(self.device, self.options.seed, name, self.step)
        shapes = SHAPES[name] if self.options.config.any_shape else (_SQUARE,)
        shape = shapes[self.step % len(shapes)]
        usual = _GPU_BATCH[name] if self.device.type == "cuda" else _BATCH
        batch = self.options.batch or usual
        count = max(1, batch * INPUT_SIZE**2 // (shape[0] * shape[1]))
        pairs = self.data[TRAINING].make(count, shape, draw)
        loss, figures = self._stage.module(pairs, draw, within)
        norm = self._stage.step(loss)
        self.step += 1
        self.stages[name]["steps"] += 1
        self.stages[name]["pairs"] += count
        return {"loss": loss.detach(), "gradient": norm, **figures}, count

    @torch.no_grad()
    def validate(self) -> Row:
        """Figures of the averaged weights, as `validation`, by what validates."""
        module, result = self._stage.average, {}
        for kind, batches in self._validation.items():
            draw = Draw(self.device, "validation")
            rows = [module(pairs, draw, 1.0)[1] for pairs in batches]
            result[kind] = {
                key: float(torch.stack([r[key] for r in rows]).mean()) for key in rows[0]
            }
        self.stages[self._stage.name]["figures"] = result
        return {"validation": result}

    def save(self) -> None:
        """Write the checkpoint, as tensors and plain values."""
        state = {
            "preset": self.options.network,
            "elapsed": self.elapsed,
            "step": self.step,
            "stages": self.stages,
            "stage": self._stage.name,
            **self._stage.state_dict(),
        }
        with replaced(self.out / CHECKPOINT) as temporary, writing(temporary):
            torch.save(state, temporary)

    def _load(self, path: Path, net: DGCNet) -> None:
        state = load_checkpoint(path, self.device)
        network = self.options.network
        if not isinstance(state, dict) or "preset" not in state:
            raise WeightsError(f"{path}: not the checkpoint of a run")
        if state["preset"] != network:
            raise WeightsError(f"{path}: a run of preset {state['preset']}, not {network}")
        try:
            self._stage = self._enter(state["stage"], net)
            self._stage.load_state_dict(state)
            self.elapsed, self.step = float(state["elapsed"]), int(state["step"])
            self.stages = dict(state["stages"])
        except (RuntimeError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise WeightsError(f"{path}: its weights do not fit the present {network}") from error

    def _enter(self, stage: StageName, net: DGCNet) -> ActiveStage:
        self.stages[stage] = {"steps": 0, "pairs": 0, "seconds": 0.0, "figures": {}}
        return ActiveStage(stage, net, self.options)

    def _place(self, progress: float) -> tuple[StageName, float]:
        """The stage at a run's progress (0 to 1) and the progress within that stage."""
        share = self.options.encoder_share if self.options.config.any_shape else 0.0
        if progress < share or share == 1:
            return "encoder", progress / share
        return "decoders", (progress - share) / (1 - share)

    def _validation_pairs(self, name: str, source: PairSource) -> list[MapPairs]:
        """The same pairs for every run."""
        draw = Draw(self.device, "validation", name)
        shape: Shape = (208, 272) if name == "posed" and self.options.config.any_shape else _SQUARE
        batch = min(_VALIDATION_BATCH, self.options.validation_count)
        batches = range(self.options.validation_count // batch)
        return [source.make(batch, shape, draw) for _ in batches]

    def _write(self, row: Row) -> None:
        print(progress_line(row), file=sys.stderr, flush=True)
        path = self.out / LOG
        with writing(path), path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")

    def _row(self, figures: dict[str, Tensor], pairs_per_second: float) -> Row:
        """Raises DgcPoseError if a step has diverged, before anything of it is saved."""
        stage = self._stage.name
        row: Row = {
            "stage": stage,
            "step": self.step,
            "seconds": self.elapsed,
            "rate": self._learning_rate,
            "pairs_per_second": pairs_per_second,
            **{name: float(value) for name, value in figures.items()},
        }
        if not (math.isfinite(row["loss"]) and math.isfinite(row["gradient"])):
            raise DgcPoseError(
                f"{self.out}: the loss or its gradient is no number at step {self.step} of the "
                f"{stage} stage; the checkpoint is from before"
            )
        return row


def progress_line(row: Row) -> str:
    """A row of the log for people."""
    figures = {k: v for k, v in row.items() if k.startswith(("loss", "found", "agreed", "epe"))}
    text = f"{row['seconds']:7.0f} s  {row['stage']:8s} step {row['step']:6d}"
    if figures:
        text += f"  {row['pairs_per_second']:.1f} pairs/s  " + _joined(figures)
    for kind, validated in row.get("validation", {}).items():
        text += f"\n    validation, {kind}:  " + _joined(validated)
    return text


def _joined(figures: Mapping[str, float]) -> str:
    return "  ".join(f"{name} {value:.3f}" for name, value in figures.items())


def save_weights(net: DGCNet, path: str | Path) -> None:
    """Write a network as safetensors, its preset's name in the header, in half precision.

    The statistics of batch norms are in single precision, as is what half precision cannot hold: a
    variance may lie beyond its range.
    """
    state = {}
    for key, value in net.state_dict().items():
        if not key.endswith(COUNTER):
            value = value.detach().cpu().float().contiguous()
            fits = "running_" not in key and bool(value.abs().max() < _HALF_MAX)
            state[key] = value.half() if fits else value
    header = {"preset": net.config.name}
    with replaced(Path(path)) as temporary, writing(temporary):
        # Not save_file, whose files only their owner may read.
        temporary.write_bytes(save(state, metadata=header))
