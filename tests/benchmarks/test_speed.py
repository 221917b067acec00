"""bench-speed: floors that are right, a table that adds up, one-line errors."""

import json
from pathlib import Path

import cv2
import pytest
import torch
from command_line import assert_refused, run
from map_nets import SMALL

from dgc_pose.benchmarks import speed
from dgc_pose.benchmarks.speed import TOTAL, multiply_adds, time_forwards
from dgc_pose.network.config import preset
from dgc_pose.network.net import DGCNet
from dgc_pose.network.weights import save_weights


def test_multiply_adds_are_those_counted_by_hand() -> None:
    """VGG-16's layers at 240 and the paper's decoders: sides^2 x 9 x inputs x outputs."""
    encoder, decoders = multiply_adds(DGCNet(preset("dgcm")).eval())
    vgg = [
        *[(240, 3, 64), (240, 64, 64)],
        *[(120, 64, 128), (120, 128, 128)],
        *[(60, 128, 256), (60, 256, 256), (60, 256, 256)],
        *[(30, 256, 512), (30, 512, 512), (30, 512, 512)],
    ]
    assert encoder == 2 * sum(9 * side**2 * inputs * outputs for side, inputs, outputs in vgg)
    levels = {240: 130, 120: 130, 60: 258, 30: 514, 15: 227}
    wanted = 0
    for side, inputs in levels.items():
        blocks = (128, 128, 96, 64, 32) if side <= 30 else (128, 96, 64, 32)
        channels = (inputs, *blocks, 2)
        wanted += sum(9 * side**2 * a * b for a, b in zip(channels, channels[1:], strict=False))
    wanted += 240**2 * (9 * (128 * 64 + 64 * 32 + 32 * 16) + 16)
    assert decoders == wanted


def test_every_way_is_timed_and_compared() -> None:
    torch.manual_seed(0)
    net = DGCNet(SMALL).eval().requires_grad_(False)
    images = [torch.randn(1, 3, 240, 240) for _ in range(2)]
    found = time_forwards("some", net, images, 1, lambda: 1e10)
    assert [one.way for one in found][:2] == ["torch, eager", "batch norm folded"]
    assert found[0].apart_px == 0 and found[0].times_faster == 1
    assert found[0].over_floor == pytest.approx(found[0].seconds / (sum(multiply_adds(net)) / 1e10))
    assert all(one.seconds > 0 and one.apart_px < 1.0 for one in found)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed, "_MATRIX", 64)
    monkeypatch.setattr(speed, "SIZE", (400, 300))


def test_the_table_adds_up(quick: None, tmp_path: Path) -> None:
    weights = tmp_path / "untrained.safetensors"
    torch.manual_seed(0)
    save_weights(DGCNet(preset("dgcm-lite0")), weights)
    out = tmp_path / "figures.json"
    words = ("--weights", weights, "--repetitions", 1, "--forward", "", "--json", out)
    result = run("bench-speed", *words)
    assert result.exit_code == 0, result.output
    data = json.loads(out.read_text())
    parts: dict[str, dict[str, float]] = {}
    for stage in data["stages"]:
        parts.setdefault(stage["part"], {})[stage["name"]] = stage["seconds"]
    assert set(parts) == {"quick", "match", "sift", "fast", "auto", "thorough"}
    for seconds in parts.values():
        total = seconds.pop(TOTAL)
        assert total == pytest.approx(sum(seconds.values())) and total > 0
    steps = {effort: set(parts[effort]) for effort in ("fast", "auto", "thorough")}
    assert all({"read", "estimate"} < names for names in steps.values())
    assert "quick" not in steps["thorough"] and "match" in steps["thorough"]
    floors = {(s["part"], s["name"]) for s in data["stages"] if s["floor_seconds"] is not None}
    of_steps = {(part, name) for part in ("quick", "match") for name in ("encoder", "pose")}
    assert floors == of_steps | {("match", "decoders")}
    assert set(data["over_sift"]) == {"fast", "auto", "thorough"}
    assert data["size"] == "400x300" and data["torch_threads"] == torch.get_num_threads()
    assert {one["network"] for one in data["forwards"]} == {"dgcm-lite0"}
    for stage in data["stages"]:
        assert stage["name"] in result.output


def test_images_of_one_s_own_need_k(quick: None, tmp_path: Path) -> None:
    image = tmp_path / "1.png"
    cv2.imwrite(str(image), torch.zeros(30, 40, 3, dtype=torch.uint8).numpy())
    assert_refused(run("bench-speed", image), "both images and K")
    assert_refused(run("bench-speed", image, "nowhere.png", "40,40,20,15"), "nowhere.png")
    assert_refused(run("bench-speed", "--forward", "vgg"), "no preset 'vgg'")
    for name in ("sift", "rocco"):
        assert_refused(run("bench-speed", "--weights", name), f"--weights {name}", "refines")
