"""`dgc-pose info`: what a bug report needs to know of an installation and its machine."""

import hashlib
import os
import platform
import sys
from importlib import metadata
from pathlib import Path

import click

import dgc_pose
from dgc_pose.errors import is_installed
from dgc_pose.files.json_files import json_text
from dgc_pose.runtime.load import default_runtime
from dgc_pose.system.threads import usable_cpus
from dgc_pose.version import build, version

_LIBRARIES = (
    *("numpy", "scipy", "opencv-python-headless", "pillow", "poselib", "pycolmap", "onnxruntime"),
    *("torch", "safetensors", "matplotlib", "click", "starlette", "uvicorn"),
)
# Environment variables that change threads, devices or the size of images.
_VARIABLES = (
    *("OMP_NUM_THREADS", "OMP_WAIT_POLICY", "GOMP_SPINCOUNT", "MKL_NUM_THREADS"),
    *("OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM", "CUDA_VISIBLE_DEVICES"),
    "DGC_POSE_MAX_PIXELS",
)
_ABSENT = "not installed"


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def info(as_json: bool) -> None:
    """Print versions, weights, devices and threads, for bug reports."""
    facts = _facts()
    if as_json:
        click.echo(json_text(facts), nl=False)
        return
    width = max(len(name) for group in facts.values() for name in group)
    for heading, group in facts.items():
        click.echo(heading)
        for name, value in group.items():
            click.echo(f"  {name:{width}}  {value}")


def _facts() -> dict[str, dict[str, str]]:
    """The facts by heading, then by name. Imports torch, if it is installed, for its devices."""
    package = Path(dgc_pose.__file__).resolve().parent
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    devices, threads = _devices_and_threads()
    return {
        "dgc-pose": {"version": version(), "build": build(), "folder": str(package)},
        "machine": {
            "Python": f"{platform.python_version()} ({sys.executable})",
            "system": platform.platform(),
            "processor": _processor(),
            "processors": f"{usable_cpus()} of {os.cpu_count()} usable",
            "memory": f"{memory:.1f} GiB",
        },
        "libraries": {name: _library(name) for name in _LIBRARIES},
        "weights": {
            file.name: f"{file.stat().st_size / 1e6:.1f} MB, "
            f"sha256 {hashlib.sha256(file.read_bytes()).hexdigest()[:16]}"
            for file in sorted(package.glob("weights/*.safetensors"))
        },
        "devices": devices,
        "threads": threads,
        "environment": {name: os.environ[name] for name in _VARIABLES if name in os.environ},
    }


def _processor() -> str:
    """The processor's name, which Linux has in a file."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())


def _library(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return _ABSENT


def _devices_and_threads() -> tuple[dict[str, str], dict[str, str]]:
    import cv2

    from dgc_pose.system.onnx_library import onnxruntime

    providers = ", ".join(onnxruntime.get_available_providers())
    devices = {"runtime": default_runtime(), "onnxruntime": providers, "torch": _ABSENT}
    threads = {"OpenCV": str(cv2.getNumThreads())}
    if is_installed("torch"):
        import torch

        cards = map(torch.cuda.get_device_properties, range(torch.cuda.device_count()))
        names = [f"{card.name}, {card.total_memory / 2**30:.0f} GiB" for card in cards]
        devices["torch"] = f"cuda {torch.version.cuda}: {'; '.join(names)}" if names else "cpu"
        threads["torch"] = str(torch.get_num_threads())
    return devices, threads
