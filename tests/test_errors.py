"""What is said of a package that is missing."""

import subprocess
import sys
from importlib import resources
from pathlib import Path

import pytest
from hidden_packages import EXTRAS, run_in, without

from dgc_pose.errors import missing_package

pytestmark = pytest.mark.slow

_PAIR = [str(resources.files("dgc_pose") / "data" / "rendered" / f"image{k}.jpg") for k in (1, 2)]
_K = ("--K", "460,460,319.5,239.5")
_TORCH = "torch, which is not installed: pip install '.[torch]'"
_ENTRY = '{"name": "PART", "part": "PART", "kind": "rendered", "path": "photos"}'
_PLAN = "[" + ",".join(_ENTRY.replace("PART", part) for part in ("fit", "report")) + "]"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("train", "--photos", ".", "--out", "run", "--steps", "1"), f"train needs {_TORCH}"),
        (("estimate", *_PAIR, *_K, "--weights", "{}/dgcm.pth"), f"dgcm.pth needs {_TORCH}"),
        (
            ("serve",),
            "serve needs starlette and uvicorn, which are not installed: pip install '.[serve]'",
        ),
        (
            ("fit-probability", "--data", ".", "--out", "x", "--plan", "{}/plan.json"),
            "fit-probability needs scikit-learn and scipy, which are not installed: "
            "pip install '.[fit]'",
        ),
        (
            ("estimate", "{}/1.heic", "{}/1.heic", *_K),
            "{}/1.heic is HEIC, which needs pillow-heif: pip install '.[heic]'",
        ),
    ],
    ids=lambda value: " ".join(word for word in value[:1]) if isinstance(value, tuple) else "",
)
def test_what_a_command_lacks_is_told_with_the_command_that_installs_it(
    tmp_path: Path, words: tuple[str, ...], told: str
) -> None:
    (tmp_path / "dgcm.pth").touch()
    (tmp_path / "plan.json").write_text(_PLAN)
    (tmp_path / "1.heic").write_bytes(b"\0\0\0\x18ftypheic" + bytes(2000))
    environment = without(tmp_path / "site", *EXTRAS)
    done = run_in(environment, *(word.replace("{}", str(tmp_path)) for word in words))
    lines = [line for line in done.stderr.splitlines() if not line.startswith("warning: ")]
    assert (done.returncode, lines) == (2, ["error: " + told.replace("{}", str(tmp_path))])


def test_every_command_has_its_help_without_an_extra(tmp_path: Path) -> None:
    code = (
        "import click; from dgc_pose.cli.main import SUBCOMMANDS, main\n"
        "for name in SUBCOMMANDS: main.get_command(click.Context(main), name)"
    )
    environment = without(tmp_path / "site", *EXTRAS)
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, cwd="/")
    assert done.returncode == 0, done.stderr


def test_a_module_that_a_library_lacks_is_no_missing_package() -> None:
    """torch is installed: a missing submodule does not mean that torch is missing."""
    assert missing_package(ModuleNotFoundError(name="torch.no_such_part")) is None
    assert missing_package(ModuleNotFoundError(name="no_such_package")) is None
