"""`dgc-pose info`: what a bug report needs to know of an installation and its machine."""

import hashlib
import os
import platform
import sys
from contextlib import suppress
from importlib import metadata
from pathlib import Path

import click

import dgc_pose
from dgc_pose.errors import is_installed
from dgc_pose.matchers import default_runtime
from dgc_pose.system.threads import usable_cpus
from dgc_pose.version import build, version

_LIBRARIES = (
    *("numpy", "scipy", "opencv-python-headless", "pillow", "poselib", "pycolmap", "onnxruntime"),
    *("torch", "safetensors", "matplotlib", "click", "starlette", "uvicorn"),
)
# Environment variables that change threads, memory, devices or the size of images begin so.
_VARIABLES = ("OMP_", "GOMP_", "MKL_", "OPENBLAS_", "OPENCV_", "MALLOC_", "CUDA_", "DGC_POSE_")
_ABSENT = "not installed"


@click.command()
def info() -> None:
    """Print versions, weights, devices and threads, for bug reports."""
    facts = _facts()
    width = max(len(name) for group in facts.values() for name in group)
    for heading, group in facts.items():
        click.echo(heading)
        for name, value in group.items():
            click.echo(f"  {name:{width}}  {value}")


def _facts() -> dict[str, dict[str, str]]:
    """The facts by heading, then by name. Imports torch, if it is installed, for its devices."""
    import cv2

    from dgc_pose.system.onnx_library import onnxruntime

    package = Path(dgc_pose.__file__).resolve().parent
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    cpus = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    models = [line.partition(":")[2].strip() for line in cpus if line.startswith("model name")]
    libraries = dict.fromkeys(_LIBRARIES, _ABSENT)
    for name in _LIBRARIES:
        with suppress(metadata.PackageNotFoundError):
            libraries[name] = metadata.version(name)
    weights = {}
    for file in sorted(package.glob("weights/*.safetensors")):
        digest = hashlib.sha256(file.read_bytes()).hexdigest()
        weights[file.name] = f"{file.stat().st_size / 1e6:.1f} MB, sha256 {digest[:16]}"
    providers = ", ".join(onnxruntime.get_available_providers())
    devices = {"runtime": default_runtime(), "onnxruntime": providers, "torch": _ABSENT}
    threads = {"OpenCV": str(cv2.getNumThreads())}
    if is_installed("torch"):
        import torch

        cards = map(torch.cuda.get_device_properties, range(torch.cuda.device_count()))
        names = [f"{card.name}, {card.total_memory / 2**30:.0f} GiB" for card in cards]
        devices["torch"] = f"cuda {torch.version.cuda}: {'; '.join(names)}" if names else "cpu"
        threads["torch"] = str(torch.get_num_threads())
    return {
        "dgc-pose": {"version": version(), "build": build(), "folder": str(package)},
        "machine": {
            "Python": f"{platform.python_version()} ({sys.executable})",
            "system": platform.platform(),
            "processor": models[0] if models else platform.machine(),
            "processors": f"{usable_cpus()} of {os.cpu_count()} usable",
            "memory": f"{memory:.1f} GiB",
        },
        "libraries": libraries,
        "weights": weights,
        "devices": devices,
        "threads": threads,
        "environment": {k: v for k, v in sorted(os.environ.items()) if k.startswith(_VARIABLES)},
    }
