"""What runs the shipped weights imports no torch, and needs none."""

import json
import os
import subprocess
import sys
import urllib.request
from importlib import resources
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
_K = ("--K", "460,460,319.5,239.5")
_LENS = "OPENCV,800,600,820,820,404.8,297.3,0.1,0,0,0"
_PAIR = [str(resources.files("dgc_pose") / "data" / "demo" / f"image{k}.jpg") for k in (1, 2)]


@pytest.fixture(scope="module")
def light_site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of the packages of requirements-light.txt and of no others."""
    site = tmp_path_factory.mktemp("site")
    for line in (ROOT / "requirements-light.txt").read_text().splitlines():
        if not line.startswith("#"):
            package = distribution(line.split("==")[0])
            tops = {file.parts[0] for file in package.files or ()}
            for name in tops - {"..", "__pycache__"}:
                (site / name).symlink_to(Path(str(package.locate_file(name))))
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
    options = [*_K, "--device", "cpu", "--json", str(out)]
    said = _run(_COMMAND, os.pathsep.join(sys.path), "estimate", *_PAIR, *options)
    assert said.splitlines()[-1] == "False"
    assert json.loads(out.read_text())["success"]


def _light(site: Path, *arguments: str) -> str:
    return _run(_COMMAND, str(site), *arguments, flags=("-S",))


def test_the_light_set_estimates_and_runs_batches_and_benchmarks(
    light_site: Path, tmp_path: Path
) -> None:
    out, pairs = tmp_path / "pose.json", tmp_path / "pairs.txt"
    _light(light_site, "estimate", *_PAIR, *_K, "--json", str(out))
    assert json.loads(out.read_text())["success"]
    numbers = "460 0 319.5 0 460 239.5 0 0 1 " * 2 + "1 0 0 1 0 1 0 0 0 0 1 0 0 0 0 1"
    pairs.write_text(f"{_PAIR[0]} {_PAIR[1]} 0 0 {numbers}\n")
    said = _light(light_site, "bench-pairs", str(pairs), "--methods", "dgcm-lite0")
    assert "dgcm-lite0" in said
    listed, results = Path(_PAIR[0]).with_name("pair.txt"), tmp_path / "batch"
    _light(light_site, "batch", str(listed), "--out", str(results))
    (row,) = map(json.loads, (results / "pairs.jsonl").read_text().splitlines())
    assert row["status"] == "ok"


def test_the_light_set_serves_a_pose(light_site: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-S", "-m", "dgc_pose", "serve", "--no-browser"]
    environment = os.environ | {"PYTHONPATH": str(light_site), "TMPDIR": str(tmp_path)}
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


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (("estimate", *_PAIR, *_K, "--plot", "plot.png"), "matplotlib"),
        (("estimate", *_PAIR, "--K1", _LENS, "--K2", "auto"), "pycolmap"),
        (("bench-pairs", "--rendered", "1", "--photos", "."), "torch"),
        (("bench-dtu",), "scipy"),
        (("bench-speed",), "torch"),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else value,
)
def test_what_the_light_set_lacks_is_told_in_one_line(
    light_site: Path, tmp_path: Path, arguments: tuple[str, ...], name: str
) -> None:
    command = [sys.executable, "-S", "-c", _COMMAND, *arguments]
    environment = os.environ | {"PYTHONPATH": str(light_site)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, cwd=tmp_path)
    expected = f"error: this needs {name}, which is not installed: pip install {name}"
    assert done.stderr.splitlines()[0] == expected
    assert list(tmp_path.iterdir()) == []
