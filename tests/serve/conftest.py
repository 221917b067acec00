"""A server's estimator without a network, and servers of the page."""

import socket
import threading
from contextlib import contextmanager
from pathlib import Path

import dense_scene
import pytest
import uvicorn

from dgc_pose.serve.app import Server
from dgc_pose.serve.estimator import Estimator
from dgc_pose.serve.guard import local_hosts
from dgc_pose.serve.options import ServeOptions


@pytest.fixture(scope="session")
def map_matcher():
    """Gives the true map of the dense scene."""
    return dense_scene.MapMatcher(dense_scene.true_map(error_px=0.2))


@pytest.fixture(scope="session")
def pictures(tmp_path_factory):
    return dense_scene.write_pictures(tmp_path_factory.mktemp("pictures"))


@pytest.fixture
def open_page(browser, pictures, tmp_path, monkeypatch):
    """Gives what opens the page of a server with a matcher, which keeps so many images."""

    @contextmanager
    def opened(matcher, images=30):
        folder = tmp_path / "images"
        folder.mkdir()
        with socket.socket() as bound:
            bound.bind(("127.0.0.1", 0))
            bound.listen()
            port = bound.getsockname()[1]
            settings = {"token": "t", "hosts": local_hosts(port)}
            settings["options"] = ServeOptions()
            example = [(Path(path), dense_scene.K_TEXT) for path in pictures]
            monkeypatch.setattr("dgc_pose.serve.app.IMAGES", images)
            server = Server(Estimator(matcher, None), example, folder, **settings)
            web = uvicorn.Server(uvicorn.Config(server.app, log_level="warning"))
            thread = threading.Thread(target=web.run, kwargs={"sockets": [bound]})
            thread.start()
            try:
                browser.open_anew(f"http://127.0.0.1:{port}/?token=t")
                yield browser
            finally:
                web.should_exit = True
                thread.join()
                server.close()
        assert browser.errors == []

    return opened
