"""What setup.cfg says of the package, and that importing the package stays cheap."""

import configparser
import re
import subprocess
import sys
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from dgc_pose import errors

ROOT = Path(__file__).resolve().parents[1]
# The folders that setup.cfg maps into the import root.
MAPPED = {
    "dgc_pose": "dgc_pose",
    "cli": "dgc_pose.cli",
    "benchmarks": "dgc_pose.benchmarks",
    "training": "dgc_pose.training",
}


@pytest.fixture(scope="module")
def setup() -> configparser.ConfigParser:
    parser = configparser.ConfigParser()
    parser.read(ROOT / "setup.cfg")
    return parser


def pins(file: str) -> dict[str, str]:
    """The version of each distribution that a file of pins names."""
    pairs = re.findall(r"^([\w.-]+)==([^\s+]+)", (ROOT / file).read_text(), re.MULTILINE)
    return {name.lower().replace("_", "-"): version for name, version in pairs}


def requirements(lines: str) -> list[Requirement]:
    return [
        Requirement(line)
        for line in lines.splitlines()
        if line.strip() and not line.startswith("#")
    ]


def test_what_needs_no_heavy_library_imports_none() -> None:
    code = "import sys, {}; print([n for n in {} if n in sys.modules])"
    heavy = ("torch", "cv2", "matplotlib", "pycolmap")
    ground = "dgc_pose.errors, dgc_pose.cameras.camera"
    assert run_elsewhere(code.format(ground, heavy)) == "[]"
    rooms = ("images.image", "matches", "metrics", "geometry", "estimation")
    names = ", ".join(f"dgc_pose.{room}" for room in rooms)
    assert run_elsewhere(code.format(names, ("torch",))) == "[]"


def test_constraints_pin_every_dependency_within_its_range(
    setup: configparser.ConfigParser,
) -> None:
    extras = setup["options.extras_require"].values()
    every = requirements("\n".join([setup["options"]["install_requires"], *extras]))
    wanted = [requirement for requirement in every if requirement.name != "dgc-pose"]
    assert len(wanted) > 10
    for requirement in wanted:
        assert requirement.specifier.contains(pins("constraints.txt")[requirement.name])
    assert pins("constraints-hashes.txt") == pins("constraints.txt")


def test_each_missing_package_is_told_with_the_extra_that_has_it(
    setup: configparser.ConfigParser,
) -> None:
    for extra, modules in errors.EXTRAS.items():
        listed = (
            setup["options.extras_require"][extra]
            if extra
            else setup["options"]["install_requires"]
        )
        names = {requirement.name for requirement in requirements(listed)}
        assert set(modules.values()) <= names if extra == "" else set(modules.values()) == names


def run_elsewhere(code: str) -> str:
    """What the code prints in a fresh interpreter whose path lacks the repository's folder."""
    command = [sys.executable, "-I", "-c", code]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
