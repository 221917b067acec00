"""A training run: timed stages, checkpoints from which a killed run resumes, a log."""

import copy
import json
import math
import platform
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import save
from torch import Tensor, nn

from dgc_pose.errors import ArgumentName, DgcPoseError, InputError, WeightsError
from dgc_pose.network.config import INPUT_SIZE
from dgc_pose.network.net import DGCNet, Pyramid
from dgc_pose.network.weights import COUNTER, check_state, load_checkpoint, load_network, read_state
from dgc_pose.system.files import naming_path, read_as, replaced, write_text
from dgc_pose.training.draw import Draw
from dgc_pose.training.losses import SHAPES, DecoderStage, EncoderStage, StageName
from dgc_pose.training.options import TrainingOptions
from dgc_pose.training.pairs import TRAINING, PairSource
from dgc_pose.training.views import MapPairs
from dgc_pose.version import version

CHECKPOINT = "checkpoint.pt"
LOG = "log.jsonl"
_SQUARE = (INPUT_SIZE, INPUT_SIZE)
_STEPS_A_ROW = 10  # steps per row of the log; only for a row is data read from the GPU
_SAVE_SECONDS = 60.0  # between checkpoints
_BATCH = 4  # pairs of 240x240 pixels per step, on a CPU
_GPU_BATCH: dict[StageName, int] = {"encoder": 84, "decoders": 64}
_VALIDATION = 4  # validation batches of each kind
_VALIDATION_BATCH = 8  # pairs per validation batch
_LARGEST_GRADIENT = 3.0  # norm over all parameters
_RATE = 1e-3
_WEIGHT_DECAY = 1e-4
_BETAS = (0.9, 0.98)
_WARM_UP = 0.02  # share of the stage
_LAST_RATE = 0.02  # share of the highest rate
_DECAY = 0.999  # largest decay of the exponential moving average of the weights
# Layers pretrained on ImageNet learn more slowly.
_BACKBONE = ("net.pyramid.stem.", "net.pyramid.blocks.")
_BACKBONE_RATE = 0.35
# A checkpoint contains the options, these values, and the states of these objects.
_VALUES = "elapsed", "step", "stages", "rows", "stage"
_STATES = "module", "average", "optimizer"

Row = dict[str, Any]
Validation = Mapping[str, Sequence[MapPairs]]


