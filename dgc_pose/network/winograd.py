"""3x3 convolutions with a quarter of the multiplications, by `winograd.cpp`, compiled on first use.

Winograd's minimal filtering F(4x4, 3x3) (Lavin and Gray, CVPR 2016) on the CPU, for any dilation.
The answer is that of the direct convolution but for rounding, about five times as much of it.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from importlib import resources
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgc_pose.errors import CompilerError

_FLAGS = ("-O3", "-march=native", "-std=c++17", "-shared", "-fPIC", "-pthread")
_SECONDS = 120  # that the compiler may take; it takes three
# Below so many channels, on either side, the transforms cost what the multiplications save.
MIN_CHANNELS = 16
_NEAR, _FAR = 0.5**0.5, 2**0.5  # the points beside 0 and infinity, as in winograd.cpp


class WinogradConv2d(nn.Module):
    """A frozen 3x3 convolution, with or without a ReLU behind it: (B, C, H, W) to (B, D, H, W).

    On the CPU, in float32 whatever comes in, channels last. Raises CompilerError where there is no
    compiler or it fails, ValueError for a convolution that `suits` does not.
    """

    filters: Tensor
    bias: Tensor

    def __init__(self, convolution: nn.Conv2d, *, relu: bool) -> None:
        super().__init__()
        if not suits(convolution):
            raise ValueError(f"not a convolution for Winograd's filtering: {convolution}")
        library = _library()
        self.inputs, self.outputs = convolution.in_channels, convolution.out_channels
        self.dilation = int(convolution.dilation[0])
        self.relu = relu
        weight = convolution.weight.detach()
        self.register_buffer("filters", _packed(weight, library.winograd_panel()))
        bias = convolution.bias
        self.register_buffer(
            "bias", torch.zeros(self.outputs) if bias is None else bias.detach().clone()
        )

    def forward(self, features: Tensor) -> Tensor:
        if features.device.type != "cpu":
            raise ValueError(f"features must be on the CPU, not on {features.device}")
        library = _library()
        features = features.float().contiguous(memory_format=torch.channels_last)
        images, inputs, height, width = features.shape
        if inputs != self.inputs:
            raise ValueError(f"features must have {self.inputs} channels, not {inputs}")
        output = torch.empty(
            (images, self.outputs, height, width), memory_format=torch.channels_last
        )
        threads = torch.get_num_threads()
        memory = torch.empty(threads * library.winograd_workspace(inputs, self.outputs))
        library.winograd_convolve(
            *(t.data_ptr() for t in (features, self.filters, self.bias, output, memory)),
            images,
            height,
            width,
            inputs,
            self.outputs,
            self.dilation,
            int(self.relu),
            threads,
        )
        return output


def suits(convolution: nn.Conv2d) -> bool:
    """Whether a convolution is one that `WinogradConv2d` can do, and faster than torch."""
    return (
        convolution.kernel_size == (3, 3)
        and convolution.stride == (1, 1)
        and convolution.dilation[0] == convolution.dilation[1]
        and convolution.padding == convolution.dilation
        and convolution.padding_mode == "zeros"
        and convolution.groups == 1
        and min(convolution.in_channels, convolution.out_channels) >= MIN_CHANNELS
        and convolution.weight.dtype == torch.float32
        and convolution.weight.device.type == "cpu"
    )


def _packed(weight: Tensor, panel: int) -> Tensor:
    """G g G^T of filters (D, C, 3, 3): (36, panels, C, panel), in double precision until then."""

    def row(point: float, other: float) -> list[float]:
        scale = 1 / (2 * point**2 * (point**2 - other**2))
        return [scale, scale * point, scale * point**2]

    points = ((_NEAR, _FAR), (-_NEAR, _FAR), (_FAR, _NEAR), (-_FAR, _NEAR))
    G = torch.tensor([[1, 0, 0], *(row(*pair) for pair in points), [0, 0, 1]], dtype=torch.float64)
    outputs, inputs = weight.shape[:2]
    transformed = torch.einsum("ap,dcpq,bq->abcd", G, weight.double(), G).reshape(36, inputs, -1)
    padded = F.pad(transformed, (0, -outputs % panel)).reshape(36, inputs, -1, panel)
    return padded.transpose(1, 2).float().contiguous()


@functools.cache
def _library() -> ctypes.CDLL:
    """The compiled kernel, from the user's cache where it is there."""
    compiler = next(filter(None, map(shutil.which, ("g++", "clang++", "c++"))), None)
    if compiler is None:
        raise CompilerError("no C++ compiler (g++ or clang++) was found")
    source = (resources.files(__package__) / "winograd.cpp").read_bytes()
    # -march=native: what another machine with the same home compiled may not run here.
    made_for = repr((compiler, _FLAGS, platform.machine(), torch.cpu.get_capabilities()))
    digest = hashlib.sha256(source + made_for.encode()).hexdigest()[:16]
    try:
        path = _folder() / f"winograd-{digest}.so"
        if not path.is_file():
            _compile(compiler, source, path)
        library = ctypes.CDLL(str(path))
    except (OSError, RuntimeError) as error:  # RuntimeError: of a user without a home
        raise CompilerError(f"the compiled kernel cannot be kept or loaded: {error}") from error
    library.winograd_panel.restype = ctypes.c_int
    library.winograd_workspace.argtypes = [ctypes.c_int] * 2
    library.winograd_workspace.restype = ctypes.c_size_t
    integers = [ctypes.c_long, *[ctypes.c_int] * 7]
    library.winograd_convolve.argtypes = [*[ctypes.c_void_p] * 5, *integers]
    library.winograd_convolve.restype = None
    return library


def _folder() -> Path:
    """Where compiled kernels are kept: the user's own cache folder."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "dgc-pose"


def _compile(compiler: str, source: bytes, path: Path) -> None:
    """Compile a source into a shared library, which appears at `path` whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        file, made = Path(folder) / "winograd.cpp", Path(folder) / path.name
        file.write_bytes(source)
        command = [compiler, *_FLAGS, str(file), "-o", str(made)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_SECONDS)
        except subprocess.TimeoutExpired:
            raise CompilerError(f"{compiler} took more than {_SECONDS} s") from None
        if done.returncode != 0:
            first = next(iter(done.stderr.strip().splitlines()), f"exit status {done.returncode}")
            raise CompilerError(f"{compiler} failed: {first}")
        os.replace(made, path)
