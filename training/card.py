"""The card of weights: what they were trained on, how, and on what machine."""

import platform
from collections.abc import Mapping
from typing import Any

import torch

from dgc_pose.training.options import TrainingOptions
from dgc_pose.training.pairs import PairSource
from dgc_pose.version import version


def card(
    options: TrainingOptions,
    training: PairSource,
    device: torch.device,
    stages: Mapping[str, Mapping[str, Any]],
) -> str:
    """Markdown. stages: of each its steps, pairs, seconds and figures by what validates."""
    photos, posed = training.photos, "none"
    if training.posed is not None:
        scenes = training.posed.scenes
        posed = f"{len(scenes.scene)} of {len(scenes.names)} scenes ({', '.join(scenes.names)}), "
        posed += f"{len(training.posed.frames)} pairs train"
    threads = f"{platform.machine()}, {torch.get_num_threads()} threads"
    is_gpu = device.type == "cuda"
    rows = {
        **{name: value for name, value in vars(options).items() if value not in (None, ())},
        "photographs": f"{photos.single}, and {len(photos.places)} places in other light",
        "posed photographs": posed,
        "hardware": torch.cuda.get_device_name(device) if is_gpu else threads,
        "made by": f"dgc-pose {version()}, torch {torch.__version__}",
        "chosen": "nothing: the moving average of the last step's weights is stored",
    }
    lines = [f"# {options.network}", "", "| | |", "|---|---|"]
    lines += [f"| {name} | {value} |" for name, value in rows.items()]
    for name, stage in stages.items():
        done = f"{stage['steps']} steps, {stage['pairs']} pairs, {stage['seconds']:.0f} seconds."
        lines += ["", f"## {name}", "", done, "", "| validation | figures |", "|---|---|"]
        for kind, figures in stage["figures"].items():
            text = ", ".join(f"{key} {value:.3f}" for key, value in figures.items())
            lines.append(f"| {kind} | {text} |")
    return "\n".join(lines) + "\n"
