"""What setup.cfg says of the package, a release, and what runs, and is told, without the extras."""

import ast
import configparser
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import venv
import zipfile
from importlib import resources
from importlib.util import find_spec
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from worlds import K_text, render_views, write_views

from dgc_pose import errors
from dgc_pose.matching.lightglue import FORMAT
from dgc_pose.version import version

ROOT = Path(__file__).resolve().parents[1]
# The folders that setup.cfg maps into the import root.
MAPPED = {
    "dgc_pose": "dgc_pose",
    "cli": "dgc_pose.cli",
    "benchmarks": "dgc_pose.benchmarks",
    "training": "dgc_pose.training",
}


def pins(file: str) -> dict[str, str]:
    """The version of each distribution that a file of pins names."""
    pairs = re.findall(r"^([\w.-]+)==([^\s+]+)", (ROOT / file).read_text(), re.MULTILINE)
    return {name.lower().replace("_", "-"): version for name, version in pairs}


def test_every_dependency_is_pinned_within_its_range_and_told_where_it_is_missing() -> None:
    """Told with the extra that has it."""
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg")
    texts = {"": setup["options"]["install_requires"], **setup["options.extras_require"]}
    listed = {
        extra: [Requirement(line) for line in text.splitlines() if line and line[0] != "#"]
        for extra, text in texts.items()
    }
    wanted = [one for some in listed.values() for one in some if one.name != "dgc-pose"]
    assert len(wanted) > 10
    for requirement in wanted:
        assert requirement.specifier.contains(pins("constraints.txt")[requirement.name])
    assert pins("constraints-hashes.txt") == pins("constraints.txt")
    for extra, modules in errors.EXTRAS.items():
        names = {requirement.name for requirement in listed[extra]}
        assert set(modules.values()) == names


def run(*command: object, cwd: Path = Path("/"), **environment: str) -> str:
    """What a command prints; the test fails, with its stderr, if it does."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [*map(str, command)], cwd=cwd, env=kept | environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout.strip()


def build(source: Path, kind: str) -> Path:
    """The sdist or the wheel of a source tree. It is built by setuptools itself, without the
    environment that pip would download for it."""
    code = f"from setuptools import build_meta; build_meta.build_{kind}('dist')"
    run(sys.executable, "-c", code, cwd=source)
    (built,) = (source / "dist").iterdir()
    return built


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A wheel, built from the sdist of a copy of the repository, and its commit."""
    folder = tmp_path_factory.mktemp("release")
    unwanted = (
        "tests",
        "docs",
        "lightglue",
        "build*",
        "dist",
        "shared",
        "*.egg-info",
        ".*",
        "__pycache__",
    )
    copy = shutil.copytree(ROOT, folder / "source", ignore=shutil.ignore_patterns(*unwanted))
    shutil.copy(ROOT / ".gitignore", copy)
    git = ("git", "-C", copy, "-c", "user.name=a", "-c", "user.email=a@b.c")
    for arguments in (("init", "-q"), ("add", "-A"), ("commit", "-q", "-m", "all")):
        run(*git, *arguments)
    with tarfile.open(build(copy, "sdist")) as archive:
        archive.extractall(folder / "unpacked", filter="data")
    (source,) = (folder / "unpacked").iterdir()
    return build(source, "wheel"), run(*git, "rev-parse", "HEAD")


@pytest.mark.slow
def test_a_wheel_of_the_sdist_holds_every_module_and_data_file(release: tuple[Path, str]) -> None:
    """And nothing beside the package at the top."""
    wheel_files = set(zipfile.ZipFile(release[0]).namelist())
    assert {name.split("/")[0] for name in wheel_files if ".dist-info/" not in name} == {"dgc_pose"}
    expected = {"dgc_pose/py.typed", "dgc_pose/build.txt"}
    for folder, package in MAPPED.items():
        target = package.replace(".", "/")
        for file in (ROOT / folder).rglob("*"):
            data = "__pycache__" not in file.parts and file.suffix not in (".py", ".pth")
            if file.suffix == ".py" or (file.is_file() and data):
                expected.add(f"{target}/{file.relative_to(ROOT / folder).as_posix()}")
            if file.suffix == ".py":
                ast.parse(file.read_bytes(), str(file), feature_version=(3, 10))  # the oldest
    assert expected <= wheel_files, sorted(expected - wheel_files)
    data = "rendered/pair.txt", "photographs/image1.jpg", "photographs/NOTICE"
    assert {f"dgc_pose/data/{name}" for name in data} <= wheel_files


@pytest.mark.slow
def test_an_installed_wheel_runs(release: tuple[Path, str], tmp_path: Path) -> None:
    """In an environment that has the dependencies of this one, but not the repository."""
    venv.create(tmp_path / "env")
    own = tmp_path / "env" / "bin" / "python"
    flags = ("-q", "--no-deps", "--no-index", "--no-compile")
    run(sys.executable, "-m", "pip", "--python", own, "install", *flags, release[0])
    (packages,) = (tmp_path / "env").glob("lib/python*/site-packages")
    numpy = find_spec("numpy")
    assert numpy is not None and numpy.origin is not None
    (packages / "dependencies.pth").write_text(f"{Path(numpy.origin).parents[1]}\n")
    code = "import dgc_pose; print(dgc_pose.__file__)"
    assert Path(run(own, "-c", code, cwd=tmp_path)).is_relative_to(packages)
    text = run(own.with_name("dgc-pose"), "--version", cwd=tmp_path)
    shown, build_of = text.removeprefix("dgc-pose ").removesuffix(")").split(" (build ")
    assert shown == version()
    assert release[1].startswith(build_of) and len(build_of) >= 7
    assert "the known pose:" in run(own, "-m", "dgc_pose", "demo", cwd=tmp_path)


