"""A thread that works on one request at a time, each within a time limit.

A thread cannot be stopped: work that nobody waits for any more runs to its end, or until it reports
what it does, and its result is dropped.
"""

import asyncio
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import anyio

from dgc_pose.errors import DgcPoseError

Value = TypeVar("Value")


class WorkError(DgcPoseError):
    """A request that came to no result; the message is one line for the client."""

    status = 422  # of HTTP


class Unavailable(WorkError):
    """The client has left, or the server ends."""

    status = 503


class Worker:
    """The thread."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1)
        self._waits: set[asyncio.Future[Any]] = set()
        self._closed = False

    async def call(self, function: Callable[..., Value], *arguments: Any, seconds: float) -> Value:
        """What the function returns, called in the thread. A call that is cancelled gives up its
        place.

        seconds: of the call, with its wait for those before it. Raises WorkError: Unavailable, or
        WorkError itself if the time has passed or the function fails.
        """
        if self._closed:
            raise Unavailable("the server is ending")
        wait = asyncio.wrap_future(self._pool.submit(_outcome, function, *arguments))
        self._waits.add(wait)
        try:
            with anyio.fail_after(seconds):
                return await wait
        except TimeoutError:
            raise WorkError(f"stopped after {seconds:g} seconds") from None
        except asyncio.CancelledError:
            if self._closed:
                raise Unavailable("the server is ending") from None
            raise
        finally:
            self._waits.remove(wait)

    def close(self) -> None:
        """End the thread after what it does now; calls under way and later ones raise
        Unavailable."""
        self._closed = True
        self._pool.shutdown(wait=False)
        for wait in self._waits:
            wait.cancel()


def _outcome(function: Callable[..., Value], *arguments: Any) -> Value:
    """The result of the function. Raises WorkError, with one line for the client."""
    try:
        return function(*arguments)
    except (DgcPoseError, OSError) as error:
        text = " ".join(str(error).split())
    except Exception as error:  # of any library
        traceback.print_exc()
        text = f"the server failed: {type(error).__name__}"
    raise WorkError(text)
