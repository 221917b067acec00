"""What setup.cfg says of the package, and that importing the package stays cheap."""

import configparser
import re
import subprocess
import sys
from pathlib import Path

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


def pins(file: str) -> dict[str, str]:
    """The version of each distribution that a file of pins names."""
    pairs = re.findall(r"^([\w.-]+)==([^\s+]+)", (ROOT / file).read_text(), re.MULTILINE)
    return {name.lower().replace("_", "-"): version for name, version in pairs}


def test_what_needs_no_heavy_library_imports_none() -> None:
    code = "import sys, {}; print([n for n in {} if n in sys.modules])"
    heavy = ("torch", "cv2", "matplotlib", "pycolmap")
    ground = "dgc_pose.errors, dgc_pose.cameras.camera"
    assert run_elsewhere(code.format(ground, heavy)) == "[]"
    rooms = ("images.image", "matches", "metrics", "geometry", "estimation")
    names = ", ".join(f"dgc_pose.{room}" for room in rooms)
    assert run_elsewhere(code.format(names, ("torch",))) == "[]"


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


def run_elsewhere(code: str) -> str:
    """What the code prints in a fresh interpreter whose path lacks the repository's folder."""
    command = [sys.executable, "-I", "-c", code]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
