"""The server: it sends the page, receives images, and answers with poses."""

import asyncio
import json
import secrets
import threading
import traceback
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import anyio
import cv2
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from dgc_pose.cameras.pair_list import bundled_photographs
from dgc_pose.errors import DgcPoseError, ImageError, InputError
from dgc_pose.images.decoding import image_size
from dgc_pose.images.image import load_image, picture_url
from dgc_pose.serve import DECODE_SECONDS, IMAGES, UPLOAD_SECONDS, ServeOptions
from dgc_pose.serve.estimator import Estimator, StoredImage
from dgc_pose.serve.guard import Guard
from dgc_pose.version import version
from dgc_pose.viz.figure import shrunk

Value = TypeVar("Value")
_STATIC = Path(__file__).parent / "static"
_PHOTOGRAPHS = bundled_photographs()[0].parent
_MAX_JSON = 10_000  # bytes of a request
_MAX_NAME = 200  # characters of an image's name


class WorkError(DgcPoseError):
    """A request without a result; the message is one line for the client."""

    status = 422  # of HTTP


class Gone(InputError):
    """An image that the server has dropped, or never had."""

    status = 410  # of HTTP: the page sends the image again


async def in_turn(
    thread: ThreadPoolExecutor, function: Callable[..., Value], *arguments: Any, seconds: float
) -> Value:
    """Call a function in a pool's only thread, and return its result. A cancelled call leaves the
    queue; if it is running already, it runs to its end and its result is dropped.

    seconds: limit of the call, with the time in the queue. Raises WorkError if the time is over or
    the function fails.
    """
    try:
        with anyio.fail_after(seconds):
            return await asyncio.wrap_future(thread.submit(function, *arguments))
    except TimeoutError:
        text = f"stopped after {seconds:g} seconds"
    except (DgcPoseError, OSError) as error:
        text = " ".join(str(error).split())
    except Exception as error:  # from any library
        traceback.print_exc()
        text = f"the server failed: {type(error).__name__}"
    raise WorkError(text)


