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
    data: Mapping[str, PairSource],
    device: torch.device,
    stages: Mapping[str, Mapping[str, Any]],
) -> str:
    """Markdown.

    data: what trains, and what validates; stages: of each its steps, pairs, seconds and figures.
    """
    training = data["training"]
    scenes = training.scenes
    shares = ", ".join(f"{name} {share:.0%}" for name, share in vars(options.shares).items())
    given = {"init": options.init, "encoder": options.encoder}
    start = ", ".join(f"{name} {value}" for name, value in given.items() if value is not None)
    rows = {
        "network": options.network,
        "photographs": f"{training.photos.single}, and {len(training.photos.places)} places in "
        "other light",
        "posed photographs": "none"
        if scenes is None
        else f"{len(scenes.scene)} of {len(scenes.names)} scenes ({', '.join(scenes.names)}), "
        f"{len(training.frames or ())} pairs train",
        "pairs": f"{shares}; kinds without data have none",
        "start": start or "random weights",
        "seed, rates": f"{options.seed}, {options.rate:g} times the usual",
        "hardware": torch.cuda.get_device_name(device)
        if device.type == "cuda"
        else f"{platform.machine()}, {torch.get_num_threads()} threads",
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
