"""The device that the network runs on."""

import torch

from dgc_pose.errors import InputError


def choose_device(name: str = "auto") -> torch.device:
    """The torch device of that name; "auto" is a CUDA device if there is one, else the CPU.

    Raises InputError for an unknown name or a missing device.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError:
        raise InputError(f"device must be auto, cpu, cuda or cuda:N, not '{name}'") from None
    if device.type == "cuda" and not torch.cuda.is_available():
        raise InputError(f"device {name}: no CUDA device is available here")
    return device
