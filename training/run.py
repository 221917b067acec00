"""A training run: stages by the clock, checkpoints that a killed run resumes from, a log."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch
from safetensors.torch import save
from torch import Tensor, nn

from dgc_pose.errors import ArgumentName, DgcPoseError, InputError, WeightsError
from dgc_pose.files.outputs import replaced, writing
from dgc_pose.network.net import DGCNet, normalise
from dgc_pose.network.stored import COUNTER
from dgc_pose.network.weights import load_checkpoint
from dgc_pose.training.active_stage import ActiveStage
from dgc_pose.training.initialise import initialise_encoder, initialise_from
from dgc_pose.training.log import Row, append
from dgc_pose.training.options import TrainingOptions
from dgc_pose.training.schedule import STAGES, StageName
from dgc_pose.training.stages import DecoderStage, EncoderStage, Loss
from dgc_pose.training.synthesis.depth_scenes import DepthScenes
from dgc_pose.training.synthesis.draw import Draw, seeded
from dgc_pose.training.synthesis.map_pairs import MapPairs
from dgc_pose.training.synthesis.photos import Photos
from dgc_pose.training.synthesis.random_pairs import make_pairs
from dgc_pose.training.validation import validate, validation_pairs

CHECKPOINT = "checkpoint.pt"
_STEPS_A_ROW = 10  # of the log; between rows nothing is read from a GPU

Report = Callable[[Row], None]


class Trainer:
    """Trains one network by `TrainingOptions`, in the folder `out`.

    `out` then holds checkpoint.pt (everything a resumed run needs), for each stage the logs
    `<stage>_steps_log.csv` and `<stage>_validation_log.csv` and, at the end,
    `<network>.safetensors`; with weights to initialise from, `initial_validation_log.csv` has the
    figures before the first step. Raises InputError if `out` already holds a run and `resume` is
    False; WeightsError if a checkpoint belongs to another network, or weights to initialise from
    are unusable.
    """

    def __init__(
        self,
        photos: tuple[Photos, Photos],
        out: str | Path,
        options: TrainingOptions,
        real: DepthScenes | None = None,
        device: torch.device | str = "cpu",
        resume: bool = False,
    ) -> None:
        self.options = options
        self.out = Path(out)
        path = self.out / CHECKPOINT
        if path.exists() and not resume:
            raise InputError(f"{path} exists already:", ArgumentName("resume"), "continues it")
        if self.weights_path.exists() and not path.exists():
            raise InputError(f"{self.weights_path} exists already, and is of no run in this folder")
        self.device = torch.device(device)
        torch.manual_seed(options.seed)
        self.net = DGCNet(options.config)
        if options.init is not None:
            initialise_from(options.init, self.net, options.init_part)
        self.net.to(self.device).half_precision = options.half_precision
        self.photos, held_back = (p.to(self.device) for p in photos)
        self.real = None if real is None else real.to(self.device)
        self._validation = validation_pairs(
            held_back,
            options.validation_count,
            min(8, options.validation_count),
            replace(options.pairs, real_share=0.0),
        )
        if options.encoder is not None:
            initialise_encoder(options.encoder, self.net, normalise(self._validation[0].image1))
        self.out.mkdir(parents=True, exist_ok=True)
        self.elapsed = 0.0  # seconds trained, over all sessions of the run
        self.step = 0
        self._stage = self._enter(options.stages.at(0.0)[0])
        if path.exists():
            self._load(path)

    @property
    def complete(self) -> bool:
        return self.progress >= 1

    @property
    def progress(self) -> float:
        """The share of the whole run that is done, 0 to 1."""
        if self.options.minutes is None:
            assert self.options.steps is not None
            return self.step / self.options.steps
        return self.elapsed / (60 * self.options.minutes)

    @property
    def parameters(self) -> list[nn.Parameter]:
        """Those that the present stage trains."""
        return self._stage.parameters

    @property
    def weights_path(self) -> Path:
        """The file of a complete run's weights."""
        return self.out / f"{self.options.network}.safetensors"

    def run(self, report: Report = lambda row: None, minutes: float | None = None) -> DGCNet:
        """Train to the end of the run, or for so many `minutes` more of it.

        `report` gets a row every few steps. Returns the network by its averaged weights, and writes
        them if the run is complete. Raises DgcPoseError if training has diverged.
        """
        end = math.inf if minutes is None else self.elapsed + 60 * minutes
        last_saved = last_validated = last_row = self.elapsed
        pairs = 0  # since the last row
        if self.step == 0 and self.options.init is not None:
            self._report_initial(report)
        origin = time.perf_counter() - self.elapsed
        while not self.complete and self.elapsed < end:
            figures = self.train_step(self.progress)
            pairs += self._batch(self._stage.name)
            self.elapsed = time.perf_counter() - origin
            done = self.complete or self.elapsed >= end
            validates = done or self.elapsed - last_validated > 60 * self.options.validate_minutes
            if validates or self.step % _STEPS_A_ROW == 0:
                row = self._row(figures, pairs / max(self.elapsed - last_row, 1e-9))
                pairs, last_row = 0, self.elapsed
                paused = time.perf_counter()
                if validates:
                    row |= self.validate()
                    last_validated = self.elapsed
                report(row)
                kind = "validation" if validates else "steps"
                append(self.out / f"{self._stage.name}_{kind}_log.csv", row)
                if done or self.elapsed - last_saved > 60 * self.options.save_minutes:
                    self.save()
                    last_saved = self.elapsed
                origin += time.perf_counter() - paused
        net = self.averaged()
        if self.complete:
            save_weights(net, self.weights_path)
        return net

    def train_step(self, progress: float) -> dict[str, Tensor]:
        """One optimiser step at a progress of the whole run (0 to 1): its loss and figures, still
        on the device."""
        name, within = self.options.stages.at(progress)
        if name != self._stage.name:
            self.net.load_state_dict(self.averaged().state_dict())
            self._stage = self._enter(name)
        self._learning_rate = self._stage.set_rate(within)
        pairs = self._make_pairs()
        # On a GPU cuDNN tries its algorithms, as shapes stay the same from step to step. TF32 for
        # convolutions only: coordinates come from matrix products and need all their digits.
        with torch.backends.cudnn.flags(enabled=True, benchmark=True, allow_tf32=True):
            loss, figures = self._loss(pairs, within)
            norm = self._stage.step(loss)
        self.step += 1
        return {"loss": loss.detach(), "gradient": norm, **figures}

    def validate(self) -> dict[str, float]:
        """Figures of the averaged weights on the held-back photographs, each named `val_...`."""
        module = self._stage.average
        if not isinstance(module, EncoderStage):
            figures = validate(module.net, self._validation)
        else:
            draw = Draw(seeded("validation"), self.device)
            with torch.no_grad():
                rows = [module(pairs, draw)[1] for pairs in self._validation]
            figures = {key: float(torch.stack([r[key] for r in rows]).mean()) for key in rows[0]}
        return {f"val_{key}": value for key, value in figures.items()}

    def averaged(self) -> DGCNet:
        """A copy of the network by the averaged weights of the stage."""
        return self._stage.averaged()

    def save(self) -> None:
        """Write the checkpoint, as tensors and plain values.

        The decoders' stages hold the whole network. In the encoder's, everything else is as
        the seed, or the weights to initialise from, made it.
        """
        state = {
            "preset": self.options.network,
            "elapsed": self.elapsed,
            "step": self.step,
            "stage": self._stage.name,
            **self._stage.state_dict(),
        }
        with replaced(self.out / CHECKPOINT) as temporary, writing(temporary):
            torch.save(state, temporary)

    def _load(self, path: Path) -> None:
        state = load_checkpoint(path, self.device)
        network = self.options.network
        if not isinstance(state, dict) or "preset" not in state:
            raise WeightsError(f"{path}: not the checkpoint of a run")
        if state["preset"] != network:
            raise WeightsError(f"{path}: a run of preset {state['preset']}, not {network}")
        try:
            self._stage = self._enter(state["stage"])
            self._stage.load_state_dict(state)
            self.elapsed, self.step = float(state["elapsed"]), int(state["step"])
        except (RuntimeError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise WeightsError(f"{path}: its weights do not fit the present {network}") from error

    def _enter(self, stage: StageName) -> ActiveStage:
        return ActiveStage(stage, self.net, self.options)

    def _batch(self, stage: StageName) -> int:
        """Pairs a step."""
        settings = STAGES[stage]
        default = settings.gpu_batch if self.device.type == "cuda" else settings.batch
        return self.options.batch or default

    def _make_pairs(self) -> MapPairs:
        stage = self._stage.name
        generator = seeded(self.options.seed, self.step, "pairs")
        options = self.options.pairs
        size = STAGES[stage].size
        return make_pairs(self.photos, self._batch(stage), size, generator, options, self.real)

    def _loss(self, pairs: MapPairs, within: float) -> Loss:
        draw = Draw(seeded(self.options.seed, self.step, "stage"), self.device)
        options = []
        if isinstance(self._stage.module, DecoderStage):
            share = 0.0 if self._stage.module.end_to_end else max(0.1, 0.6 * (1 - 2 * within))
            options.append(share)
        result: Loss = self._stage.module(pairs, draw, *options)
        return result

    def _report_initial(self, report: Report) -> None:
        """The figures of the weights given: the first steps may spoil what later ones regain."""
        row = {"step": 0, "stage": self._stage.name, "minutes": 0.0, **self.validate()}
        report(row)
        append(self.out / "initial_validation_log.csv", row)

    def _row(self, figures: dict[str, Tensor], pairs_per_second: float) -> Row:
        """Raises DgcPoseError if a step has diverged, before anything of it is saved."""
        stage = self._stage.name
        row: Row = {
            "step": self.step,
            "stage": stage,
            "minutes": self.elapsed / 60,
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


def save_weights(net: DGCNet, path: str | Path) -> None:
    """Write a network as safetensors in half precision, its preset's name in the header."""
    state = {
        key: value.detach().cpu().half().contiguous()
        for key, value in net.state_dict().items()
        if not key.endswith(COUNTER)
    }
    header = {"preset": net.config.name}
    with replaced(Path(path)) as temporary, writing(temporary):
        # Not save_file, whose files only their owner may read.
        temporary.write_bytes(save(state, metadata=header))
