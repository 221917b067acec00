"""The sdist and the wheel: built as for a release, installed into empty environments, and run."""

import os
import shutil
import subprocess
import sys
import tarfile
import venv
import zipfile
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import pytest
from test_packaging import MAPPED, ROOT

from dgc_pose.version import version

TOP_FILES = ("setup.cfg", "setup.py", "pyproject.toml", "MANIFEST.in", "LICENSE", "README.md")
DOCUMENTS = ("CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "constraints.txt")
PYTHONS = ("3.10", "3.11", "3.12", "3.13")
OWN = f"{sys.version_info.major}.{sys.version_info.minor}"


@dataclass(frozen=True)
class Release:
    """A wheel, built from the sdist, and the commit."""

    wheel: Path
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
    return Release(build(source, "wheel"), run(*git, "rev-parse", "HEAD"))


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


def interpreter(number: str) -> str | None:
    """A Python of this version: this one, one on the path, or one of pyenv's."""
    if number == OWN:
        return sys.executable
    root = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    paths = [*root.glob(f"versions/{number}.*/bin/python{number}"), shutil.which(f"python{number}")]
    # pyenv puts a program of each name on the path, which may lead to nothing.
    works = (p for p in paths if p and subprocess.run([p, "-c", ""]).returncode == 0)
    return next(map(str, works), None)


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
    click, needed = find_spec("click"), str(tmp_path / "needed")
    assert click is not None and click.origin is not None
    shutil.copytree(Path(click.origin).parent, Path(needed, "click"))
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


def test_an_installed_wheel_estimates_the_bundled_pair(release: Release, tmp_path: Path) -> None:
    """In an environment that has the dependencies of this one, but not the repository."""
    own = installed(sys.executable, release.wheel, tmp_path / "env")
    (packages,) = (tmp_path / "env").glob("lib/python*/site-packages")
    numpy = find_spec("numpy")
    assert numpy is not None and numpy.origin is not None
    (packages / "dependencies.pth").write_text(f"{Path(numpy.origin).parents[1]}\n")
    code = "import dgc_pose; print(dgc_pose.__file__)"
    assert Path(run(own, "-c", code, cwd=tmp_path)).is_relative_to(packages)
    assert "errors: rotation 0." in run(own, "-m", "dgc_pose", "demo", cwd=tmp_path)
