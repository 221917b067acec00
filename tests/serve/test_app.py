import asyncio
import base64
import io
import json
import math
import re
import shlex
import struct
import threading
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import dense_scene
import numpy as np
import pytest
from PIL import Image
from starlette.testclient import TestClient

import dgc_pose
from dgc_pose.errors import InputError
from dgc_pose.serve import IMAGES, ServeOptions, app
from dgc_pose.serve.app import Server, WorkError, in_turn
from dgc_pose.serve.estimator import Estimator
from dgc_pose.serve.guard import TOKEN_HEADER, local_hosts

TOKEN = "a-token"
PORT = 8000
HOST = f"127.0.0.1:{PORT}"
OPTIONS = ServeOptions(max_megabytes=0.5, max_megapixels=1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("images")


@pytest.fixture(scope="module")
def client(folder, map_matcher):
    settings = {"token": TOKEN, "hosts": local_hosts(PORT), "options": OPTIONS}
    server = Server(Estimator(map_matcher, None), folder, **settings)
    with TestClient(server.app, f"http://{HOST}", headers={TOKEN_HEADER: TOKEN}) as client:
        yield client


def encoded(ending):
    return cv2.imencode(ending, dense_scene.pictures()[0][::4, ::4])[1].tobytes()


def send(client, data, name="a.png"):
    return client.post("/images", params={"name": name}, content=data)


@pytest.fixture
def pair(client, pictures):
    """The identifiers of both pictures, as sent."""
    return [send(client, Path(path).read_bytes(), path).json()["id"] for path in pictures]


def poses(client, first, second, camera):
    body = {"image1": first, "image2": second, "camera": camera}
    answer = client.post("/poses", json=body)
    if answer.status_code != 200:
        return {"error": answer.text}
    lines = [json.loads(line) for line in answer.text.splitlines()]
    assert all(list(line) == ["progress"] for line in lines[:-1])
    return lines[-1]


@pytest.mark.parametrize("path", ["/images", "/poses"])
def test_requests_of_other_pages_are_refused(client, folder, path):
    before = sorted(folder.iterdir())
    for name, value, words in (
        ("host", "evil.example:8000", "its own name"),
        ("host", "127.0.0.1:9999", "its own name"),
        ("origin", "http://evil.example", "its own pages"),
        ("origin", "https://127.0.0.1:8000", "its own pages"),
        ("sec-fetch-site", "same-site", "its own pages"),
        (TOKEN_HEADER, "", "token"),
        (TOKEN_HEADER, "ü", "token"),
    ):
        answer = client.post(path, content=encoded(".png"), headers={name: value.encode()})
        assert answer.status_code == 403 and words in answer.text
    assert sorted(folder.iterdir()) == before


def test_the_page_needs_the_token_in_its_address_and_holds_it(client):
    headers = {"origin": "http://localhost:8000", "host": "localhost:8000"}
    assert client.post("/images", content=encoded(".png"), headers=headers).status_code == 200
    assert client.get("/?token=other").status_code == 403
    page = client.get(f"/?token={TOKEN}")
    assert page.status_code == 200 and f'content="{TOKEN}"' in page.text
    policy = page.headers["content-security-policy"]
    assert "default-src 'none'" in policy and "unsafe" not in policy
    assert page.headers["x-content-type-options"] == "nosniff"
    assert "http" not in page.text  # nothing comes from elsewhere
    for path in (Path(app.__file__).parent / "static").glob("*.[cj]*s"):
        text = client.get(f"/static/{path.name}").text
        assert text and "http://" not in text and "https://" not in text
    assert client.get("/static/photographs/image2.jpg").status_code == 200
    for path in ("../app.py", "..%2fapp.py", "photographs/../../app.py", "/etc/passwd", "x%00"):
        answer = client.get(f"/static/{path}")
        assert answer.status_code in (403, 404) and "import" not in answer.text


def test_an_image_comes_back_upright_as_a_jpeg(client):
    stream, exif = io.BytesIO(), Image.Exif()
    exif[0x0112] = 6
    stored = dense_scene.pictures()[0]
    Image.fromarray(stored).save(stream, "JPEG", exif=exif)
    image = send(client, stream.getvalue(), "näme.x").json()
    assert image["size"] == [240, 320] and image["name"] == "näme.x"
    url, data = image["picture"].split(",")
    shown = np.asarray(Image.open(io.BytesIO(base64.b64decode(data)))).astype(int)
    assert url == "data:image/jpeg;base64" and np.abs(shown - np.rot90(stored, -1)).mean() < 8


def test_only_the_last_images_are_kept(client, folder):
    first, *_, last = [send(client, encoded(".png")).json()["id"] for _ in range(IMAGES + 1)]
    assert len(list(folder.iterdir())) == IMAGES
    body = {"image1": first, "image2": last, "camera": {"kind": "auto"}}
    answer = client.post("/poses", json=body)
    assert answer.status_code == 410  # by which the page sends it again
    assert "no longer there" in answer.text
    (most,) = re.findall(r"const MOST = (\d+)", client.get("/static/pairs.js").text)
    assert 5 * int(most) <= IMAGES  # of five pages with tables


def png_claiming(width, height):
    """A small PNG that claims another size."""
    data = bytearray(encoded(".png"))
    data[16:24] = struct.pack(">II", width, height)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    return bytes(data)


@pytest.mark.parametrize(
    "data",
    [b"", encoded(".jpg")[:99], b"P6 99999 99999 255\n" + bytes(50), png_claiming(1200, 1200)],
)
def test_a_file_that_is_no_image_leaves_the_server_as_it_was(client, folder, data):
    before = sorted(folder.iterdir())
    answer = send(client, data)
    assert answer.status_code == 422 and answer.text
    assert "\n" not in answer.text and str(folder) not in answer.text
    assert sorted(folder.iterdir()) == before


def test_too_large_a_file_is_refused_before_it_is_read(client, folder):
    before = sorted(folder.iterdir())
    large = bytes(600_000)
    assert send(client, large).status_code == 413
    # Without a length, as it comes.
    answer = client.post("/images", content=iter([large[:400_000], large[:400_000]]))
    assert answer.status_code == 413 and "0.5 MB" in answer.text
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize(
    ("camera", "flags"),
    [
        ({"kind": "k", "k1": dense_scene.K_TEXT, "k2": "auto"}, ["--K1", "300", "--K2", "auto"]),
        ({"kind": "fov", "fov": 56.1}, ["--K", str(160 / math.tan(math.radians(56.1) / 2))]),
        ({"kind": "auto"}, ["--K", "auto"]),
    ],
)
def test_the_command_and_the_python_give_the_same(
    client, pair, pictures, map_matcher, monkeypatch, camera, flags
):
    result = poses(client, *pair, camera)["result"]
    words = shlex.split(result["command"])
    assert words[:4] == ["dgc-pose", "estimate", *pictures]
    # Of K the focal length.
    assert [word.split(",")[0][:9] for word in words[4:]] == [flag[:9] for flag in flags]
    monkeypatch.setattr(dgc_pose, "load_matcher", lambda: map_matcher, raising=False)
    names: dict = {}
    exec(result["python"], names)
    pose = names["pose"]
    assert pose.success and pose.R.tolist() == result["pose"]["R"]
    assert pose.K2.tolist() == result["pose"]["camera2"]["K"]
    assert pose.focal_std1 == result["pose"]["camera1"]["focal_std"]


@pytest.mark.parametrize(
    ("camera", "words"),
    [
        (None, "kind"),
        ({"kind": "k", "k1": 5}, "text"),
        ({"kind": "k"}, "give K"),
        ({"kind": "k", "k1": 400 * "1"}, "300 characters"),
        ({"kind": "k", "k1": "300,300,900,119.5"}, "outside image 1 of 320x240"),
        ({"kind": "fov"}, "give the field of view"),
        ({"kind": "fov", "fov": "wide"}, "fov must be a number"),
    ],
)
def test_a_bad_camera_is_told_in_one_line(client, pair, camera, words):
    error = poses(client, *pair, camera)["error"]
    assert words in error and "\n" not in error


def test_no_path_of_a_client_is_opened(client, folder, pair, pictures, tmp_path):
    """A K on the command line may be a file; that of a client may not. Names are text alone."""
    secret = tmp_path / "secret.txt"
    np.savetxt(secret, dense_scene.K)
    error = poses(client, *pair, {"kind": "k", "k1": str(secret)})["error"]
    assert "fx,fy,cx,cy" in error
    for identifier in (pictures[0], "../a.png", None, 5, ["a"], {"a": 1}):
        assert "no longer there" in poses(client, identifier, pair[1], {"kind": "auto"})["error"]
    for name in ("../../K.txt", "", "a\0b" + 250 * "ü", str(tmp_path)):
        name = send(client, encoded(".png"), name).json()["name"]
        assert name.isprintable() and 0 < len(name) <= 200
    assert all(len(path.name) == 32 and path.parent == folder for path in folder.iterdir())


@pytest.mark.parametrize("body", [b"", b"[1]", 5000 * b"[", b"{" + 2_000_000 * b" "])
def test_a_request_that_is_no_object_is_refused(client, body):
    answer = client.post("/poses", content=body)
    assert answer.status_code in (400, 413) and "request" in answer.text


@pytest.fixture
def held():
    """Let a function that waits for it come to its end."""
    event = threading.Event()
    yield event
    event.set()


def test_a_failure_is_one_line():
    def fail(error):
        raise error

    for error, message in (
        (InputError("this\n will not do"), "^this will not do$"),
        (ZeroDivisionError(), "^the server failed: ZeroDivisionError$"),
    ):
        with pytest.raises(WorkError, match=message):
            asyncio.run(in_turn(ThreadPoolExecutor(1), fail, error, seconds=60))


def test_an_abandoned_call_does_not_begin_and_the_next_one_waits(held):
    async def calls():
        thread, begun = ThreadPoolExecutor(1), threading.Event()
        with pytest.raises(WorkError, match=r"^stopped after 0\.1 seconds$"):
            await in_turn(thread, held.wait, seconds=0.1)
        with pytest.raises(WorkError, match="stopped"):
            await in_turn(thread, begun.set, seconds=0.1)
        left = asyncio.create_task(in_turn(thread, begun.set, seconds=60))
        await asyncio.sleep(0)
        left.cancel()
        await asyncio.wait([left])
        held.set()
        assert await in_turn(thread, sum, [1, 2], seconds=60) == 3
        assert not begun.is_set()

    asyncio.run(calls())
