"""The server: the page, images in, poses out."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

import anyio
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from dgc_pose.errors import DgcPoseError, InputError
from dgc_pose.serve.cameras import CameraRequest
from dgc_pose.serve.decoder import Decoder, Preview, data_url
from dgc_pose.serve.factory import EstimatorFactory
from dgc_pose.serve.guard import Guard
from dgc_pose.serve.options import ServeOptions
from dgc_pose.serve.store import ImageStore, StoredImage
from dgc_pose.serve.worker import Busy, Worker
from dgc_pose.version import version

# The files of the page by what a client may ask for; no other name reaches a path.
_FILES = {
    "page.css": "text/css",
    "page.js": "text/javascript",
    "view.js": "text/javascript",
    "icon.svg": "image/svg+xml",
}
_MAX_JSON = 10_000  # bytes of a request
_MAX_NAME = 200  # characters of an image's name that are kept
_DECODER_MEMORY = 2 * 2**30  # bytes


@dataclass(frozen=True)
class Example:
    """The pair that the page offers."""

    paths: tuple[Path, Path]
    k: tuple[str, str]  # of both cameras, as the command takes them


class Server:
    """The workers, the images, and an ASGI application of them.

    folder: for the images; empty, and removed by the caller when the server has ended. token: what
    the page must know. hosts: see `guard.own_hosts`.
    """

    def __init__(
        self,
        estimator: EstimatorFactory,
        example: Example,
        folder: Path,
        *,
        token: str,
        hosts: frozenset[str],
        options: ServeOptions | None = None,
    ) -> None:
        self.options = options or ServeOptions()
        self._example, self._token = example, token
        self._store = ImageStore(folder, self.options.images)
        waiting = self.options.waiting
        self._decoder = Worker(
            partial(Decoder, self.options.max_pixels), waiting=waiting, memory=_DECODER_MEMORY
        )
        self.estimator = Worker(estimator, waiting=waiting)
        self._uploads = asyncio.Semaphore(waiting)
        routes = [
            Route("/", self._page),
            Route("/static/{name}", self._file),
            Route("/images", self._image, methods=["POST"]),
            Route("/example", self._bundled, methods=["POST"]),
            Route("/poses", self._pose, methods=["POST"]),
        ]
        self.app = Starlette(
            routes=routes,
            middleware=[Middleware(Guard, token=token, hosts=hosts)],
            exception_handlers={DgcPoseError: _told, ClientDisconnect: _unheard},
        )

    def start(self) -> None:
        """Start the workers, so that the first pair need not wait for them."""
        self._decoder.start()
        self.estimator.start()

    def close(self) -> None:
        """End the workers."""
        self._decoder.close()
        self.estimator.close()

    async def _page(self, request: Request) -> Response:
        text = _static("page.html").decode()
        text = text.replace("{{token}}", self._token).replace("{{version}}", version())
        return Response(text, media_type="text/html")

    async def _file(self, request: Request) -> Response:
        kind = _FILES.get(request.path_params["name"])
        if kind is None:
            return Response("no such file", 404, media_type="text/plain")
        return Response(_static(request.path_params["name"]), media_type=kind)

    async def _image(self, request: Request) -> Response:
        """An image, the body as it is; answers with its identifier, its size and a picture."""
        if self._uploads.locked():
            raise Busy("too many images are being sent: try again in a moment")
        name = _name(request.query_params.get("name", ""))
        path = self._store.new_path()
        try:
            async with self._uploads:
                await self._receive(request, path)
            stored, preview = await self._read(path, name)
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        return JSONResponse(self._described(stored, preview))

    async def _bundled(self, request: Request) -> Response:
        """The bundled pair, as if it had been sent."""
        images = []
        for path in self._example.paths:
            stored, preview = await self._read(path, str(path))
            images.append(self._described(stored, preview))
        return JSONResponse({"images": images, "k": list(self._example.k)})

    async def _pose(self, request: Request) -> Response:
        """Lines of JSON: what is being done, and at last the result or an error."""
        data = await _json(request)
        first, second = (self._store.get(data.get(key)) for key in ("image1", "image2"))
        camera = CameraRequest.of(data.get("camera"))
        return StreamingResponse(
            self._progress(first, second, camera), media_type="application/x-ndjson"
        )

    async def _progress(
        self, first: StoredImage, second: StoredImage, camera: CameraRequest
    ) -> AsyncIterator[str]:
        loop = asyncio.get_running_loop()
        lines: asyncio.Queue[Mapping[str, Any]] = asyncio.Queue()

        def tell(line: Mapping[str, Any]) -> None:
            with suppress(RuntimeError):  # the server has ended
                loop.call_soon_threadsafe(lines.put_nowait, line)

        def work() -> None:
            try:
                found = self.estimator.call(
                    "estimate",
                    first,
                    second,
                    camera,
                    seconds=self.options.estimate_seconds,
                    report=lambda text: tell({"progress": text}),
                )
                tell({"result": found})
            except DgcPoseError as error:
                text = str(error)
                for stored in (first, second):
                    text = text.replace(str(stored.path), stored.name)
                tell({"error": text})

        loop.run_in_executor(None, work)
        while True:
            line = await lines.get()
            yield json.dumps(line) + "\n"
            if "progress" not in line:
                return

    async def _receive(self, request: Request, path: Path) -> None:
        """The body into a new file. Raises _TooLarge or _TooSlow."""
        length = request.headers.get("content-length", "0")
        # A number of thousands of digits is none for `int`.
        if not length.isdecimal() or len(length) > 20 or int(length) > self.options.max_bytes:
            raise _TooLarge(self.options.max_megabytes)
        received = 0
        try:
            with anyio.fail_after(self.options.upload_seconds):
                with path.open("xb") as file:
                    async for part in request.stream():
                        received += len(part)
                        if received > self.options.max_bytes:
                            raise _TooLarge(self.options.max_megabytes)
                        file.write(part)
        except TimeoutError:
            raise _TooSlow(self.options.upload_seconds) from None
        except OSError as error:
            raise _NoRoom(f"the server's temporary folder: {error.strerror}") from None

    async def _read(self, path: Path, name: str) -> tuple[StoredImage, Preview]:
        call: Callable[[], Preview] = partial(
            self._decoder.call, "preview", path, seconds=self.options.decode_seconds
        )
        preview = await asyncio.get_running_loop().run_in_executor(None, call)
        return StoredImage(path, name, preview.size), preview

    def _described(self, stored: StoredImage, preview: Preview) -> dict[str, Any]:
        return {
            "id": self._store.keep(stored),
            "name": stored.name,
            "size": list(preview.size),
            "picture": data_url(preview.jpeg, "image/jpeg"),
            "warnings": list(preview.warnings),
        }


class _TooLarge(DgcPoseError):
    status = 413

    def __init__(self, megabytes: float) -> None:
        super().__init__(f"the file is too large: at most {megabytes:g} MB are taken")


class _TooSlow(DgcPoseError):
    status = 408

    def __init__(self, seconds: float) -> None:
        super().__init__(f"the file did not arrive within {seconds:g} seconds")


class _NoRoom(DgcPoseError):
    status = 507


async def _unheard(request: Request, error: Exception) -> Response:
    """The client left before its request was there."""
    return Response(status_code=400)


async def _told(request: Request, error: Exception) -> Response:
    """An error on purpose: its one line."""
    return JSONResponse({"error": str(error)}, getattr(error, "status", 400))


async def _json(request: Request) -> Mapping[str, Any]:
    """The object that a request holds. Raises InputError for anything else."""
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > _MAX_JSON:
            raise InputError("the request is too long")
    try:
        data = json.loads(body)
    except (ValueError, RecursionError):
        raise InputError("the request is not JSON") from None
    if not isinstance(data, dict):
        raise InputError("the request must be an object")
    return data


def _name(text: str) -> str:
    """What a client calls its image, for texts: printable, one line, of bounded length."""
    kept = "".join(letter for letter in text if letter.isprintable())[:_MAX_NAME]
    return kept or "image"


def _static(name: str) -> bytes:
    return (resources.files("dgc_pose.serve") / "static" / name).read_bytes()
