"""The sdist and the wheel: built as for a release, installed into empty environments, and run."""

import ast
import os
import shutil
import subprocess
import sys
import tarfile
import venv
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest
from test_packaging import MAPPED, ROOT

from dgc_pose.version import version

TOP_FILES = ("setup.cfg", "setup.py", "pyproject.toml", "MANIFEST.in", "LICENSE", "README.md")
DOCUMENTS = ("CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "constraints.txt")


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
def release(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A wheel, built from the sdist of a copy of the repository, and its commit."""
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
    return build(source, "wheel"), run(*git, "rev-parse", "HEAD")


def test_a_wheel_of_the_sdist_holds_every_module_and_data_file(release: tuple[Path, str]) -> None:
    """And nothing beside the package at the top."""
    wheel_files = set(zipfile.ZipFile(release[0]).namelist())
    assert {name.split("/")[0] for name in wheel_files if ".dist-info/" not in name} == {"dgc_pose"}
    expected = {"dgc_pose/py.typed", "dgc_pose/build.txt"}
    for folder, package in MAPPED.items():
        target = package.replace(".", "/")
        for file in (ROOT / folder).rglob("*"):
            data = "__pycache__" not in file.parts and file.suffix not in (".py", ".pth", ".txt")
            if file.suffix == ".py" or (file.is_file() and data):
                expected.add(f"{target}/{file.relative_to(ROOT / folder).as_posix()}")
            if file.suffix == ".py":
                ast.parse(file.read_bytes(), str(file), feature_version=(3, 10))  # the oldest
    assert expected <= wheel_files, sorted(expected - wheel_files)
    data = "rendered/pair.txt", "photographs/image1.jpg", "photographs/NOTICE"
    assert {f"dgc_pose/data/{name}" for name in data} <= wheel_files


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
    assert "errors: rotation 0." in run(own, "-m", "dgc_pose", "demo", cwd=tmp_path)
