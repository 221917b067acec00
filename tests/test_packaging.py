"""What an installation consists of, and that importing the package stays cheap."""

from __future__ import annotations

import configparser
import importlib
import shutil
import subprocess
import sys
import zipfile
from importlib.metadata import entry_points
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
# The folders that setup.cfg maps into the import root.
MAPPED = {"dgc_pose": "dgc_pose", "cli": "dgc_pose.cli", "benchmarks": "dgc_pose.benchmarks"}


@pytest.fixture(scope="module")
def options() -> configparser.SectionProxy:
    parser = configparser.ConfigParser()
    parser.read(ROOT / "setup.cfg")
    return parser["options"]


def packages_on_disk() -> set[str]:
    found = set()
    for folder, package in MAPPED.items():
        for module in (ROOT / folder).rglob("*.py"):
            inside = module.parent.relative_to(ROOT / folder).parts
            found.add(".".join((package, *inside)))
    return found


def test_every_package_is_listed_and_every_listed_one_exists(
    options: configparser.SectionProxy,
) -> None:
    assert set(options["packages"].split()) == packages_on_disk()


def test_every_package_is_a_package() -> None:
    for folder in MAPPED:
        for module in (ROOT / folder).rglob("*.py"):
            assert (module.parent / "__init__.py").is_file(), f"{module.parent} has no __init__.py"


@pytest.fixture(scope="module")
def wheel_files(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """The names in a wheel built from a copy of the repository."""
    copy = tmp_path_factory.mktemp("wheel")
    unwanted = shutil.ignore_patterns("__pycache__")
    for folder in MAPPED:
        shutil.copytree(ROOT / folder, copy / folder, ignore=unwanted)
    for name in ("setup.cfg", "pyproject.toml", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    code = "from setuptools import build_meta; build_meta.build_wheel('.')"
    subprocess.run([sys.executable, "-c", code], cwd=copy, check=True, capture_output=True)
    (wheel,) = copy.glob("*.whl")
    return set(zipfile.ZipFile(wheel).namelist())


def test_nothing_but_dgc_pose_is_installed_at_the_top(wheel_files: set[str]) -> None:
    top = {name.split("/")[0] for name in wheel_files if ".dist-info/" not in name}
    assert top == {"dgc_pose"}


def test_a_wheel_holds_every_module_and_data_file(wheel_files: set[str]) -> None:
    expected = {"dgc_pose/py.typed"}
    for folder, package in MAPPED.items():
        target = package.replace(".", "/")
        for file in (ROOT / folder).rglob("*"):
            data = file.parent.name in ("data", "weights", "templates") and file.suffix != ".pth"
            if file.suffix == ".py" or (file.is_file() and data):
                expected.add(f"{target}/{file.relative_to(ROOT / folder).as_posix()}")
    assert expected <= wheel_files, sorted(expected - wheel_files)
    assert "dgc_pose/benchmarks/dtu/__init__.py" in wheel_files


def test_the_console_script_is_the_click_command() -> None:
    (script,) = entry_points(group="console_scripts", name="dgc-pose")
    assert script.value == "dgc_pose.cli.main:main"
    assert callable(script.load())


def test_mapped_packages_are_imported_from_their_folders() -> None:
    for folder, package in MAPPED.items():
        module = importlib.import_module(package)
        assert module.__file__ is not None
        assert Path(module.__file__).resolve().parent.name == folder.split(".")[-1]


def test_mapped_folders_are_no_top_level_packages() -> None:
    """In a fresh interpreter outside the repository, as a user's."""
    code = "import importlib.util as u; print([n for n in ('cli', 'benchmarks') if u.find_spec(n)])"
    assert run_elsewhere(code) == "[]"


@pytest.mark.parametrize("module", ["dgc_pose", "dgc_pose.errors", "dgc_pose.camera"])
def test_importing_the_ground_brings_nothing_heavy(module: str) -> None:
    code = (
        f"import sys, {module}; "
        "print([n for n in ('torch', 'cv2', 'matplotlib', 'pycolmap') if n in sys.modules])"
    )
    assert run_elsewhere(code) == "[]"


@pytest.mark.parametrize(
    "module", ["image", "matches", "metrics", "geometry", "estimation", "camera"]
)
def test_the_rooms_below_the_network_do_not_import_torch(module: str) -> None:
    assert run_elsewhere(f"import sys, dgc_pose.{module}; print('torch' in sys.modules)") == "False"


def test_constraints_pin_every_dependency_within_its_range(
    options: configparser.SectionProxy,
) -> None:
    from packaging.requirements import Requirement

    pins = {}
    for line in (ROOT / "constraints.txt").read_text().splitlines():
        if line and not line.startswith("#"):
            name, version = line.split("==")
            pins[name.lower()] = version
    parser = configparser.ConfigParser()
    parser.read(ROOT / "setup.cfg")
    wanted = options["install_requires"] + "\n" + parser["options.extras_require"]["dev"]
    requirements = [Requirement(line) for line in wanted.split("\n") if line.strip()]
    assert len(requirements) > 10
    for requirement in requirements:
        assert requirement.specifier.contains(pins[requirement.name]), requirement


def run_elsewhere(code: str) -> str:
    """What the code prints in a fresh interpreter whose path lacks the repository's folder."""
    command = [sys.executable, "-I", "-c", code]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
