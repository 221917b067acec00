"""Two processes that torchrun starts train as one process with the joint batch."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import joint_run
import pytest
import torch
from photos import drawn_photos
from torch import nn

from dgc_pose.errors import InputError
from dgc_pose.training.options import TrainingOptions
from dgc_pose.training.processes import join_batch_norms
from dgc_pose.training.run import Trainer


def _torchrun(script: str, *words: str) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "torch.distributed.run", "--nproc-per-node", "2"]
    command += ["--master-addr", "127.0.0.1", "--master-port", str(port), script, *words]
    done = subprocess.run(
        command, env={**os.environ, "OMP_NUM_THREADS": "1"}, capture_output=True, timeout=300
    )
    assert done.returncode == 0, done.stderr.decode()[-3000:]


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder where two processes left what they found."""
    folder = tmp_path_factory.mktemp("two")
    _torchrun(joint_run.__file__, str(folder))
    return folder


def test_two_processes_equal_one_with_the_joint_batch(two: Path, tmp_path: Path) -> None:
    together = torch.load(two / "result.pt", weights_only=True)
    one = joint_run.joint_run(tmp_path)
    for stage in joint_run.PROGRESS:
        found, expected = together[stage], one[stage]
        assert found["first"] == pytest.approx(expected["first"], rel=1e-4), stage
        assert len(found["gradients"]) == len(expected["gradients"]) > 10
        gradient, wanted = (
            torch.cat([g.flatten() for g in result["gradients"]]) for result in (found, expected)
        )
        # The encoder's gradient in single precision is itself 1 % off that in double precision.
        tolerance = 0.03 if stage == "encoder" else 1e-3
        assert (gradient - wanted).norm() < tolerance * wanted.norm(), stage
        # AdamW's first step is the gradient's sign: where that is all but zero, rounding decides.
        assert found["second"]["loss"] == pytest.approx(expected["second"]["loss"], rel=1e-3)
        for key, value in expected["net"].items():
            assert (found["net"][key] - value).abs().max() < 0.01, key


def test_joint_norms_equal_one_norm_of_the_whole_batch(two: Path) -> None:
    halves = [torch.load(two / f"norm{rank}.pt", weights_only=True) for rank in (0, 1)]
    whole = joint_run.joint_norm()
    for key in ("output", "input"):
        torch.testing.assert_close(torch.cat([half.pop(key) for half in halves]), whole.pop(key))
    for half in halves:
        for key, value in whole.items():
            torch.testing.assert_close(half[key], value, msg=lambda text, k=key: f"{k}: {text}")


def test_joint_norms_alone_are_the_norms_they_were() -> None:
    torch.manual_seed(0)
    plain = nn.Sequential(nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4))
    joint = nn.Sequential(nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4))
    joint.load_state_dict(plain.state_dict())
    join_batch_norms(joint)
    images = torch.rand(2, 3, 8, 8)
    torch.testing.assert_close(joint(images), plain(images))
    for key, value in plain.state_dict().items():
        assert torch.equal(joint.state_dict()[key], value)


def test_a_batch_that_does_not_divide_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dgc_pose.training.run.process_count", lambda: 2)
    photos = drawn_photos(4, 64)
    options = TrainingOptions("dgcm-lite0", 1.0, validation_count=1, batch=3)
    with pytest.raises(InputError, match="3 pairs do not divide into 2 parts"):
        Trainer((photos, photos), tmp_path / "run", options)
    assert not (tmp_path / "run").exists()
