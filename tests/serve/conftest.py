"""The page in a browser: of a server with SIFT, and of one with the true map of a scene."""

import socket
import subprocess
import sys
import threading
from pathlib import Path

import dense_scene
import pytest
import serve_parts
import uvicorn

from dgc_pose.serve.app import Server
from dgc_pose.serve.guard import local_hosts
from dgc_pose.serve.options import ServeOptions


@pytest.fixture(scope="module")
def url():
    """A server's address. SIFT, whose pose of the rendered pair takes a second."""
    command = [sys.executable, "-m", "dgc_pose", "serve", "--no-browser", "--weights", "sift"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield process.stdout.readline().strip()
    finally:
        process.terminate()
        process.communicate(timeout=60)


@pytest.fixture(scope="module")
def map_url(tmp_path_factory):
    """The address of a server whose matcher gives the dense scene's map, and which keeps two
    images."""
    example = [
        (Path(path), dense_scene.K_TEXT)
        for path in dense_scene.write_pictures(tmp_path_factory.mktemp("pictures"))
    ]
    folder = tmp_path_factory.mktemp("images")
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        bound.listen()
        port = bound.getsockname()[1]
        settings = {"token": "t", "hosts": local_hosts(port), "options": ServeOptions()}
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("dgc_pose.serve.app.IMAGES", 2)
            server = Server(serve_parts.estimator(), example, folder, **settings)
        web = uvicorn.Server(uvicorn.Config(server.app, log_level="warning"))
        thread = threading.Thread(target=web.run, kwargs={"sockets": [bound]})
        thread.start()
        try:
            yield f"http://127.0.0.1:{port}/?token=t"
        finally:
            web.should_exit = True
            thread.join()
            server.close()


@pytest.fixture
def page(url, browser):
    """The page of the first server, as it opens."""
    browser.open_anew(url)
    yield browser
    assert browser.errors == []


@pytest.fixture
def map_page(map_url, browser):
    """The page of the second server with the pose of its pair."""
    browser.open_anew(map_url)
    browser.click("#example")
    browser.wait(serve_parts.DONE)
    yield browser
    assert browser.errors == []


@pytest.fixture
def rendered(page):
    """The page of the first server with the rendered pair's pose."""
    serve_parts.estimate_rendered(page)
    return page
