import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest
from command_line import assert_refused, run

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
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert_refused(run("serve", "--no-browser", "--port", port), str(port))


@pytest.mark.parametrize(
    "arguments", [("--port", "70000"), ("--max-megabytes", "0"), ("--estimate-seconds", "-1")]
)
def test_unusable_options_are_refused(arguments):
    assert_refused(run("serve", *arguments))


def _workers(process):
    """Numbers of the server's worker processes."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    return [int(k) for k in children if b"spawn_main" in Path(f"/proc/{k}/cmdline").read_bytes()]


def _kill(workers):
    for worker in workers:
        with suppress(ProcessLookupError):
            os.kill(worker, signal.SIGKILL)


def _post(url, path, body=b""):
    base, token = url.split("/?token=")
    headers = {TOKEN_HEADER: token}
    request = urllib.request.Request(base + path, body, headers, method="POST")
    return urllib.request.urlopen(request, timeout=60)


def _half_post(url, path):
    """A connection that has sent the start of a request."""
    base, token = url.split("/?token=")
    host = base.removeprefix("http://")
    connection = socket.create_connection(host.split(":"), timeout=60)
    head = f"POST {path} HTTP/1.1\r\nHost: {host}\r\n{TOKEN_HEADER}: {token}\r\n"
    connection.sendall(f"{head}Content-Length: 5000\r\n\r\nabc".encode())
    return connection


@pytest.mark.skipif(not os.path.exists("/proc/self/task"), reason="finds processes as Linux does")
def test_poses_of_clients_that_have_left_keep_nobody_waiting(tmp_path):
    """A page that is loaded again and again was told that the server is busy."""
    with started(tmp_path, "--weights", "sift") as process, ExitStack() as cleared:
        url = process.stdout.readline().strip()
        example = json.load(_post(url, "/example"))
        first, second = (image["id"] for image in example["images"])
        camera = {"kind": "k", "k1": example["k"][0]}
        body = json.dumps({"image1": first, "image2": second, "camera": camera}).encode()
        assert b"result" in _post(url, "/poses", body).read()  # the matcher is loaded
        workers = _workers(process)
        for worker in workers:  # so that the pose of the first client does not come to an end
            os.kill(worker, signal.SIGSTOP)
        cleared.callback(_kill, workers)
        for left in [_post(url, "/poses", body) for _ in range(4)]:  # one runs, three wait
            left.close()
        time.sleep(1)  # longer than the server takes to see it
        assert b"result" in _post(url, "/poses", body).read()


@pytest.mark.skipif(not os.path.exists("/proc/self/task"), reason="finds processes as Linux does")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_during_a_pose_ends_it_without_a_trace(tmp_path, number):
    with started(tmp_path, "--weights", "sift") as process, ExitStack() as cleared:
        url = process.stdout.readline().strip()
        example = json.load(_post(url, "/example"))
        first, second = (image["id"] for image in example["images"])
        camera = {"kind": "k", "k1": example["k"][0]}
        workers = _workers(process)
        assert len(workers) == 2
        for worker in workers:  # so that the pose takes longer than any machine's server waits
            os.kill(worker, signal.SIGSTOP)
        cleared.callback(_kill, workers)
        body = json.dumps({"image1": first, "image2": second, "camera": camera}).encode()
        answers = (
            _post(url, "/poses", body),
            _half_post(url, "/images"),
            _half_post(url, "/poses"),
        )
        _half_post(url, "/poses").close()  # a client that leaves
        process.send_signal(number)
        assert json.loads(answers[0].read()) == {"error": "the server is ending"}
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 0 and errors == ""
    assert not any(os.path.exists(f"/proc/{worker}") for worker in workers)
    assert list(tmp_path.iterdir()) == []
