import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from contextlib import contextmanager

import pytest

from dgc_pose.cameras.pair_list import bundled_photographs
from dgc_pose.serve.guard import TOKEN_HEADER


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


def test_weights_that_are_missing_end_it_with_one_line(tmp_path):
    with started(tmp_path, "--weights", "nosuch.safetensors") as process:
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    assert errors.startswith("error: ") and errors.count("\n") == 1
    assert "nosuch.safetensors" in errors
    assert list(tmp_path.iterdir()) == []


def _post(url, path, body=b"", complete=True):
    """A connection that has sent a request, or the start of it."""
    base, token = url.split("/?token=")
    host = base.removeprefix("http://")
    connection = socket.create_connection(host.split(":"), timeout=60)
    length = len(body) + (0 if complete else 5000)
    head = f"POST {path} HTTP/1.1\r\nHost: {host}\r\n{TOKEN_HEADER}: {token}\r\n"
    connection.sendall(f"{head}Content-Length: {length}\r\n\r\n".encode() + body)
    return connection


def _answer(connection):
    """What the server answers, to be read."""
    answer = http.client.HTTPResponse(connection)
    answer.begin()
    return answer


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_during_a_pose_ends_it_without_a_trace(tmp_path, number):
    with started(tmp_path, "--weights", "sift") as process:
        url = process.stdout.readline().strip()
        with urllib.request.urlopen(url, timeout=60) as answer:
            assert b"dgc-pose" in answer.read()
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(url.split("?")[0], timeout=60)
        assert len(list(tmp_path.glob("dgc-pose.*"))) == 1
        first, second = (
            json.load(_answer(_post(url, "/images", path.read_bytes())))["id"]
            for path in bundled_photographs()
        )
        camera = {"kind": "auto"}
        body = json.dumps({"image1": first, "image2": second, "camera": camera}).encode()
        others = [_post(url, path, b"abc", complete=False) for path in ("/images", "/poses")]
        _post(url, "/poses", b"abc", complete=False).close()  # a client that leaves
        pose = _answer(_post(url, "/poses", body))
        assert json.loads(pose.readline()) == {"progress": "reading the images"}
        process.send_signal(number)
        with pytest.raises(http.client.IncompleteRead):
            pose.read()
        _, errors = process.communicate(timeout=60)
        del others
    assert process.returncode == 0 and errors == ""
    assert list(tmp_path.iterdir()) == []
