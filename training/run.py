"""A training run: stages by the clock, checkpoints that a killed run resumes from, a log."""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path

import torch
from torch import Tensor, nn

from dgc_pose.errors import DgcPoseError, InputError, WeightsError
from dgc_pose.files.outputs import replaced, writing
from dgc_pose.network.config import INPUT_SIZE
from dgc_pose.network.correspondence_net import CorrespondenceNet
from dgc_pose.network.net import DGCNet, normalise
from dgc_pose.network.weights import build_network, load_checkpoint, load_network, save_weights
from dgc_pose.training.active_stage import ActiveStage
from dgc_pose.training.decoder_fit import fit_decoders
from dgc_pose.training.initialise import initialise_encoder, initialise_from
from dgc_pose.training.log import Meter, Row, append
from dgc_pose.training.options import TrainingOptions
from dgc_pose.training.processes import from_first, joint_sum, process_count, rank
from dgc_pose.training.schedule import STAGES, StageName
from dgc_pose.training.stages import DecoderStage, EncoderStage, Loss
from dgc_pose.training.synthesis.depth_scenes import DepthScenes
from dgc_pose.training.synthesis.draw import Draw, seeded
from dgc_pose.training.synthesis.map_pairs import MapPairs
from dgc_pose.training.synthesis.photos import Photos
from dgc_pose.training.synthesis.random_pairs import make_pairs
from dgc_pose.training.validation import validate, validation_pairs

CHECKPOINT = "checkpoint.pt"
_STATE = {"preset": str, "elapsed": float, "step": int, "stage": str}  # of a checkpoint, its types
_FITTING_BATCHES = 24  # of 4 pairs, for the least squares of `fit_decoders`
_STEPS_A_ROW = 10  # of the log; between rows nothing is read from a GPU

Report = Callable[[Row], None]


