import logging
import os
import signal
import subprocess
import sys
import warnings

import click
import pytest
from click.shell_completion import ShellComplete
from command_line import assert_refused, run

from dgc_pose.cli.main import SECTIONS, SUBCOMMANDS, main
from dgc_pose.errors import DgcPoseError, ImageSizeError, WeightsError


@pytest.fixture
def raising(monkeypatch):
    """Makes `dgc-pose demo` raise."""

    def use(error, *arguments):
        @click.command()
        def demo():
            raise error

        monkeypatch.setattr("dgc_pose.cli.demo.demo", demo)
        return run("demo", *arguments)

    return use


@pytest.mark.parametrize(
    ("variables", "expected"),
    [({}, "10000"), ({"GOMP_SPINCOUNT": "7"}, "7"), ({"OMP_WAIT_POLICY": "active"}, None)],
)
def test_threads_wait_as_the_user_says_or_not_for_long(monkeypatch, variables, expected):
    for name in ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY"):
        monkeypatch.setenv(name, "")  # so that what is set below is undone
        monkeypatch.delenv(name)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert run().exit_code == 0
    assert os.environ.get("GOMP_SPINCOUNT") == expected


def test_help_names_every_subcommand():
    for result in (run("--help"), run("-h"), run()):
        assert result.exit_code == 0
        headings = [line[:-1] for line in result.stdout.splitlines() if line[:1].isupper()]
        assert headings[-len(SECTIONS) :] == [*SECTIONS]
        assert all(f"  {name} " in result.stdout for name in SUBCOMMANDS)


def test_commands_are_completed_without_being_imported(monkeypatch):
    monkeypatch.setattr("importlib.import_module", None)
    shell = ShellComplete(main, {}, "dgc-pose", "_DGC_POSE_COMPLETE")
    assert [item.value for item in shell.get_completions([], "")] == [*SUBCOMMANDS]
    assert [item.value for item in shell.get_completions([], "esti")] == ["estimate"]


@pytest.mark.parametrize(
    ("command", "more"), [("estimate", ("Scale",)), ("reconstruct", ("Reconstruction",))]
)
def test_what_people_use_first_is_first(monkeypatch, command, more):
    """In 80 columns the help's first part, which ends with --help, has a dozen options."""
    monkeypatch.setenv("COLUMNS", "80")
    lines = run(command, "--help").stdout.splitlines()
    assert max(map(len, lines)) <= 80
    headings = [line[:-1] for line in lines if line.endswith(":") and line[0] != " "]
    first, then = ("Cameras", "Output", "Options"), ("Matching", "Estimation", "Advanced")
    assert headings == [*first, *more, *then]
    options = [line.split()[0] for line in lines if line.startswith("  -")]
    assert {"--K", "--weights", "--device", "--effort"} < {*options[: options.index("-h,")]}
    assert options.index("-h,") < 13
    assert {"--K-size", "--K-std", "--max-pixels", "--debug"} < {*options[options.index("-h,") :]}


@pytest.mark.parametrize(
    ("arguments", "status", "heavy"),
    [
        (["--help"], 0, ("torch", "cv2", "numpy")),
        (["reconstruct", "--help"], 0, ("torch", "matplotlib", "scipy.stats", "pycolmap")),
        (["estimate", "nowhere.png", "nowhere.png", "--K", "1,1,1,1"], 2, ("torch", "matplotlib")),
    ],
)
def test_nothing_heavy_is_imported_before_it_is_needed(arguments, status, heavy):
    code = (
        "import sys\n"
        "from dgc_pose.cli.main import main\n"
        f"try:\n    main({arguments})\n"
        f"except SystemExit as end:\n    assert (end.code or 0) == {status}\n"
        f"assert not [name for name in {heavy} if name in sys.modules]"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment, capture_output=True)


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["zzz"], "error: No such command 'zzz'.\n"),
        (["estimte"], "error: No such command 'estimte'. Did you mean 'estimate'?\n"),
        (["estimate", "a.png"], "IMG2"),
        (["estimate", "a.png", "b.png", "--runs", "many"], "--runs"),
        (
            ["estimate", "a.png", "b.png", "--K", "auto", "--runs", "0"],
            "error: --runs must be at least 1 and at most 10000, not 0",
        ),
        (["match", "a.png", "b.png"], "--out"),
    ],
)
def test_misuse_is_one_line_and_exit_2(arguments, words):
    assert_refused(run(*arguments), words)


NOT_EXPECTED = "RuntimeError: can't allocate memory: 9 (--debug shows the trace)"


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (WeightsError("w.pth: no such file"), 2, "w.pth: no such file"),
        (OSError(28, "No space left", "out.npz"), 2, "out.npz: No space left"),
        (OSError(28, "No space", "a.db", None, "/tmp/a.db"), 2, "a.db -> /tmp/a.db: No space"),
        (
            ImageSizeError("a.png is too large"),
            2,
            "a.png is too large (--max-pixels sets that number)",
        ),
        (MemoryError("Unable to allocate 3 GiB"), 2, "not enough memory: Unable to allocate 3 GiB"),
        (RuntimeError("can't allocate memory: 9"), 1, NOT_EXPECTED),
    ],
)
def test_errors_are_one_line_and_an_exit_code(raising, error, code, line):
    result = raising(error)
    assert (result.exit_code, result.stdout, result.stderr) == (code, "", f"error: {line}\n")
    result = raising(error, "--debug")
    assert result.exit_code == code
    assert "Traceback" in result.stderr and result.stderr.endswith(f"error: {line}\n")


@pytest.mark.parametrize(
    ("number", "line"),
    [(signal.SIGINT, "interrupted"), (signal.SIGTERM, "stopped by SIGTERM")],
)
def test_a_signal_to_stop_is_one_line_and_the_shells_code(raising, number, line):
    class Raised(Exception):
        def __init__(self):
            signal.raise_signal(number)

    before = signal.getsignal(number)
    result = raising(Raised)
    assert (result.exit_code, result.stderr) == (128 + number, f"error: {line}\n")
    assert signal.getsignal(number) == before


def test_a_message_is_short_and_plain(raising):
    result = raising(DgcPoseError("\x1b[31m" + "x" * 5000 + "\udcff"))
    assert result.stderr.count("\n") == 1 and len(result.stderr) < 1100
    assert "\x1b" not in result.stderr


def test_warnings_are_lines_of_their_own(monkeypatch):
    @click.command()
    def demo():
        warnings.warn("of a library", stacklevel=1)
        logging.getLogger("matplotlib.font_manager").warning("of a font")
        logging.getLogger("dgc_pose.files.outputs").warning("left:\n%s", "x")

    monkeypatch.setattr("dgc_pose.cli.demo.demo", demo)
    assert run("demo").stderr == "warning: left: x\n"
