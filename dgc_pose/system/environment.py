"""What a bug report needs to know of an installation and its machine."""

import hashlib
import os
import platform
import re
import sys
from importlib import metadata
from pathlib import Path

from dgc_pose.errors import is_installed
from dgc_pose.system.threads import usable_cpus
from dgc_pose.version import build, version

Facts = dict[str, dict[str, str]]  # by heading, then by name

LIBRARIES = (
    *("numpy", "scipy", "opencv-python-headless", "pillow", "poselib", "pycolmap", "onnxruntime"),
    *("torch", "safetensors", "matplotlib", "click", "starlette", "uvicorn"),
)
# Environment variables that change threads, devices or the size of images.
VARIABLES = (
    *("OMP_NUM_THREADS", "OMP_WAIT_POLICY", "GOMP_SPINCOUNT", "MKL_NUM_THREADS"),
    *("OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM", "CUDA_VISIBLE_DEVICES"),
    "DGC_POSE_MAX_PIXELS",
)
ABSENT = "not installed"
_PACKAGE = Path(__file__).resolve().parents[1]


def environment() -> Facts:
    """Versions, machine, weights, devices and threads, in the order in which they are shown.

    Imports torch, if it is installed, to ask for its devices.
    """
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return {
        "dgc-pose": {"version": version(), "build": build(), "folder": str(_PACKAGE)},
        "machine": {
            "Python": f"{platform.python_version()} ({sys.executable})",
            "system": platform.platform(),
            "processor": _processor(),
            "processors": f"{usable_cpus()} of {os.cpu_count()} usable",
            "memory": f"{memory:.1f} GiB",
        },
        "libraries": {name: _library(name) for name in LIBRARIES},
        "weights": {f.name: _digest(f) for f in sorted(_PACKAGE.glob("weights/*.safetensors"))},
        "devices": _devices(),
        "threads": _threads(),
        "environment": {name: os.environ[name] for name in VARIABLES if name in os.environ},
    }


def _processor() -> str:
    """The processor's name, which Linux has in a file."""
    text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    name = re.search(r"^model name\s*:\s*(.*)", text, re.MULTILINE)
    return name[1] if name else platform.machine()


def _library(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ABSENT


def _digest(file: Path) -> str:
    """The size of a file and the first digits of its sha256."""
    data = file.read_bytes()
    return f"{len(data) / 1e6:.1f} MB, sha256 {hashlib.sha256(data).hexdigest()[:16]}"


def _devices() -> dict[str, str]:
    facts = {}
    if is_installed("onnxruntime"):
        from dgc_pose.system.onnx_library import onnxruntime

        facts["onnxruntime"] = ", ".join(onnxruntime.get_available_providers())
    if not is_installed("torch"):
        return facts | {"torch": ABSENT}
    import torch

    if not torch.cuda.is_available():
        return facts | {"torch": "cpu"}
    cards = (torch.cuda.get_device_properties(n) for n in range(torch.cuda.device_count()))
    names = [f"{card.name}, {card.total_memory / 2**30:.0f} GiB" for card in cards]
    return facts | {"torch": f"cuda {torch.version.cuda}: " + "; ".join(names)}


def _threads() -> dict[str, str]:
    import cv2

    facts = {"OpenCV": str(cv2.getNumThreads())}
    if "torch" in sys.modules:
        facts["torch"] = str(sys.modules["torch"].get_num_threads())
    return facts
