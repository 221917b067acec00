"""What setup.cfg says of the package, and that importing the package stays cheap."""

from __future__ import annotations

import configparser
import importlib
import re
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LEFT_OUT = {"jinja2", "matplotlib", "pycolmap", "scipy", "torch"}  # of the light set
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


@pytest.mark.parametrize("module", ["dgc_pose", "dgc_pose.errors", "dgc_pose.cameras.camera"])
def test_importing_the_ground_brings_nothing_heavy(module: str) -> None:
    code = (
        f"import sys, {module}; "
        "print([n for n in ('torch', 'cv2', 'matplotlib', 'pycolmap') if n in sys.modules])"
    )
    assert run_elsewhere(code) == "[]"


@pytest.mark.parametrize(
    "module", ["images.image", "matches", "metrics", "geometry", "estimation", "cameras.camera"]
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
    extras = parser["options.extras_require"]
    # mkdocs and its plug-ins build the documentation alone.
    wanted = "\n".join([options["install_requires"], *(extras[name] for name in extras)])
    requirements = [Requirement(line) for line in wanted.split("\n") if line.strip()]
    assert len(requirements) > 10
    for requirement in requirements:
        assert requirement.specifier.contains(pins[requirement.name]), requirement


def test_the_light_set_is_what_is_needed_without_torch_colmap_and_figures(
    options: configparser.SectionProxy,
) -> None:
    """With what those packages need in turn: it is installed with --no-deps."""
    from importlib.metadata import requires

    from packaging.requirements import Requirement

    def pins(file: str) -> dict[str, str]:
        lines = (ROOT / file).read_text().splitlines()
        named = [line.split("==") for line in lines if line and not line.startswith("#")]
        return {name.lower().replace("_", "-"): version for name, version in named}

    light, constraints = pins("requirements-light.txt"), pins("constraints.txt")
    assert {name: constraints[name] for name in light} == light
    lines = [*options["install_requires"].splitlines(), "starlette", "uvicorn"]
    direct = [Requirement(line) for line in lines if line.strip() and not line.startswith("#")]
    waiting = [one for one in direct if one.name not in LEFT_OUT]
    assert len(waiting) == len(direct) - len(LEFT_OUT)
    needed = set()
    while waiting:
        name = waiting.pop().name.lower().replace("_", "-")
        if name not in needed:
            needed.add(name)
            found = map(Requirement, requires(name) or [])
            waiting += [r for r in found if r.marker is None or r.marker.evaluate({"extra": ""})]
    assert needed == set(light)


def test_the_pins_by_hash_are_those_of_the_constraints() -> None:
    def pinned(name: str) -> dict[str, str]:
        lines = (ROOT / name).read_text().splitlines()
        pairs = [line.split()[0].split("==") for line in lines if re.match(r"[\w.-]+==", line)]
        return {key.lower().replace("_", "-"): version.split("+")[0] for key, version in pairs}

    assert pinned("constraints-hashes.txt") == pinned("constraints.txt")


def run_elsewhere(code: str) -> str:
    """What the code prints in a fresh interpreter whose path lacks the repository's folder."""
    command = [sys.executable, "-I", "-c", code]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
