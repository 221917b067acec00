"""`dgc-pose info`: facts about the installation and the machine, for bug reports."""

import os
import platform
import sys
from hashlib import sha256
from importlib import metadata
from pathlib import Path

import click
import cv2

import dgc_pose
from dgc_pose.errors import is_installed
from dgc_pose.matchers import default_runtime
from dgc_pose.matching.lightglue import NAME as LIGHTGLUE
from dgc_pose.matching.lightglue import installed_fingerprint, is_available
from dgc_pose.system.onnx_library import onnxruntime
from dgc_pose.system.parallel import usable_cpus
from dgc_pose.version import build, version

_LIBRARIES = (
    *("numpy", "scipy", "opencv-python-headless", "pillow", "poselib", "pycolmap", "onnxruntime"),
    *("torch", "safetensors", "matplotlib", "click", "starlette", "uvicorn"),
)
# Prefixes of environment variables that change threads, memory or devices.
_VARIABLES = ("OMP_", "GOMP_", "MKL_", "OPENBLAS_", "OPENCV_", "MALLOC_", "CUDA_")


@click.command()
def info() -> None:
    """Print versions, weights, devices and threads, for bug reports."""
    package = Path(dgc_pose.__file__).resolve().parent
    installed = {d.metadata["Name"].lower(): d.version for d in metadata.distributions()}
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    facts = {
        "dgc-pose": f"{version()}, build {build()}, {package}",
        "Python": f"{platform.python_version()} ({sys.executable})",
        "system": platform.platform(),
        "machine": f"{usable_cpus()} of {os.cpu_count()} processors usable, {memory:.1f} GiB",
        **{name: installed.get(name, "not installed") for name in _LIBRARIES},
        LIGHTGLUE: installed_fingerprint() if is_available() else "not installed",
    }
    for file in sorted(package.glob("weights/*.safetensors")):
        facts[file.name] = f"sha256 {sha256(file.read_bytes()).hexdigest()[:16]}"
    facts["runtime"] = f"{default_runtime()}; {', '.join(onnxruntime.get_available_providers())}"
    facts["threads"] = f"OpenCV {cv2.getNumThreads()}"
    if is_installed("torch"):
        import torch

        cards = [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())]
        facts["cuda"] = f"{torch.version.cuda}: {'; '.join(cards) or 'no device'}"
        facts["threads"] += f", torch {torch.get_num_threads()}"
    facts |= {key: value for key, value in os.environ.items() if key.startswith(_VARIABLES)}
    for name, value in facts.items():
        click.echo(f"{name:{max(map(len, facts))}}  {value}")