class Server:
    """The images, the threads that work on them, and an ASGI application.

    folder: empty folder for the images; the caller removes it when the server has ended. token:
    secret of the page. hosts: see `guard.local_hosts`.
    """

    def __init__(
        self,
        estimator: Estimator,
        folder: Path,
        *,
        token: str,
        hosts: frozenset[str],
        options: ServeOptions,
    ) -> None:
        self.options = options
        self._token = token
        self._estimator = estimator
        self._folder = folder
        # By identifier, which is never part of a path; the most recently used image is last.
        self._images: dict[str, StoredImage] = {}
        # Two threads, so that photographs do not wait for poses.
        self._decoding = ThreadPoolExecutor(1)
        self._estimating = ThreadPoolExecutor(1)
        self.app = Starlette(
            routes=[
                Route("/", self._page),
                Mount("/static/photographs", StaticFiles(directory=_PHOTOGRAPHS)),
                Mount("/static", StaticFiles(directory=_STATIC)),
                Route("/images", self._image, methods=["POST"]),
                Route("/poses", self._pose, methods=["POST"]),
            ],
            middleware=[Middleware(Guard, token=token, hosts=hosts)],
            exception_handlers=dict.fromkeys((DgcPoseError, OSError, ClientDisconnect), _refused),
        )

    async def _page(self, request: Request) -> Response:
        text = (_STATIC / "page.html").read_text(encoding="utf-8")
        text = text.replace("{{token}}", self._token).replace("{{version}}", version())
        return Response(text, media_type="text/html")

    async def _image(self, request: Request) -> Response:
        """Receive an image as the raw body; answer with its identifier, size and a picture."""
        most = self.options.max_megabytes
        too_large = (
            f"the file is too large: the limit is {most:g} MB (--max-megabytes of dgc-pose serve)"
        )
        try:
            with anyio.fail_after(UPLOAD_SECONDS):
                content = await _body(request, int(most * 1e6), too_large)
        except TimeoutError:
            text = f"the file did not arrive within {UPLOAD_SECONDS:g} seconds"
            raise HTTPException(408, text) from None
        name = request.query_params.get("name", "")
        name = "".join(letter for letter in name if letter.isprintable())[:_MAX_NAME] or "image"
        path = self._folder / secrets.token_hex(16)
        try:
            path.write_bytes(content)
            pixels = int(self.options.max_megapixels * 1e6)
            shown = await in_turn(self._decoding, preview, path, pixels, seconds=DECODE_SECONDS)
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        identifier = secrets.token_urlsafe(16)
        self._images[identifier] = StoredImage(path, name)
        if len(self._images) > IMAGES:
            self._images.pop(next(iter(self._images))).path.unlink(missing_ok=True)
        return JSONResponse({"id": identifier, "name": name, **shown})

    async def _pose(self, request: Request) -> Response:
        """Answer with lines of JSON: the progress, and last the result or an error."""
        data = await _json(request)
        image1, image2 = (self._sent(data.get(key)) for key in ("image1", "image2"))
        lines = self._progress(image1, image2, data.get("camera"))
        return StreamingResponse(lines, media_type="application/x-ndjson")

    def _sent(self, identifier: object) -> StoredImage:
        """The image of an identifier. Raises Gone if the server does not have it."""
        image = self._images.pop(str(identifier), None)
        if image is None:
            raise Gone("the image is no longer there: send it again")
        self._images[str(identifier)] = image
        return image

    async def _progress(
        self, image1: StoredImage, image2: StoredImage, camera: object
    ) -> AsyncIterator[str]:
        loop = asyncio.get_running_loop()
        lines: asyncio.Queue[Mapping[str, Any]] = asyncio.Queue()
        gone = threading.Event()

        def report(text: str) -> None:
            if gone.is_set():
                raise WorkError("the client has left")
            loop.call_soon_threadsafe(lines.put_nowait, {"progress": text})

        async def estimate() -> None:
            call = self._estimator.estimate, report, image1, image2, camera
            seconds = self.options.estimate_seconds
            try:
                result = await in_turn(self._estimating, *call, seconds=seconds)
                lines.put_nowait({"result": result})
            except DgcPoseError as error:
                lines.put_nowait({"error": str(error)})

        task = asyncio.create_task(estimate())
        line: Mapping[str, Any] = {"progress": ""}
        try:
            while "progress" in line:
                line = await lines.get()
                yield json.dumps(line) + "\n"
        finally:  # also if the client has left, which ends the response
            gone.set()
            task.cancel()


def preview(path: Path, max_pixels: int) -> dict[str, Any]:
    """Size (width, height) of an upright image, and a picture, as the browser may not support the
    file's format. Raises ImageError, without the path, for an unreadable or too large image."""
    try:
        width, height = image_size(path)
        if width * height > max_pixels:  # checked before decoding
            raise ImageError(
                f"{path} is too large: {width} x {height}, and the limit is {max_pixels} pixels "
                "(--max-megapixels of dgc-pose serve)"
            )
        image = load_image(path)
    except DgcPoseError as error:
        # The client must not see the path.
        raise ImageError(str(error).replace(str(path), "the file")) from None
    return {
        "size": list(image.size),
        "picture": picture_url(shrunk(image.pixels), "jpeg", cv2.IMWRITE_JPEG_QUALITY, 88),
    }


async def _refused(request: Request, error: Exception) -> Response:
    """The line of an error; empty for a client that left before its request was complete."""
    return PlainTextResponse(str(error), getattr(error, "status", 400))


async def _body(request: Request, most: int, too_large: str) -> bytes:
    """A body of at most `most` bytes. Raises HTTPException for a larger body, before reading it if
    the request states its length."""
    received = bytearray()
    if int(request.headers.get("content-length", 0)) > most:
        raise HTTPException(413, too_large)
    async for part in request.stream():
        received += part
        if len(received) > most:
            raise HTTPException(413, too_large)
    return bytes(received)


async def _json(request: Request) -> Mapping[str, Any]:
    """The JSON object in a request. Raises InputError for anything else."""
    body = await _body(request, _MAX_JSON, "the request is too long")
    try:
        data = json.loads(body)
    except (ValueError, RecursionError):
        raise InputError("the request is not JSON") from None
    if not isinstance(data, dict):
        raise InputError("the request must be an object")
    return data
