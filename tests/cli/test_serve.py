from __future__ import annotations

import os
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from contextlib import contextmanager

import pytest
from click.testing import CliRunner

from dgc_pose.cli.main import main


@contextmanager
def started(tmp_path, *arguments):
    command = [sys.executable, "-m", "dgc_pose", "serve", "--no-browser", *arguments]
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    process = subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_page_is_there_until_a_signal_and_nothing_is_left(tmp_path, number):
    with started(tmp_path, "--weights", "sift") as process:
        url = process.stdout.readline().strip()
        with urllib.request.urlopen(url, timeout=30) as answer:
            assert b"dgc-pose" in answer.read()
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(url.split("?")[0], timeout=30)
        assert len(list(tmp_path.glob("dgc-pose.*"))) == 1
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 0 and errors == ""
    assert list(tmp_path.iterdir()) == []


def test_weights_that_are_missing_end_it_with_one_line(tmp_path):
    with started(tmp_path, "--weights", "nosuch.safetensors") as process:
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    assert errors.startswith("error: ") and errors.count("\n") == 1
    assert "nosuch.safetensors" in errors
    assert list(tmp_path.iterdir()) == []


def test_a_port_that_is_taken_is_refused(tmp_path):
    import socket

    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        result = CliRunner().invoke(main, ["serve", "--no-browser", "--port", str(port)])
    assert result.exit_code == 2 and result.stderr.startswith("error: ")
    assert str(port) in result.stderr


def test_without_the_extra_the_message_names_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    result = CliRunner().invoke(main, ["serve"])
    assert result.exit_code == 2 and "dgc-pose[serve]" in result.stderr


@pytest.mark.parametrize(
    "arguments", [("--port", "70000"), ("--max-megabytes", "0"), ("--estimate-seconds", "-1")]
)
def test_unusable_options_are_refused(arguments):
    result = CliRunner().invoke(main, ["serve", *arguments])
    assert result.exit_code == 2 and result.stderr.startswith("error: ")
