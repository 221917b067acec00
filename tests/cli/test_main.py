import logging
import os
import signal
import subprocess
import sys
import warnings
from hashlib import sha256
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import click
import pytest
from command_line import run

import dgc_pose
from dgc_pose.cli.process import progress_bars
from dgc_pose.errors import DgcPoseError, WeightsError


@pytest.fixture
def info(monkeypatch):
    """Runs `dgc-pose info` as a command that calls a function."""

    def use(function, *arguments):
        command = click.command()(lambda: function())
        monkeypatch.setattr("dgc_pose.cli.info.info", command)
        return run("info", *arguments)

    return use


@pytest.mark.parametrize(("said", "expected"), [(None, "10000"), ("7", "7")])
def test_threads_wait_as_the_user_says_or_not_for_long(monkeypatch, said, expected):
    monkeypatch.delenv("OMP_WAIT_POLICY", raising=False)
    monkeypatch.setenv("GOMP_SPINCOUNT", said or "")  # so that what is set below is undone
    if said is None:
        monkeypatch.delenv("GOMP_SPINCOUNT")
    assert run().exit_code == 0 and os.environ["GOMP_SPINCOUNT"] == expected


MAIN = """
from dgc_pose.cli.main import main
try:
    main({})
except SystemExit as end:
    assert (end.code or 0) == {}
"""
ROOMS = ("images.image", "matches", "metrics", "geometry", "estimation")
MISSING = ["estimate", "nowhere.png", "nowhere.png", "--K", "1,1,1,1"]


@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        (
            "import dgc_pose.errors, dgc_pose.cameras.camera",
            ("torch", "cv2", "matplotlib", "pycolmap"),
        ),
        ("import " + ", ".join(f"dgc_pose.{room}" for room in ROOMS), ("torch",)),
        (MAIN.format(["--help"], 0), ("torch", "cv2", "numpy")),
        (
            MAIN.format(["reconstruct", "--help"], 0),
            ("torch", "matplotlib", "scipy.stats", "pycolmap"),
        ),
        (MAIN.format(MISSING, 2), ("torch", "matplotlib")),
    ],
    ids=["ground", "rooms", "help", "reconstruct", "missing"],
)
def test_nothing_heavy_is_imported_before_it_is_needed(code, heavy):
    code += f"\nimport sys\nassert not [name for name in {heavy} if name in sys.modules]"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment, capture_output=True)


NOT_EXPECTED = "RuntimeError: can't allocate memory: 9 (--debug shows the trace)"


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (WeightsError("w.pth: no such file"), 2, "w.pth: no such file"),
        (OSError(28, "No space left", "out.npz"), 2, "out.npz: No space left"),
        (OSError(28, "No space", "a.db", None, "/tmp/a.db"), 2, "a.db -> /tmp/a.db: No space"),
        (DgcPoseError("\x1b[31m" + "x" * 5000), 2, f"\ufffd[31m{495 * 'x'} ... {495 * 'x'}"),
        (MemoryError("Unable to allocate 3 GiB"), 2, "not enough memory: Unable to allocate 3 GiB"),
        (RuntimeError("can't allocate memory: 9"), 1, NOT_EXPECTED),
    ],
)
def test_errors_are_one_line_and_an_exit_code(info, error, code, line):
    def fail():
        raise error

    result = info(fail)
    assert (result.exit_code, result.stdout, result.stderr) == (code, "", f"error: {line}\n")
    result = info(fail, "--debug")
    assert result.exit_code == code
    assert "Traceback" in result.stderr and result.stderr.endswith(f"error: {line}\n")


@pytest.mark.parametrize(
    ("number", "usual", "line"),
    [
        (signal.SIGINT, signal.default_int_handler, "interrupted"),
        (signal.SIGTERM, signal.SIG_DFL, "stopped by SIGTERM"),
        (signal.SIGHUP, signal.SIG_DFL, "stopped by SIGHUP"),
    ],
)
def test_a_signal_to_stop_is_one_line_and_the_shells_code_unless_it_is_ignored(
    info, number, usual, line
):
    """As nohup and scripts ignore it for commands that are to run on."""

    def stop():
        signal.raise_signal(number)
        click.echo("runs on")

    before = signal.signal(number, usual)
    try:
        stopped = info(stop)
        assert signal.getsignal(number) == usual
        signal.signal(number, signal.SIG_IGN)
        ran = info(stop)
    finally:
        signal.signal(number, before)
    assert (stopped.exit_code, stopped.stderr) == (128 + number, f"error: {line}\n")
    assert (ran.exit_code, ran.stdout, ran.stderr) == (0, "runs on\n", "")


def test_warnings_are_lines_of_their_own(info):
    def warn():
        warnings.warn("of a library", stacklevel=1)
        logging.getLogger("matplotlib.font_manager").warning("of a font")
        logging.getLogger("dgc_pose.system.files").warning("left:\n%s", "x")

    assert info(warn).stderr == "warning: left: x\n"


def test_a_log_file_gets_a_line_a_minute(monkeypatch, capsys):
    """60 of 780 pairs are done before; six take a second."""
    clock = SimpleNamespace(seconds=0.0, monotonic=lambda: clock.seconds)
    monkeypatch.setattr("dgc_pose.cli.process.time", clock)
    with progress_bars() as progress:
        for done in range(60, 781, 6):
            progress("pairs", done, 780)
            clock.seconds += 1
        progress("images", 0, 4)  # a stage of less than a minute
        clock.seconds += 59
        progress("images", 4, 4)
    assert capsys.readouterr() == (
        "",
        "pairs 420 of 780, 54 %, 1 min left\npairs 780 of 780, 100 %, 0 min left\n",
    )


def test_info_tells_the_installation(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    lines = dict(line.split(maxsplit=1) for line in run("info").stdout.splitlines())
    assert lines["dgc-pose"].startswith(metadata.version("dgc-pose"))
    assert lines["numpy"] == metadata.version("numpy") and lines["OMP_NUM_THREADS"] == "3"
    weights = Path(dgc_pose.__file__).parent / "weights" / "dgcm-lite0.safetensors"
    assert lines[weights.name] == f"sha256 {sha256(weights.read_bytes()).hexdigest()[:16]}"
