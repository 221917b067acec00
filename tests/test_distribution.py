"""The sdist and the wheel: built as for a release, installed into empty environments, and run."""

import os
import shutil
import subprocess
import sys
import tarfile
import urllib.request
import venv
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from email import message_from_bytes
from importlib.util import find_spec
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from test_packaging import MAPPED, ROOT

from dgc_pose.version import version

TOP_FILES = ("setup.cfg", "setup.py", "pyproject.toml", "MANIFEST.in", "LICENSE", "README.md")
DOCUMENTS = ("CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "constraints.txt")
PYTHONS = ("3.10", "3.11", "3.12", "3.13")
OWN = f"{sys.version_info.major}.{sys.version_info.minor}"


@dataclass(frozen=True)
class Release:
    """What a release consists of."""

    sdist: Path
    wheel: Path  # built from the sdist
    commit: str


def run(*command: str | Path, cwd: Path | None = None, **environment: str) -> str:
    """What a command prints; the test fails, with its stderr, if it does."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, env=kept | environment, capture_output=True, text=True
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
def release(tmp_path_factory: pytest.TempPathFactory) -> Release:
    """Built from a commit of a copy of the repository."""
    copy, unpacked = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("unpacked")
    unwanted = shutil.ignore_patterns("__pycache__", "build.txt")
    for folder in MAPPED:
        shutil.copytree(ROOT / folder, copy / folder, ignore=unwanted)
    for name in (*TOP_FILES, *DOCUMENTS):
        shutil.copy(ROOT / name, copy)
    (copy / ".gitignore").write_text("build/\ndist/\n*.egg-info/\n__pycache__/\n")
    git = ("git", "-C", copy, "-c", "user.name=a", "-c", "user.email=a@b.c")
    for arguments in (("init", "-q"), ("add", "-A"), ("commit", "-q", "-m", "all")):
        run(*git, *arguments)
    sdist = build(copy, "sdist")
    with tarfile.open(sdist) as archive:
        archive.extractall(unpacked, filter="data")
    (source,) = unpacked.iterdir()
    return Release(sdist, build(source, "wheel"), run(*git, "rev-parse", "HEAD"))


def test_a_wheel_of_the_sdist_holds_every_module_and_data_file(release: Release) -> None:
    """And nothing beside the package at the top."""
    wheel_files = set(zipfile.ZipFile(release.wheel).namelist())
    assert {name.split("/")[0] for name in wheel_files if ".dist-info/" not in name} == {"dgc_pose"}
    expected = {"dgc_pose/py.typed", "dgc_pose/build.txt"}
    for folder, package in MAPPED.items():
        target = package.replace(".", "/")
        for file in (ROOT / folder).rglob("*"):
            data = "__pycache__" not in file.parts and file.suffix not in (".py", ".pth", ".txt")
            if file.suffix == ".py" or (file.is_file() and data):
                expected.add(f"{target}/{file.relative_to(ROOT / folder).as_posix()}")
    assert expected <= wheel_files, sorted(expected - wheel_files)
    assert "dgc_pose/benchmarks/dtu/__init__.py" in wheel_files
    assert "dgc_pose/data/demo/pair.txt" in wheel_files


def test_the_sdist_holds_what_the_wheel_is_built_from(release: Release) -> None:
    with tarfile.open(release.sdist) as archive:
        names = {name.split("/", 1)[1] for name in archive.getnames() if "/" in name}
    assert {*TOP_FILES, *DOCUMENTS, "cli/main.py", "benchmarks/scoring.py"} <= names
    assert release.sdist.name == f"dgc_pose-{version()}.tar.gz"


def test_the_wheels_metadata_are_those_of_the_package(release: Release) -> None:
    with zipfile.ZipFile(release.wheel) as archive:
        (name,) = (n for n in archive.namelist() if n.endswith(".dist-info/METADATA"))
        metadata = message_from_bytes(archive.read(name))
    assert metadata["Version"] == version()
    assert metadata["Requires-Python"] == ">=3.10"
    assert metadata["License-Expression"] == "Apache-2.0"
    needed = [Requirement(line) for line in metadata.get_all("Requires-Dist")]
    base = {requirement.name for requirement in needed if requirement.marker is None}
    assert {"onnxruntime", "pycolmap", "matplotlib"} <= base
    assert not base & {"torch", "scipy", "starlette", "uvicorn", "ray"}
    extras = {"torch", "serve", "heic", "ray", "fit", "notebook", "all"}
    assert extras <= set(metadata.get_all("Provides-Extra"))
    pythons = {f"Programming Language :: Python :: {number}" for number in PYTHONS}
    assert pythons <= set(metadata.get_all("Classifier"))


def interpreter(number: str) -> str | None:
    """A Python of this version: this one, one on the path, or one of pyenv's."""
    if number == OWN:
        return sys.executable
    root = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    installed = sorted(root.glob(f"versions/{number}.*/bin/python{number}"))
    on_path = shutil.which(f"python{number}")
    for path in (*map(str, installed), *([on_path] if on_path else [])):
        # pyenv puts a program of each name on the path, which may lead to nothing.
        if subprocess.run([path, "-c", ""], capture_output=True).returncode == 0:
            return path
    return None


def installed(python: str, wheel: Path, folder: Path) -> Path:
    """The interpreter of an environment that holds the wheel and nothing else."""
    if python == sys.executable:
        venv.create(folder)
    else:
        run(python, "-m", "venv", "--without-pip", folder)
    own = folder / "bin" / "python"
    flags = ("-q", "--no-deps", "--no-index", "--no-compile")
    run(sys.executable, "-m", "pip", "--python", own, "install", *flags, wheel)
    return own


@pytest.mark.parametrize("number", PYTHONS)
def test_every_python_installs_the_wheel_and_runs_the_command(
    release: Release, tmp_path: Path, number: str
) -> None:
    """Of the dependencies there is click alone: `--version` and `--help` need no more."""
    python = interpreter(number)
    if python is None:
        pytest.skip(f"no Python {number} on this machine")
    own = installed(python, release.wheel, tmp_path / "env")
    for name in ("click", "typing_extensions"):
        spec = find_spec(name)
        assert spec is not None and spec.origin is not None
        origin = Path(spec.origin)
        if origin.name == "__init__.py":
            shutil.copytree(origin.parent, tmp_path / "needed" / name)
        else:
            shutil.copy(origin, tmp_path / "needed" / origin.name)
    needed = str(tmp_path / "needed")
    (package,) = (tmp_path / "env").glob("lib/python*/site-packages/dgc_pose")
    # Every module is written in this version's language.
    code = (
        "import ast, pathlib, sys\n"
        "files = list(pathlib.Path(sys.argv[1]).rglob('*.py'))\n"
        "print(sum(ast.parse(file.read_bytes()) is not None for file in files))"
    )
    assert int(run(own, "-c", code, package, cwd=tmp_path)) > 150
    script = tmp_path / "env" / "bin" / "dgc-pose"
    text = run(script, "--version", cwd=tmp_path, PYTHONPATH=needed)
    shown, build_of = text.removeprefix("dgc-pose ").removesuffix(")").split(" (build ")
    assert shown == version()
    assert release.commit.startswith(build_of) and len(build_of) >= 7
    help_text = run(own, "-m", "dgc_pose", "--help", cwd=tmp_path, PYTHONPATH=needed)
    assert help_text.startswith("Usage: python -m dgc_pose ")


def test_an_installed_wheel_estimates_the_bundled_pair_and_serves_the_page(
    release: Release, tmp_path: Path
) -> None:
    """In an environment that has the dependencies of this one, but not the repository."""
    own = installed(sys.executable, release.wheel, tmp_path / "env")
    (packages,) = (tmp_path / "env").glob("lib/python*/site-packages")
    numpy = find_spec("numpy")
    assert numpy is not None and numpy.origin is not None
    (packages / "dependencies.pth").write_text(f"{Path(numpy.origin).parents[1]}\n")
    code = "import dgc_pose; print(dgc_pose.__file__)"
    assert Path(run(own, "-c", code, cwd=tmp_path)).is_relative_to(packages)
    text = run(own, "-m", "dgc_pose", "demo", cwd=tmp_path)
    assert "errors: rotation 0." in text
    files = {file.name: file for file in (ROOT / "dgc_pose" / "serve" / "static").iterdir()}
    del files["page.html"]  # has the token put in
    with served(own, tmp_path) as get:
        assert version().encode() in get("")
        for name, file in files.items():
            assert get(f"static/{name}") == file.read_bytes()


@contextmanager
def served(python: Path, folder: Path) -> Iterator[Callable[[str], bytes]]:
    """Runs `dgc-pose serve` in the folder; what it answers to a request of a path."""
    command = [python, "-m", "dgc_pose", "serve", "--no-browser"]
    environment = {**os.environ, "TMPDIR": str(folder)}
    with subprocess.Popen(
        command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True
    ) as server:
        try:
            assert server.stdout is not None
            address, token = server.stdout.readline().strip().split("?token=")

            def get(path: str) -> bytes:
                with urllib.request.urlopen(f"{address}{path}?token={token}", timeout=60) as answer:
                    return bytes(answer.read())

            yield get
        finally:
            server.terminate()
