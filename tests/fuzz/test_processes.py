"""Processes that are stopped or killed, or lose their streams: what they leave, and what they say.

The command is a light one that opens its output, writes half of it, and waits to be told more.
"""

import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

COMMAND = """
import sys, time, types
import click
from dgc_pose.cli.guard import OutputFile
from dgc_pose.cli.main import main
from dgc_pose.files.outputs import save_text, staged

@click.command()
@click.option("--json", "out", type=OutputFile())
@click.option("--size", type=int, default=4)
def demo(out, size):
    with staged(out) as stage:
        save_text(stage(out), "{" + "x" * size)
        if size == 4:
            print("ready", flush=True)
        if sys.stdin.readline():
            save_text(stage(out), '{"whole": 1}')
    click.echo("done")

module = types.ModuleType("dgc_pose.cli.demo")
module.demo = demo
sys.modules["dgc_pose.cli.demo"] = module
main()
"""


def start(folder: Path, *arguments: str, **settings: object) -> subprocess.Popen[str]:
    words = ("demo", "--overwrite", "--json", "out.json", *arguments)
    pipes = {"stdin": -1, "stdout": -1, "stderr": -1, **settings}
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, *words], cwd=folder, text=True, env=environment, **pipes
    )  # type: ignore


def ready(process: subprocess.Popen[str]) -> subprocess.Popen[str]:
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    return process


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_stopped_command_leaves_nothing(tmp_path: Path, number: signal.Signals) -> None:
    (tmp_path / "out.json").write_text("{}")
    process = ready(start(tmp_path))
    assert len(os.listdir(tmp_path)) == 2
    process.send_signal(number)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert told.startswith("error: ") and told.count("\n") == 1
    assert os.listdir(tmp_path) == ["out.json"]
    assert (tmp_path / "out.json").read_text() == "{}"


def test_what_a_killed_command_left_is_cleared(tmp_path: Path) -> None:
    process = ready(start(tmp_path))
    process.kill()
    process.communicate()
    assert os.listdir(tmp_path) == [".out.json.partial"]
    assert ready(start(tmp_path)).communicate("on\n", timeout=60) == ("done\n", "")
    assert os.listdir(tmp_path) == ["out.json"]


def test_a_second_writer_of_an_output_is_refused(tmp_path: Path) -> None:
    first = ready(start(tmp_path))
    printed, told = start(tmp_path).communicate("on\n", timeout=60)
    assert (printed, told) == ("", "error: out.json: another run is writing there\n")
    assert first.communicate("on\n", timeout=60) == ("done\n", "")
    assert (tmp_path / "out.json").read_text() == '{"whole": 1}'
    assert os.listdir(tmp_path) == ["out.json"]


def test_a_full_disk_or_stdout_is_one_line(tmp_path: Path) -> None:
    def full() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))

    process = start(tmp_path, "--size", "100000", preexec_fn=full)
    assert process.communicate("on\n", timeout=60) == ("", "error: out.json: File too large\n")
    assert (process.returncode, os.listdir(tmp_path)) == (2, [])
    with open("/dev/full", "w") as stdout:
        process = start(tmp_path, "--size", "5", stdout=stdout)
        _, told = process.communicate("on\n", timeout=60)
    assert (process.returncode, told) == (2, "error: stdout: No space left on device\n")


def test_a_closed_stdout_is_one_line_before_the_work(tmp_path: Path) -> None:
    process = start(tmp_path, preexec_fn=lambda: os.close(1))
    _, told = process.communicate("on\n", timeout=60)
    assert (process.returncode, told) == (2, "error: stdout is closed\n")
    assert os.listdir(tmp_path) == []


def test_a_reader_that_leaves_is_no_error(tmp_path: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    process = start(tmp_path, "--size", "5", stdout=write)
    os.close(write)
    _, told = process.communicate("on\n", timeout=60)
    assert (process.returncode, told) == (128 + signal.SIGPIPE, "")


HANDLERS = """
import signal
handler = lambda *_: None
signal.signal(signal.SIGTERM, handler)
from dgc_pose.system.colmap_library import pycolmap
assert signal.getsignal(signal.SIGTERM) is handler
import os, time
os.kill(os.getpid(), signal.SIGTERM)
time.sleep(0.01)
print(pycolmap.__name__, "goes on")
"""


def test_pycolmap_does_not_take_over_sigterm() -> None:
    """Its import alone made SIGTERM print a stack trace and end the process at once."""
    ended = subprocess.run([sys.executable, "-c", HANDLERS], capture_output=True, text=True)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "pycolmap goes on\n", "")


def test_onnx_runtime_reports_nothing(tmp_path: Path) -> None:
    """Left to itself its telemetry starts a thread and keeps a file."""
    code = "import os\nfrom dgc_pose.runtime.session import Session\nimport time\n"
    code += "time.sleep(1)\nprint(os.environ['ORT_DISABLE_TELEMETRY'])"
    environment = {k: v for k, v in os.environ.items() if k != "ORT_DISABLE_TELEMETRY"}
    environment |= {"TMPDIR": str(tmp_path), "OMP_NUM_THREADS": "1"}
    ended = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True)
    assert ended.stdout.startswith(b"1\n"), ended.stderr
    assert os.listdir(tmp_path) == []
