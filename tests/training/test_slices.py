"""Slices that resume each other from what fits into a few small files."""

from __future__ import annotations

import itertools
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from click.testing import CliRunner, Result
from photo_folder import write_photos

from dgc_pose.errors import InputError, WeightsError
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import load_network
from dgc_pose.training.carry import join_halves, read_parts, write_halves, write_parts
from dgc_pose.training.slices import slices


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_photos(tmp_path_factory.mktemp("photos"))


def _call(*words: object) -> Result:
    result = CliRunner().invoke(slices, [str(word) for word in words])
    assert result.exit_code == 0, (result.output, result.exception)
    return result


def _run(pack: Path, out: Path, work: Path, minutes: float) -> Result:
    words = ["run", "--pack", pack, "--out", out, "--work", work, "--preset", "dgcm-lite"]
    words += ["--minutes", minutes, "--total-minutes", 0.02, "--batch", 1, "--device", "cpu"]
    return _call(*words, "--scene-share", 0, "--validation-pairs", 1)


def test_slices_make_one_run(
    photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a clock of its own: a tenth of a second at each look, on every machine."""
    ticks = itertools.count()
    monkeypatch.setattr("dgc_pose.training.run.time.perf_counter", lambda: next(ticks) / 10)
    first, second = tmp_path / "pack1", tmp_path / "pack2"
    _call("pack", "--photos", photos, "--out", first, "--limit-mib", 3)
    out = tmp_path / "out1"
    _run(first, out, tmp_path / "bare1", 0.005)  # within the encoder's share of the schedule
    written = {path.name for path in out.iterdir()}
    halves = {"dgcm-lite-encoder.safetensors", "dgcm-lite-decoders.safetensors"}
    assert halves | {"dgcm-lite-logs.txt"} < written and "state-1-of-1" in written
    assert "encoder_validation_log.csv" in (out / "dgcm-lite-logs.txt").read_text()
    _call("pack", "--photos", photos, "--out", second, "--limit-mib", 16, "--state", out)
    _run(second, tmp_path / "out2", tmp_path / "bare2", 1)
    assert "decoders_validation_log.csv" in (tmp_path / "out2" / "dgcm-lite-logs.txt").read_text()
    left = {path.name for path in (tmp_path / "out2").iterdir()}
    assert left == halves | {"dgcm-lite-logs.txt"}
    joined = tmp_path / "dgcm-lite.safetensors"
    _call("join", tmp_path / "out2", joined)
    assert joined.read_bytes() == (tmp_path / "bare2" / "dgcm-lite.safetensors").read_bytes()
    assert load_network(joined).config.name == "dgcm-lite"


def test_a_pack_is_whole_or_not_at_all(photos: Path, tmp_path: Path) -> None:
    for words, message in (
        (["--limit-mib", 0.001], "photographs need"),
        (["--state", tmp_path], "neither a slice's state"),
    ):
        command = ["pack", "--photos", photos, "--out", tmp_path / "pack", *words]
        result = CliRunner().invoke(slices, [str(word) for word in command])
        assert isinstance(result.exception, InputError) and message in str(result.exception)
        assert not list(tmp_path.iterdir())


def test_parts_come_back_and_gaps_are_named(tmp_path: Path) -> None:
    content = bytes(range(250))
    assert read_parts(tmp_path, "state") is None
    parts = write_parts(content, tmp_path, "state", part_bytes=100)
    assert [part.stat().st_size for part in parts] == [100, 100, 50]
    assert read_parts(tmp_path, "state") == content
    parts[1].unlink()
    with pytest.raises(WeightsError, match="state-2-of-3"):
        read_parts(tmp_path, "state")


def test_halves_join_to_the_network_they_were(tmp_path: Path) -> None:
    torch.manual_seed(0)
    net = DGCNet(preset("dgcm+flow"))
    paths = write_halves(net, tmp_path)
    assert all(path.stat().st_size < 16 * 2**20 for path in paths)
    joined = join_halves(tmp_path)
    assert joined.config == net.config
    for key, value in net.state_dict().items():
        if not key.endswith("num_batches_tracked"):
            assert torch.equal(joined.state_dict()[key], value.half().float())
    other = DGCNet(preset("dgcm"))
    write_halves(other, tmp_path)
    with pytest.raises(WeightsError, match="2 files"):
        join_halves(tmp_path)
    for name in ("dgcm+flow-encoder", "dgcm-decoders"):
        (tmp_path / f"{name}.safetensors").unlink()
    with pytest.raises(WeightsError, match="two presets"):
        join_halves(tmp_path)


def test_the_code_runs_beside_torch_alone() -> None:
    """Without the estimators and the plotting, which a bare machine lacks, and uninstalled."""
    missing = ("poselib", "pycolmap", "matplotlib", "scipy")
    code = f"import sys; sys.modules.update(dict.fromkeys({missing}))\n"
    code += "import dgc_pose.training.slices as s; assert not any('cli' in m for m in sys.modules"
    code += " if m.startswith('dgc_pose'))"
    subprocess.run([sys.executable, "-c", code], check=True)
