"""What runs the shipped weights needs no torch, and the page no COLMAP and no figures."""

import json
import subprocess
import sys
import urllib.request
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
from hidden_packages import EXTRAS, run_in, without
from multi_view import K_text, render_views, write_views

pytestmark = pytest.mark.slow

_K = ("--K1", "820,820,404.3,296.8", "--K2", "760,760,352.1,325.4")
_PAIR = [str(resources.files("dgc_pose") / "data" / "rendered" / f"image{k}.jpg") for k in (1, 2)]


def test_poses_matches_batches_and_models_are_made_without_an_extra(tmp_path: Path) -> None:
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


def test_the_page_estimates_without_torch_colmap_and_figures(tmp_path: Path) -> None:
    hidden = (*(set(EXTRAS) - {"starlette", "uvicorn"}), "pycolmap", "matplotlib")
    environment = without(tmp_path / "site", *hidden) | {"TMPDIR": str(tmp_path)}
    command = [sys.executable, "-m", "dgc_pose", "serve", "--no-browser"]
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, text=True, cwd="/"
    ) as server:
        try:
            assert server.stdout is not None
            address, token = server.stdout.readline().strip().split("?token=")

            def ask(path: str, body: bytes = b"") -> list[dict[str, Any]]:
                headers = {"x-dgc-pose-token": token, "content-type": "application/json"}
                request = urllib.request.Request(address + path, body, headers)
                with urllib.request.urlopen(request, timeout=120) as answer:
                    return [json.loads(line) for line in answer]

            (example,) = ask("example")
            image1, image2 = (one["id"] for one in example["images"])
            known = {"kind": "k", "k1": example["k"][0], "k2": example["k"][1]}
            pair = {"image1": image1, "image2": image2}
            *_, last = ask("poses", json.dumps(pair | {"camera": known}).encode())
            assert last["result"]["pose"]["success"] and last["result"]["map"] is not None
            *_, last = ask("poses", json.dumps(pair | {"camera": {"kind": "auto"}}).encode())
            assert last["result"]["pose"]["camera1"]["focal_std"] > 0
        finally:
            server.terminate()
