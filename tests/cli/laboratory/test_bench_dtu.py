"""bench-dtu from a scan on the disk to the results, in both protocols."""

import csv
import os
from pathlib import Path

import dtu_layout
import numpy as np
import pytest
from command_line import run

pytestmark = pytest.mark.slow

FAST = ("--runs", "1", "--iterations", "100")


@pytest.fixture(scope="module")
def dtu(tmp_path_factory) -> Path:
    """A rendered scan."""
    root = tmp_path_factory.mktemp("dtu")
    dtu_layout.write_raw(root, dtu_layout.rendered_scan())
    return root


@pytest.fixture(scope="module")
def flows(tmp_path_factory) -> Path:
    """The true flows of all pairs of the rendered scan, where the views see the same points."""
    folder = tmp_path_factory.mktemp("flows")
    scan = dtu_layout.rendered_scan()
    for view1 in scan.views:
        for view2 in scan.views:
            if view1 < view2:
                np.save(folder / f"scan65_{view1}_{view2}.npy", _true_flow(scan, view1, view2))
    return folder


def _true_flow(scan: dtu_layout.Scan, number1: int, number2: int) -> np.ndarray:
    """Each pixel of view 2 into space by its depth, and into view 1; NaN where that is hidden."""
    one, two = scan.views[number1], scan.views[number2]
    height, width = scan.depths[number2].shape
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(two.K).T
    world = (rays * scan.depths[number2][..., None] - two.t) @ two.R
    seen = (world @ one.R.T + one.t) @ one.K.T
    place = seen[..., :2] / seen[..., 2:]
    u, v = np.clip(np.rint(place), 0, (width - 1, height - 1)).astype(int).transpose(2, 0, 1)
    hidden = np.abs(scan.depths[number1][v, u] / seen[..., 2] - 1) > 0.02
    flow = place - np.stack([x, y], -1)
    flow[hidden] = np.nan
    return flow


def bench(*arguments: object, code: int = 0) -> str:
    result = run("bench-dtu", *arguments, *FAST)
    assert result.exit_code == code, result.output
    return result.stdout if code == 0 else result.stderr


def table(folder: Path) -> list[dict[str, str]]:
    with (folder / "results.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.parametrize("protocol", ["paper", "native"])
def test_true_flows_give_the_true_poses(dtu, flows, tmp_path, protocol) -> None:
    """All the way from files to errors: cameras, scales and the direction of the map are right."""
    bench(
        *("--root", dtu, "--out", tmp_path / "run", "--pairs", 4, "--protocol", protocol),
        *("--methods", "true/all,true", "--matches", f"true={flows}"),
    )
    for row in table(tmp_path / "run"):
        assert row["success"] == "True"
        assert float(row["rotation_error_deg"]) < 0.5
        assert float(row["translation_error_deg"]) < 1.5
        assert float(row["epipolar_confident_px"]) < 0.02
        assert int(row["num_matches"]) > 1500


def results(folder: Path) -> list[dict[str, str]]:
    """The rows without their times."""
    return [{k: v for k, v in row.items() if "seconds" not in k} for row in table(folder)]


def test_a_finished_run_is_only_shown_again_and_its_list_gives_it_again(dtu, tmp_path) -> None:
    out, other = tmp_path / "run", tmp_path / "other"
    common = ("--root", dtu, "--methods", "sift,dis")
    text = bench(*common, "--out", out, "--pairs", 2)
    assert "1 scenes, 44 views left out" in text and "2 pairs, paper protocol" in text
    assert text.splitlines()[-1].startswith("dis ")
    files = ["errors.png", "pairs.txt", "results.csv", "run.json", "summary.json"]
    assert sorted(os.listdir(out)) == files
    rows = (out / "results.csv").read_bytes()
    (out / "errors.png").unlink()
    assert "2 of 2 pairs are done already" in bench(*common, "--out", out, "--pairs", 2, "--resume")
    assert (out / "results.csv").read_bytes() == rows and sorted(os.listdir(out)) == files
    assert "--resume continues" in bench(*common, "--out", out, code=2)
    bench(*common, "--out", other, "--pairs", out / "pairs.txt")
    assert results(other) == results(out)
    assert (other / "pairs.txt").read_bytes() == (out / "pairs.txt").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("--scenes", "six"), "--scenes takes numbers"),
        (("--pairs", "0"), "must be at least 1"),
        (("--pairs", "nowhere.txt"), "nowhere.txt"),
        (("--methods", "nowhere.pth"), "nowhere.pth: no such weights"),
        (("--matches", "raft"), "NAME=DIR"),
        (("--matches", "raft=nowhere"), "nowhere/scan65_"),
    ],
)
def test_what_cannot_be_run_leaves_nothing(dtu, tmp_path, monkeypatch, arguments, reason) -> None:
    monkeypatch.chdir(tmp_path)
    methods = () if "--methods" in arguments else ("--methods", "dis")
    error = bench("--root", dtu, "--out", "run", *methods, *arguments, code=2)
    assert error.startswith("error: ") and reason in error and error.count("\n") == 1
    assert os.listdir(tmp_path) == []
