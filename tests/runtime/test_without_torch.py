"""What runs the shipped weights needs no torch."""

import json
from importlib import resources

import pytest
from hidden_packages import EXTRAS, run_in, without
from worlds import K_text, render_views, write_views

pytestmark = pytest.mark.slow

_K = ("--K1", "820,820,404.3,296.8", "--K2", "760,760,352.1,325.4")
_PAIR = [str(resources.files("dgc_pose") / "data" / "rendered" / f"image{k}.jpg") for k in (1, 2)]


def test_poses_matches_batches_and_models_are_made_without_an_extra(tmp_path):
    """In processes of their own, in which torch and all packages of the extras are missing."""
    environment = without(tmp_path / "site", *EXTRAS)

    def run(*words: object) -> None:
        done = run_in(environment, *words)
        assert done.returncode == 0, done.stderr

    pose, matches = tmp_path / "pose.json", tmp_path / "matches.npz"
    run("estimate", *_PAIR, *_K, "--json", pose, "--plot", tmp_path / "pose.png")
    assert json.loads(pose.read_text())["success"] and (tmp_path / "pose.png").is_file()
    run("match", *_PAIR, "--out", matches)
    assert matches.is_file()
    photos, batch, model = (tmp_path / name for name in ("photos", "batch", "model"))
    write_views(photos, render_views(4))
    K = ("--K", K_text())
    run("batch", photos, "--pairs", "sequential:1", *K, "--out", batch, "--workers", 2)
    rows = [json.loads(line) for line in (batch / "pairs.jsonl").read_text().splitlines()]
    assert [row["status"] for row in rows] == ["ok"] * 3
    run("reconstruct", photos, *K, "--out", model, "--workers", 1)
    assert json.loads((model / "summary.json").read_text())["registered"] == 4
    assert (model / "points.ply").is_file() and (model / "model.html").is_file()