def test_the_wheel_of_lightglue_holds_its_data_and_the_licences(tmp_path: Path) -> None:
    source = tmp_path / "lightglue"
    unwanted = shutil.ignore_patterns("__pycache__", "build", "*.egg-info")
    shutil.copytree(ROOT / "lightglue", source, ignore=unwanted)
    wheel = build(source, "wheel")
    assert wheel.name == f"dgc_pose_lightglue-{FORMAT}.0.0-py3-none-any.whl"
    files = set(zipfile.ZipFile(wheel).namelist())
    data = {path.name for path in (source / "dgc_pose_lightglue").iterdir()}
    assert {"aliked.onnx", "layer.onnx", "weights.json", "weights.safetensors"} <= data
    assert {f"dgc_pose_lightglue/{name}" for name in data} <= files
    licences = wheel.name.replace("-py3-none-any.whl", ".dist-info/licenses/")
    assert {f"{licences}{name}" for name in ("LICENSE", "LICENSE-ALIKED", "NOTICE")} <= files
    assert {name.split("/")[0] for name in files} == {"dgc_pose_lightglue", licences.split("/")[0]}


# Read by each Python process that starts, also by the workers of a command.
_SITE = """
import os, sys
from importlib.machinery import PathFinder

class Finder(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        hidden = name.split(".")[0] in os.environ["HIDDEN_PACKAGES"].split(",")
        return None if hidden else super().find_spec(name, path, target)

sys.meta_path[sys.meta_path.index(PathFinder)] = Finder
"""


@pytest.fixture
def bare(tmp_path: Path) -> dict[str, str]:
    """The environment of processes that lack the packages of every extra."""
    site = tmp_path / "site"
    site.mkdir()
    (site / "sitecustomize.py").write_text(_SITE)
    modules = *errors.EXTRAS.values(), *errors.FOLDERS.values()
    hidden = ",".join(name for names in modules for name in names)
    return os.environ | {"PYTHONPATH": str(site), "HIDDEN_PACKAGES": hidden}


DGC_POSE = (sys.executable, "-m", "dgc_pose")
_PAIR = [str(resources.files("dgc_pose") / "data" / "rendered" / f"image{k}.jpg") for k in (1, 2)]
_K = ("--K1", "820,820,404.3,296.8", "--K2", "760,760,352.1,325.4")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            ("estimate", *_PAIR, *_K, "--weights", "{}/dgcm.pth"),
            "dgcm.pth needs torch, which is not installed: pip install '.[torch]'",
        ),
        (
            ("serve",),
            "serve needs starlette and uvicorn, which are not installed: pip install '.[serve]'",
        ),
        (
            ("estimate", "{}/1.heic", "{}/1.heic", *_K),
            "{}/1.heic is HEIC, which needs pillow-heif: pip install '.[heic]'",
        ),
        (
            ("estimate", *_PAIR, *_K, "--weights", "aliked-lightglue"),
            "aliked-lightglue needs dgc_pose_lightglue, which is not installed: "
            "pip install ./lightglue",
        ),
    ],
    ids=("torch", "serve", "heic", "lightglue"),
)
def test_what_a_command_lacks_is_told_with_the_command_that_installs_it(
    bare: dict[str, str], tmp_path: Path, words: tuple[str, ...], told: str
) -> None:
    (tmp_path / "dgcm.pth").touch()
    (tmp_path / "1.heic").write_bytes(b"\0\0\0\x18ftypheic" + bytes(2000))
    command = [*DGC_POSE, *(word.replace("{}", str(tmp_path)) for word in words)]
    done = subprocess.run(command, env=bare, capture_output=True, text=True, cwd="/")
    lines = [line for line in done.stderr.splitlines() if not line.startswith("warning: ")]
    assert (done.returncode, lines) == (2, ["error: " + told.replace("{}", str(tmp_path))])


@pytest.mark.slow
def test_poses_matches_batches_and_models_are_made_without_an_extra(
    bare: dict[str, str], tmp_path: Path
) -> None:
    """And every command has its help."""
    code = (
        "import click; from dgc_pose.cli.main import SUBCOMMANDS, main\n"
        "for name in SUBCOMMANDS: main.get_command(click.Context(main), name)"
    )
    run(sys.executable, "-c", code, **bare)
    outputs = ("--json", "-", "--plot", tmp_path / "pose.png", "--map", tmp_path / "map.npz")
    assert json.loads(run(*DGC_POSE, "estimate", *_PAIR, *_K, *outputs, **bare))["success"]
    run(*DGC_POSE, "info", **bare)
    photos, batch, model = (tmp_path / name for name in ("photos", "batch", "model"))
    write_views(photos, render_views(4))
    words = (photos, "--K", K_text(), "--workers", 2, "--out")
    run(*DGC_POSE, "batch", *words, batch, "--pairs", "sequential:1", **bare)
    rows = [json.loads(line) for line in (batch / "pairs.jsonl").read_text().splitlines()]
    assert [row["status"] for row in rows] == ["ok"] * 3
    run(*DGC_POSE, "reconstruct", *words, model, **bare)
    assert json.loads((model / "summary.json").read_text())["registered"] == 4


def test_a_module_that_a_library_lacks_is_no_missing_package() -> None:
    """torch is installed: a missing submodule does not mean that torch is missing."""
    assert errors.missing_package(ModuleNotFoundError(name="torch.no_such_part")) is None
    assert errors.missing_package(ModuleNotFoundError(name="no_such_package")) is None