class Trainer:
    """Trains one network by `TrainingOptions`, in the folder `out`.

    The run writes to `out`: checkpoint.pt (everything a resumed run needs), the figures as
    log.jsonl and, at the end, `<network>.safetensors` with its card, `<network>.md`. Raises
    InputError if `out` already contains a run and `resume` is False, or if options differ from the
    resumed run's; WeightsError if a checkpoint is damaged or initial weights are unusable.
    """

    def __init__(
        self,
        out: str | Path,
        options: TrainingOptions,
        device: torch.device | str = "cpu",
        resume: bool = False,
    ) -> None:
        self.options = options
        self.out = Path(out)
        self.weights_path = self.out / f"{options.preset}.safetensors"
        self.checkpoint = self.out / CHECKPOINT
        self.device = torch.device(device)
        resumes = self.checkpoint.exists()
        if resumes and not resume:
            text = f"{self.checkpoint} exists already:"
            raise InputError(text, ArgumentName("resume"), "continues it")
        if self.weights_path.exists() and not resumes:
            raise InputError(f"{self.weights_path} exists, and this folder has no checkpoint")
        torch.manual_seed(options.seed)
        net = DGCNet(options.config)
        if options.init is not None:
            other = load_network(options.init)
            if other.config != net.config:
                known = f"weights of {other.config.name}, not {options.preset}"
                raise WeightsError(f"{options.init}: {known}")
            net.load_state_dict(other.state_dict())
        if options.encoder is not None:
            initialise_encoder(options.encoder, net)
        net.to(self.device).half_precision = self.device.type == "cuda"
        self.out.mkdir(parents=True, exist_ok=True)
        self.elapsed = 0.0  # seconds of the run, over all its sessions
        self.step = 0
        self.stages: dict[str, Row] = {}  # stages begun: steps, pairs, seconds and figures
        self.rows: list[Row] = []  # of the log
        if resumes:
            self._load(net)
        else:
            self._enter(self._place()[0], net)

    @property
    def progress(self) -> float:
        """The finished share of the whole run; 1 or more at its end."""
        if self.options.steps is not None:
            return self.step / self.options.steps
        assert self.options.seconds is not None
        return self.elapsed / self.options.seconds

    def run(self, data: Mapping[str, PairSource]) -> DGCNet:
        """Train to the end; write the averaged weights and their card.

        data: see `load_data`; on the run's device. A line of figures goes to standard error every
        few steps. Raises DgcPoseError if training has diverged.
        """
        validation: dict[str, list[MapPairs]] = {}
        for kind in [kind for kind in data if kind != TRAINING]:
            draw = Draw(self.device, "validation", kind)  # the same pairs for every run
            shape = (208, 272) if kind == "posed" and self.options.config.any_shape else _SQUARE
            batches = range(_VALIDATION)
            validation[kind] = [data[kind].make(_VALIDATION_BATCH, shape, draw) for _ in batches]
        saved = self.elapsed
        origin = time.perf_counter() - self.elapsed
        if self.step == 0 and self.options.init is not None:
            self._write({}, validation)  # scores before the first steps, which may lower them
        while self.progress < 1:
            figures = self.train_step(data[TRAINING])
            before = self.elapsed
            self.elapsed = time.perf_counter() - origin
            self.stages[self.stage]["seconds"] += self.elapsed - before
            ends = self.progress >= 1 or self._place()[0] != self.stage
            saves = ends or self.elapsed - saved > _SAVE_SECONDS
            if saves or self.step % _STEPS_A_ROW == 0:
                self._write(figures, validation if ends else {})
            if saves:
                self.save()
                saved = self.elapsed
        net = self.average.finished()
        save_weights(net, self.weights_path)
        write_text(self.weights_path.with_suffix(".md"), self._card(data[TRAINING]))
        return net

    def train_step(self, training: PairSource) -> dict[str, Tensor]:
        """Take one optimiser step; return its figures, still on the device."""
        name, within = self._place()
        if name != self.stage:
            self._enter(name, self.average.finished())
        draw = Draw(self.device, self.options.seed, name, self.step)
        shapes = SHAPES[name] if self.options.config.any_shape else (_SQUARE,)
        shape = shapes[self.step % len(shapes)]
        usual = _GPU_BATCH[name] if self.device.type == "cuda" else _BATCH
        count = (self.options.batch or usual) * INPUT_SIZE**2 // (shape[0] * shape[1])
        pairs = training.make(max(1, count), shape, draw)
        loss, figures = self.module(pairs, draw, within)
        # A linear warm-up, then a cosine.
        cosine = 0.5 * (1 + math.cos(math.pi * min(within, 1.0)))
        rate = _RATE * min(1.0, 0.05 + 0.95 * within / _WARM_UP)
        rate = self.options.rate * (rate * (_LAST_RATE + (1 - _LAST_RATE) * cosine))
        for group in self.optimizer.param_groups:
            group["lr"] = rate * group["share"]
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.module.parameters(), _LARGEST_GRADIENT)
        self.optimizer.step()
        self.step += 1
        self.stages[name]["steps"] += 1
        self.stages[name]["pairs"] += len(pairs.map)
        move_average(self.average, self.module, self.stages[name]["steps"])
        return {"rate": torch.tensor(rate), "loss": loss.detach(), "gradient": norm, **figures}

    def save(self) -> None:
        """Write the log, then the checkpoint as tensors and plain values. The rows are in both, so
        that after a kill between the two, the next save writes a whole log."""
        write_text(self.out / LOG, "".join(json.dumps(row) + "\n" for row in self.rows))
        state: Row = {"options": self._fixed_options()}
        state |= {name: getattr(self, name) for name in _VALUES}
        state |= {name: getattr(self, name).state_dict() for name in _STATES}
        with replaced(self.checkpoint) as temporary, naming_path(temporary):
            torch.save(state, temporary)

    def _load(self, net: DGCNet) -> None:
        path = self.checkpoint
        name = self.options.preset
        state = load_checkpoint(path, self.device)
        with read_as(f"a checkpoint of the present {name}", path, WeightsError):
            for name, value in self._fixed_options().items():
                if state["options"][name] != value:
                    text = f"is {value}, and {state['options'][name]} in the run of {path}"
                    raise InputError(ArgumentName(name), text)
            self._enter(state["stage"], net)
            for name in _STATES:
                getattr(self, name).load_state_dict(state[name])
            for name in _VALUES:
                setattr(self, name, state[name])
        if self.stage == "decoders" and self._place()[0] == "encoder":
            length = ArgumentName("seconds" if self.options.steps is None else "steps")
            raise InputError(length, f"returns to the encoder, but {path} is at the decoders")

    def _fixed_options(self) -> dict[str, str]:
        """The options that a resumed run must share with its checkpoint: all but the length."""
        options = vars(self.options).items()
        return {name: str(value) for name, value in options if name not in ("seconds", "steps")}

    def _enter(self, stage: StageName, net: DGCNet) -> None:
        self.stage = stage
        self.stages[stage] = {"steps": 0, "pairs": 0, "seconds": 0.0, "figures": {}}
        self.module = EncoderStage(net) if stage == "encoder" else DecoderStage(net)
        self.module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.module.train()
        self.optimizer = optimiser(self.module)
        self.average = copy.deepcopy(self.module).eval().requires_grad_(False)

    def _place(self) -> tuple[StageName, float]:
        """The stage at the run's progress, and the progress within this stage."""
        share = self.options.encoder_share if self.options.config.any_shape else 0.0
        if self.progress < share or share == 1:
            return "encoder", self.progress / share
        return "decoders", (self.progress - share) / (1 - share)

    def _write(self, figures: Mapping[str, Tensor], validation: Validation) -> None:
        """Add a row to the log, with validation figures of the averaged weights. Raises
        DgcPoseError if a step has diverged, before it is saved."""
        numbers = {name: float(value) for name, value in figures.items()}
        if not math.isfinite(numbers.get("loss", 0) + numbers.get("gradient", 0)):
            raise DgcPoseError(
                f"{self.out}: the loss or its gradient is not finite at step {self.step} of the "
                f"{self.stage} stage; the checkpoint is from before"
            )
        stage = self.stages[self.stage]
        numbers["pairs_per_second"] = stage["pairs"] / max(stage["seconds"], 1e-9)
        row: Row = {"stage": self.stage, "step": self.step, "seconds": self.elapsed, **numbers}
        place = f"{self.stage} step {self.step}, {self.elapsed:.0f} s"
        print(f"{place}  {_text(numbers)}", file=sys.stderr)
        for kind, batches in validation.items():
            draw = Draw(self.device, "validation")
            with torch.no_grad():
                found = [self.average(pairs, draw, 1.0)[1] for pairs in batches]
            means = {
                name: float(np.mean([float(losses[name]) for losses in found])) for name in found[0]
            }
            stage["figures"][kind] = row.setdefault("validation", {})[kind] = means
            print(f"    validation, {kind}:  {_text(means)}", file=sys.stderr)
        self.rows.append(row)

    def _card(self, training: PairSource) -> str:
        """The weights' card in Markdown: training data, options, results and machine."""
        photos = training.photos
        posed = "none"
        cuda = self.device.type == "cuda"
        if (pairs := training.posed) is not None:
            scenes = f"{len(pairs.names)} scenes ({', '.join(pairs.names)})"
            posed = f"{len(pairs.frames.unique())} of {scenes}, {len(pairs.frames)} pairs train"
        threads = f"{platform.machine()}, {torch.get_num_threads()} threads"
        rows = {
            **{
                name: value for name, value in vars(self.options).items() if value not in (None, ())
            },
            "photographs": f"{photos.single}, and {len(photos.places)} places in other light",
            "posed photographs": posed,
            "hardware": torch.cuda.get_device_name(self.device) if cuda else threads,
            "made by": f"dgc-pose {version()}, torch {torch.__version__}",
            "chosen": "nothing: the moving average of the last step's weights is stored",
        }
        for name, stage in self.stages.items():
            done = f"{stage['steps']} steps, {stage['pairs']} pairs, {stage['seconds']:.0f} seconds"
            figures = (f"{kind}: {_text(found)}" for kind, found in stage["figures"].items())
            rows[name] = "; ".join([done, *figures])
        table = "".join(f"| {name} | {value} |\n" for name, value in rows.items())
        return f"# {self.options.preset}\n\n| | |\n|---|---|\n{table}"


