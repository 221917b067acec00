"""Processes that are stopped or killed, lose their streams or meet a full disk: what they leave and
print.

COMMAND is a light one that opens its output, writes half of it, and waits to be told more.
"""

import os
import resource
import signal
import subprocess
import sys

import pytest
from fuzz.readers import make_batch

pytestmark = pytest.mark.slow

COMMAND = """
import sys, types
import click
from dgc_pose.cli.guard import OutputFile
from dgc_pose.cli.main import main
from dgc_pose.system.files import save_text, staged

@click.command()
@click.option("--json", "out", type=OutputFile())
@click.option("--size", type=int, default=4)
def info(out, size):
    with staged(out) as stage:
        save_text(stage(out), "{" + "x" * size)
        if size == 4:
            print("ready", flush=True)
        if sys.stdin.readline():
            save_text(stage(out), '{"whole": 1}')
    click.echo("done")

module = types.ModuleType("dgc_pose.cli.info")
module.info = info
sys.modules["dgc_pose.cli.info"] = module
main()
"""


def start(folder, *arguments, **settings):
    words = ("info", "--overwrite", "--json", "out.json", *arguments)
    pipes = {"stdin": -1, "stdout": -1, "stderr": -1, **settings}
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, *words], cwd=folder, text=True, env=environment, **pipes
    )


def ready(process):
    assert process.stdout.readline() == "ready\n"
    return process


@pytest.mark.usefixtures("default_signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_stopped_command_leaves_the_file_of_before(tmp_path, number):
    """Killed, it leaves a part beside it, which the next run clears."""
    (tmp_path / "out.json").write_text("{}")
    process = ready(start(tmp_path))
    process.send_signal(number)
    _, printed = process.communicate(timeout=60)
    assert (tmp_path / "out.json").read_text() == "{}"
    if number != signal.SIGKILL:
        assert process.returncode == 128 + number and os.listdir(tmp_path) == ["out.json"]
        assert printed.startswith("error: ") and printed.count("\n") == 1
        return
    assert sorted(os.listdir(tmp_path)) == [".out.json.partial", "out.json"]
    assert ready(start(tmp_path)).communicate("on\n", timeout=60) == ("done\n", "")
    assert os.listdir(tmp_path) == ["out.json"]


def test_an_output_has_one_writer(tmp_path):
    first = ready(start(tmp_path))
    refused = start(tmp_path).communicate("on\n", timeout=60)
    assert refused == ("", "error: out.json: another run is writing it\n")
    assert first.communicate("on\n", timeout=60) == ("done\n", "")
    assert (tmp_path / "out.json").read_text() == '{"whole": 1}'


def test_a_lost_stdout_is_one_line(tmp_path):
    with open("/dev/full", "w") as stdout:
        process = start(tmp_path, "--size", "5", stdout=stdout)
        _, printed = process.communicate("on\n", timeout=60)
    assert (process.returncode, printed) == (2, "error: No space left on device\n")
    read, write = os.pipe()
    os.close(read)  # as `head` does
    process = start(tmp_path, "--size", "5", stdout=write)
    os.close(write)
    assert process.communicate("on\n", timeout=60)[1] == ""
    assert process.returncode == 128 + signal.SIGPIPE


def test_a_full_disk_is_one_line(tmp_path):
    """An error of SQLite once ended the process, and left files."""
    make_batch(tmp_path)
    before = set(os.listdir(tmp_path))
    ended = subprocess.run(
        [sys.executable, "-m", "dgc_pose", "export-colmap", "batch", "--database", "x.db"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000)),
    )
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr == "error: --database: x.db: File too large\n"
    assert set(os.listdir(tmp_path)) == before


HANDLERS = """
import os, signal, time
signal.signal(signal.SIGTERM, lambda *_: None)
from dgc_pose.system.colmap_library import pycolmap
import dgc_pose.runtime.onnx_engine
os.kill(os.getpid(), signal.SIGTERM)
time.sleep(1)
print(pycolmap.__name__, "goes on", os.environ["ORT_DISABLE_TELEMETRY"])
"""


def test_libraries_take_no_signal_and_report_nothing(tmp_path):
    """pycolmap's import alone made SIGTERM print a stack trace; ONNX Runtime's telemetry starts a
    thread and keeps a file."""
    environment = {k: v for k, v in os.environ.items() if k != "ORT_DISABLE_TELEMETRY"}
    environment |= {"TMPDIR": str(tmp_path), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-c", HANDLERS]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "pycolmap goes on 1\n", "")
    assert os.listdir(tmp_path) == []
