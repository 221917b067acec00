"""The compiled convolutions against torch's in double precision."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from dgc_pose.errors import CompilerError
from dgc_pose.network import winograd
from dgc_pose.network.winograd import WinogradConv2d, suits

needs_compiler = pytest.mark.skipif(
    not any(map(shutil.which, ("g++", "clang++", "c++"))), reason="no C++ compiler"
)


@needs_compiler
@pytest.mark.parametrize(
    ("inputs", "outputs", "dilation", "size", "bias"),
    [
        (16, 16, 1, (8, 8), True),
        (32, 64, 1, (5, 11), True),  # no multiples of the 4x4 tiles
        (19, 50, 2, (13, 9), True),  # no multiples of the vectors, nor of the panels
        (48, 33, 3, (24, 23), False),
        (64, 24, 16, (40, 7), True),  # a dilation wider than the image
        (130, 128, 4, (30, 30), True),
    ],
)
def test_the_direct_convolution_s_answer(
    inputs: int, outputs: int, dilation: int, size: tuple[int, int], bias: bool
) -> None:
    torch.manual_seed(0)
    direct = nn.Conv2d(inputs, outputs, 3, padding=dilation, dilation=dilation, bias=bias)
    features = torch.randn(2, inputs, *size)
    for relu in (False, True):
        found = WinogradConv2d(direct, relu=relu)(features)
        wanted = F.conv2d(
            features.double(),
            direct.weight.detach().double(),
            direct.bias.detach().double() if direct.bias is not None else None,
            padding=dilation,
            dilation=dilation,
        )
        wanted = wanted.relu() if relu else wanted
        assert found.is_contiguous(memory_format=torch.channels_last)
        torch.testing.assert_close(found.double(), wanted, atol=3e-5, rtol=0)


@needs_compiler
def test_the_number_of_threads_changes_nothing() -> None:
    torch.manual_seed(0)
    layer = WinogradConv2d(nn.Conv2d(32, 32, 3, padding=1), relu=True)
    features = torch.randn(3, 32, 61, 50)
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        one = layer(features)
        torch.set_num_threads(5)
        assert torch.equal(one, layer(features))
    finally:
        torch.set_num_threads(before)


@needs_compiler
def test_half_precision_comes_in_and_single_goes_out() -> None:
    """As where torch's own convolutions before it run under autocast."""
    torch.manual_seed(0)
    layer = WinogradConv2d(nn.Conv2d(16, 16, 3, padding=1), relu=False)
    features = torch.randn(1, 16, 9, 9).bfloat16()
    found = layer(features)
    assert found.dtype == torch.float32 and torch.equal(found, layer(features.float()))


@needs_compiler
def test_nan_stays_nan_and_goes_no_further_than_its_tiles() -> None:
    layer = WinogradConv2d(nn.Conv2d(16, 16, 3, padding=1), relu=True)
    features = torch.zeros(1, 16, 40, 40)
    features[0, 3, 20, 20] = torch.nan
    found = layer(features)
    assert found[0, :, 19:22, 19:22].isnan().all()
    assert found[0, :, :15].isfinite().all() and found[0, :, 26:].isfinite().all()


@needs_compiler
def test_what_it_does_not_do_is_refused() -> None:
    for other in (
        nn.Conv2d(16, 16, 1),
        nn.Conv2d(16, 16, 3, stride=2, padding=1),
        nn.Conv2d(16, 16, 3),
        nn.Conv2d(16, 16, 3, padding=2, dilation=(2, 1)),
        nn.Conv2d(16, 16, 3, padding=1, padding_mode="reflect"),
        nn.Conv2d(16, 16, 3, padding=1, groups=2),
        nn.Conv2d(3, 16, 3, padding=1),
        nn.Conv2d(16, 16, 3, padding=1, dtype=torch.float64),
    ):
        assert not suits(other)
        with pytest.raises(ValueError, match="not a convolution"):
            WinogradConv2d(other, relu=False)
    layer = WinogradConv2d(nn.Conv2d(16, 16, 3, padding=1), relu=False)
    with pytest.raises(ValueError, match="on the CPU"):
        layer(torch.zeros(1, 16, 8, 8, device="meta"))
    with pytest.raises(ValueError, match="16 channels"):
        layer(torch.zeros(1, 17, 8, 8))


def test_a_machine_without_a_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda *_: None)
    winograd._library.cache_clear()
    with pytest.raises(CompilerError, match="no C\\+\\+ compiler"):
        WinogradConv2d(nn.Conv2d(16, 16, 3, padding=1), relu=False)


def test_a_compiler_that_fails_leaves_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    failing = tmp_path / "g++"
    failing.write_text("#!/bin/sh\necho 'unknown processor' >&2\nexit 4\n")
    failing.chmod(0o755)
    monkeypatch.setattr(shutil, "which", lambda *_: str(failing))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    winograd._library.cache_clear()
    with pytest.raises(CompilerError, match="unknown processor"):
        WinogradConv2d(nn.Conv2d(16, 16, 3, padding=1), relu=False)
    assert list((tmp_path / "cache" / "dgc-pose").iterdir()) == []


@needs_compiler
def test_the_kernel_is_compiled_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    winograd._library.cache_clear()
    layer = nn.Conv2d(16, 16, 3, padding=1)
    WinogradConv2d(layer, relu=False)
    (kept,) = (tmp_path / "dgc-pose").iterdir()
    made = kept.stat().st_mtime_ns
    winograd._library.cache_clear()
    WinogradConv2d(layer, relu=False)
    assert kept.stat().st_mtime_ns == made and list(kept.parent.iterdir()) == [kept]
    winograd._library.cache_clear()
