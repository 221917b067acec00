"""What runs the shipped weights imports no torch, and needs none."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib import resources
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
_PAIR = [str(resources.files("dgc_pose") / "data" / "demo" / f"image{k}.jpg") for k in (1, 2)]


@pytest.fixture(scope="module")
def light_site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of packages like the installed ones, without torch."""
    site = tmp_path_factory.mktemp("site")
    for folder in map(Path, sys.path):
        if folder.name in ("site-packages", "dist-packages"):
            for entry in folder.iterdir():
                known = entry.name.lower().startswith(("torch", "functorch", "dgc_pose"))
                if not known and not (site / entry.name).exists():
                    (site / entry.name).symlink_to(entry)
    package = site / "dgc_pose"
    package.mkdir()
    for entry in (ROOT / "dgc_pose").iterdir():
        (package / entry.name).symlink_to(entry)
    for name in ("cli", "benchmarks"):
        (package / name).symlink_to(ROOT / name)
    return site


def _run(code: str, path: str, *arguments: str, flags: tuple[str, ...] = ()) -> str:
    command = [sys.executable, *flags, "-c", code, *arguments]
    environment = os.environ | {"PYTHONPATH": path}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, cwd="/")
    assert done.returncode == 0, done.stderr
    return done.stdout


_COMMAND = """
import sys
from dgc_pose.cli.main import main
try:
    main(sys.argv[1:])
except SystemExit as end:
    assert not end.code, end.code
print("torch" in sys.modules)
"""


def test_a_pose_is_estimated_and_torch_is_not_imported(tmp_path: Path) -> None:
    out = tmp_path / "pose.json"
    options = ["--K", "460,460,319.5,239.5", "--device", "cpu", "--json", str(out)]
    said = _run(_COMMAND, os.pathsep.join(sys.path), "estimate", *_PAIR, *options)
    assert said.splitlines()[-1] == "False"
    assert json.loads(out.read_text())["success"]


def test_where_torch_is_not_installed_poses_are_estimated_and_benchmarks_run(
    light_site: Path, tmp_path: Path
) -> None:
    with pytest.raises(AssertionError, match="No module named 'torch'"):
        _run("import torch", str(light_site), flags=("-S",))
    out, pairs = tmp_path / "pose.json", tmp_path / "pairs.txt"
    options = ["--K", "460,460,319.5,239.5", "--json", str(out)]
    _run(_COMMAND, str(light_site), "estimate", *_PAIR, *options, flags=("-S",))
    assert json.loads(out.read_text())["success"]
    numbers = "460 0 319.5 0 460 239.5 0 0 1 " * 2 + "1 0 0 1 0 1 0 0 0 0 1 0 0 0 0 1"
    pairs.write_text(f"{_PAIR[0]} {_PAIR[1]} 0 0 {numbers}\n")
    methods = ["--methods", "dgcm-lite0"]
    said = _run(_COMMAND, str(light_site), "bench-pairs", str(pairs), *methods, flags=("-S",))
    assert "dgcm-lite0" in said
    refused = 'import dgc_pose; dgc_pose.load_matcher(runtime="torch")'
    with pytest.raises(AssertionError, match="needs torch, which is not installed"):
        _run(refused, str(light_site), flags=("-S",))
