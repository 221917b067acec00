"""The page in a browser."""

import socket
import threading
from pathlib import Path

import cv2
import dense_scene
import numpy as np
import pytest
import uvicorn

from dgc_pose.matchers import load_matcher
from dgc_pose.serve import ServeOptions
from dgc_pose.serve.app import Server
from dgc_pose.serve.estimator import Estimator
from dgc_pose.serve.guard import local_hosts

pytestmark = pytest.mark.slow

DONE = "document.querySelector('#progress').textContent.startsWith('done')"
STALE = "document.querySelector('#result').classList.contains('stale')"
ROWS = "[...document.querySelectorAll('#pairs tbody tr')].map((row) => row.innerText)"


def test_files_give_poses(browser, pictures, tmp_path):
    folder = tmp_path / "images"
    folder.mkdir()
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        bound.listen()
        port = bound.getsockname()[1]
        settings = {"token": "t", "hosts": local_hosts(port), "options": ServeOptions()}
        server = Server(Estimator(load_matcher("sift"), None), folder, **settings)
        web = uvicorn.Server(uvicorn.Config(server.app, log_level="warning"))
        thread = threading.Thread(target=web.run, kwargs={"sockets": [bound]})
        thread.start()
        try:
            browser.open_anew(f"http://127.0.0.1:{port}/?token=t")
            use_page(browser, server, pictures, tmp_path)
        finally:
            web.should_exit = True
            thread.join()
    assert browser.errors == []


def set_K(page, text):
    page.click("[value=k]")
    event = "dispatchEvent(new Event('input', { bubbles: true }))"
    page.evaluate(f"document.querySelector('#k1').value = '{text}'")
    page.evaluate(f"document.querySelector('#k1').{event}")


def use_page(page, server, pictures, tmp_path):
    bad = tmp_path / "bad <b>.png"
    bad.write_bytes(b"not an image")
    page.choose("#file1", bad)
    page.wait("!document.querySelector('#error').hidden")
    page.errors.clear()  # the browser notes the refusal
    assert page.text("#error").startswith("bad <b>.png: the file is not an image of a known")
    set_K(page, dense_scene.K_TEXT)
    page.choose("#file1", *map(Path, pictures))
    page.wait(DONE)
    assert page.text("#verdict") == "A pose" and "expected error" in page.text("#numbers")
    R, t = (
        np.array([line.split() for line in text.splitlines()], float)
        for text in page.evaluate(
            "[...document.querySelectorAll('#poses table')].map((table) => table.innerText)"
        )
    )
    np.testing.assert_allclose(R, dense_scene.R, atol=0.01)
    np.testing.assert_allclose(t[:, 0], dense_scene.T, atol=0.05)
    assert str(tmp_path) not in page.evaluate("document.documentElement.innerHTML")
    # Images that the server has dropped are sent again.
    set_K(page, "310,310,159.5,119.5")
    assert page.evaluate(STALE)
    server._images.clear()
    page.click("#estimate")
    page.wait(f"!{STALE}")
    assert "310.0 px" in page.text("#numbers")
    assert "410" in page.errors.pop()  # which the browser notes
    # Three photographs, one of them of another scene, give a table.
    other = tmp_path / "other.png"
    cv2.imwrite(str(other), dense_scene.pictures(seed=1)[0])
    page.choose("#file2", *map(Path, pictures), other)
    page.wait("document.querySelector('#pairs-progress').textContent === '3 pairs, 1 with a pose'")
    rows = page.evaluate(ROWS)
    assert [row.count("No pose") for row in rows] == [1, 0, 1], "in the order of the names"
    page.click("#example")
    page.wait(f"{DONE} && document.querySelector('#picture1').alt === 'image1.jpg'")