def _text(figures: Mapping[str, float]) -> str:
    return "  ".join(f"{name} {value:.3g}" for name, value in figures.items())


def initialise_encoder(weights: str | Path, net: DGCNet) -> None:
    """Load ImageNet's VGG-16 (.pth or .safetensors) in torchvision's layout (BSD-3-Clause), without
    its later layers, into the net's encoder.

    Raises WeightsError if the file contains other weights.
    """
    assert isinstance(net.pyramid, Pyramid)
    path = Path(weights)
    layers = nn.ModuleDict({"features": vgg_layers(net.pyramid)})
    wanted = {key: value.shape for key, value in layers.state_dict().items()}
    state = {key: value for key, value in read_state(path).items() if key in wanted}
    check_state(path, "VGG-16 in torchvision's layout", state, wanted)
    layers.load_state_dict({key: torch.from_numpy(value) for key, value in state.items()})


def vgg_layers(pyramid: Pyramid) -> nn.Sequential:
    """The layers of all levels of the pyramid, numbered like torchvision's VGG-16 `features`."""
    return nn.Sequential(*(layer for level in pyramid.children() for layer in level.children()))


def save_weights(net: DGCNet, path: str | Path) -> None:
    """Write a network as safetensors in half precision, with its preset's name in the header.

    Statistics of batch norms, whose variance may exceed half precision's range, and tensors with
    values beyond this range stay in single precision.
    """
    state = {}
    for key, value in net.state_dict().items():
        if not key.endswith(COUNTER):
            value = value.detach().cpu().float().contiguous()
            largest = torch.finfo(torch.float16).max
            fits = "running_" not in key and bool(value.abs().max() < largest)
            state[key] = value.half() if fits else value
    header = {"preset": net.config.name}
    with replaced(Path(path)) as temporary, naming_path(temporary):
        # Not by save_file: only the owner could read its files.
        temporary.write_bytes(save(state, metadata=header))


def optimiser(stage: nn.Module) -> torch.optim.AdamW:
    """The optimiser of a stage's trainable parameters, in groups with a `share` of the rate."""
    trained = [(key, value) for key, value in stage.named_parameters() if value.requires_grad]
    rest = [value for key, value in trained if not key.startswith(_BACKBONE)]
    backbone = [value for key, value in trained if key.startswith(_BACKBONE)]
    groups = [{"params": rest, "share": 1.0}, {"params": backbone, "share": _BACKBONE_RATE}]
    return torch.optim.AdamW(groups, weight_decay=_WEIGHT_DECAY, betas=_BETAS)


@torch.no_grad()
def move_average(average: nn.Module, module: nn.Module, steps: int, decay: float = _DECAY) -> None:
    """Update an exponential moving average of a module's weights and buffers after `steps` steps.

    The decay is min(decay, steps / (9 + steps)), so that random initial weights soon lose their
    influence. Counters are copied.
    """
    share = 1 - min(decay, steps / (9 + steps))
    values = module.state_dict().values()
    for mean, value in zip(average.state_dict().values(), values, strict=True):
        if mean.is_floating_point():
            mean.lerp_(value, share)
        else:
            mean.copy_(value)