class Trainer:
    """Trains one network by `TrainingOptions`, in the folder `out`.

    `out` then holds checkpoint.pt (everything a resumed run needs), for each stage the logs
    `<stage>_steps_log.csv` and `<stage>_validation_log.csv` and, at the end,
    `<network>.safetensors`; with weights to initialise from, `initial_validation_log.csv` has the
    figures before the first step. Raises InputError if `out` already holds a run and `resume` is
    False, or the processes cannot share a batch evenly; WeightsError if a checkpoint belongs to
    another network, or weights to initialise from are unusable.

    If torchrun started several processes, each trains on its part of every batch; only the first
    writes and reports.
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
            raise InputError(f"{path} exists already: --resume continues it")
        if self.weights_path.exists() and not path.exists():
            raise InputError(f"{self.weights_path} exists already, and is of no run in this folder")
        self.device = torch.device(device)
        for batch in map(self._batch, STAGES):
            if batch % process_count():
                raise InputError(f"{batch} pairs do not divide into {process_count()} parts")
        torch.manual_seed(options.seed)
        self.net = build_network(options.config)
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
        if options.fit_decoders is not None and not path.exists():
            trained = load_network(options.fit_decoders, self.device)
            if not (isinstance(self.net, DGCNet) and isinstance(trained, DGCNet)):
                raise WeightsError(f"{options.fit_decoders}: {trained.config.name} has no decoders")
            fit_decoders(self.net, trained, self._fitting_pairs(), options.seed)
        self.out.mkdir(parents=True, exist_ok=True)
        self.elapsed = 0.0  # seconds trained, over all sessions of the run
        self.step = 0
        self._meter = Meter(self.device)
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

    def run(
        self, report: Report = lambda row: None, minutes: float | None = None
    ) -> CorrespondenceNet:
        """Train to the end of the run, or for so many `minutes` more of it.

        `report` gets a row every few steps. Returns the network by its averaged weights, and writes
        them if the run is complete. Raises DgcPoseError if training has diverged.
        """
        end = math.inf if minutes is None else self.elapsed + 60 * minutes
        last_saved = last_validated = self.elapsed
        if self.step == 0 and self.options.init is not None:
            self._report_initial(report)
        origin = time.perf_counter() - self.elapsed
        while not self.complete and self.elapsed < end:
            self.train_step(self.progress)
            self.elapsed = from_first(time.perf_counter() - origin)
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
                    append(self.out / f"{self._stage.name}_{kind}_log.csv", row)
                if done or self.elapsed - last_saved > 60 * self.options.save_minutes:
                    self.save()
                    last_saved = self.elapsed
                origin += time.perf_counter() - paused
        net = self.averaged()
        if self.complete and rank() == 0:
            save_weights(net, self.weights_path)
        return net

    def train_step(self, progress: float) -> dict[str, Tensor]:
        """One optimiser step at a progress of the whole run (0 to 1): its loss and figures.

        They are this process's parts of the joint ones, still on the device.
        """
        name, within = self.options.stages.at(progress)
        if name != self._stage.name:
            self.net.load_state_dict(self.averaged().state_dict())
            self._stage = self._enter(name)
        self._learning_rate = self._stage.set_rate(within)
        began = self._meter.mark()
        pairs = self._make_pairs()
        made = self._meter.mark()
        # On a GPU cuDNN tries its algorithms, as shapes stay the same from step to step. TF32 for
        # convolutions only: coordinates come from matrix products and need all their digits.
        with torch.backends.cudnn.flags(enabled=True, benchmark=True, allow_tf32=True):
            loss, figures = self._loss(pairs, within)
            norm = self._stage.step(loss)
        self.step += 1
        figures = {"loss": loss.detach(), "gradient": norm / process_count(), **figures}
        self._meter.add(self._batch(name), (began, made, self._meter.mark()), figures)
        return figures

    def validate(self) -> dict[str, float]:
        """Figures of the averaged weights on the held-back photographs, each named `val_...`."""
        module = self._stage.average
        if not isinstance(module, EncoderStage):
            figures = validate(module.net, self._validation)
        else:
            draw = self._draw("validation")
            with torch.no_grad():
                rows = [module(pairs, draw)[1] for pairs in self._validation]
            # The same pairs in every process: joint sums need all of them.
            sums = {key: torch.stack([row[key] for row in rows]).mean() for key in rows[0]}
            figures = {key: float(joint_sum(value)) for key, value in sums.items()}
        return {f"val_{key}": value for key, value in figures.items()}

    def averaged(self) -> CorrespondenceNet:
        """A copy of the network by the averaged weights of the stage."""
        return self._stage.averaged()

    def save(self) -> None:
        """Write the checkpoint, as tensors and plain values.

        The decoders' stages hold the whole network. In the encoder's, everything else is as
        the seed, or the weights to initialise from, made it.
        """
        if rank() > 0:
            return
        state = {
            "preset": self.options.network,
            "options": asdict(self.options),
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
        if (
            not isinstance(state, dict)
            or not _STATE.items() <= {name: type(state.get(name)) for name in _STATE}.items()
            or not (0 <= state["elapsed"] < math.inf and state["step"] >= 0)
        ):
            raise WeightsError(f"{path}: not the checkpoint of a run")
        if state["preset"] != network:
            raise WeightsError(f"{path}: a run of preset {state['preset']}, not {network}")
        try:
            self._stage = self._enter(state["stage"])
            self._stage.load_state_dict(state)
        except (RuntimeError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise WeightsError(f"{path}: its weights do not fit the present {network}") from error
        self.elapsed, self.step = state["elapsed"], state["step"]

    def _enter(self, stage: StageName) -> ActiveStage:
        images = normalise(self._validation[0].image1)
        return ActiveStage(stage, self.net, self.options, images)

    def _batch(self, stage: StageName) -> int:
        """Pairs a step, of all processes together."""
        settings = STAGES[stage]
        default = settings.gpu_batch if self.device.type == "cuda" else settings.batch
        return self.options.batch or default

    def _make_pairs(self) -> MapPairs:
        """This process's pairs of the step."""
        batch = self._batch(self._stage.name) // process_count()
        generator = seeded(self.options.seed, self.step, "pairs", rank())
        size = STAGES[self._stage.name].size
        return make_pairs(self.photos, batch, size, generator, self.options.pairs, self.real)

    def _fitting_pairs(self) -> Iterator[MapPairs]:
        for batch in range(_FITTING_BATCHES):
            generator = seeded(self.options.seed, batch, "fit")
            yield make_pairs(self.photos, 4, INPUT_SIZE, generator, self.options.pairs, self.real)

    def _draw(self, *words: object) -> Draw:
        return Draw(seeded(*words), self.device, share=(rank(), process_count()))

    def _loss(self, pairs: MapPairs, within: float) -> Loss:
        draw = self._draw(self.options.seed, self.step, "stage")
        options = []
        if isinstance(self._stage.module, DecoderStage):
            share = 0.0 if self._stage.module.end_to_end else max(0.1, 0.6 * (1 - 2 * within))
            options.append(share)
        result: Loss = self._stage.shared(pairs, draw, *options)
        return result

    def _report_initial(self, report: Report) -> None:
        """The figures of the weights given: the first steps may spoil what later ones regain."""
        row = {"step": 0, "stage": self._stage.name, "minutes": 0.0, **self.validate()}
        if rank() == 0:
            report(row)
            append(self.out / "initial_validation_log.csv", row)

    def _row(self) -> Row:
        """Raises DgcPoseError if a step has diverged, before anything of it is saved."""
        stage = self._stage.name
        row = {
            "step": self.step,
            "stage": stage,
            "minutes": self.elapsed / 60,
            "rate": self._learning_rate,
            **self._meter.row(),
        }
        if not (math.isfinite(row["loss"]) and math.isfinite(row["gradient"])):
            raise DgcPoseError(
                f"{self.out}: the loss or its gradient is no number at step {self.step} of the "
                f"{stage} stage; the checkpoint is from before"
            )
        return row
