"""Calls in the server's thread: each ends within its time, whatever the function does."""

import asyncio
import threading

import pytest

from dgc_pose.errors import InputError
from dgc_pose.serve.worker import Unavailable, Worker, WorkError

SECONDS = 60


@pytest.fixture
def held():
    """Let a function that waits for it come to its end."""
    event = threading.Event()
    yield event
    event.set()


def test_a_failure_is_one_line_and_the_next_call_works():
    def fail(error):
        raise error

    async def calls():
        worker = Worker()
        for error, message in (
            (InputError("this\n will not do"), "^this will not do$"),
            (ZeroDivisionError(), "^the server failed: ZeroDivisionError$"),
        ):
            with pytest.raises(WorkError, match=message) as caught:
                await worker.call(fail, error, seconds=SECONDS)
            assert type(caught.value) is WorkError and caught.value.status == 422
        assert await worker.call(sum, [1, 2], seconds=SECONDS) == 3
        worker.close()

    asyncio.run(calls())


def test_what_takes_too_long_is_given_up_and_the_next_call_waits_for_it(held):
    async def calls():
        worker = Worker()
        with pytest.raises(WorkError, match=r"^stopped after 0\.1 seconds$"):
            await worker.call(held.wait, seconds=0.1)
        # The time of the next call passes before it begins, and it never does.
        begun = threading.Event()
        with pytest.raises(WorkError, match="stopped"):
            await worker.call(begun.set, seconds=0.1)
        held.set()
        assert await worker.call(sum, [1, 2], seconds=SECONDS) == 3 and not begun.is_set()
        worker.close()

    asyncio.run(calls())


def test_closing_ends_all_calls(held):
    async def calls():
        worker = Worker()
        waiting = [asyncio.create_task(worker.call(held.wait, seconds=SECONDS)) for _ in "ab"]
        await asyncio.sleep(0)  # until both have begun
        worker.close()
        errors = await asyncio.gather(*waiting, return_exceptions=True)
        with pytest.raises(Unavailable) as late:
            await worker.call(sum, [], seconds=SECONDS)
        for error in (*errors, late.value):
            assert (str(error), error.status) == ("the server is ending", 503)

    asyncio.run(calls())


def test_a_call_that_is_cancelled_gives_up_its_place(held):
    async def calls():
        worker, begun = Worker(), threading.Event()
        calls = [worker.call(function, seconds=SECONDS) for function in (held.wait, begun.set)]
        left = [asyncio.create_task(call) for call in calls]
        await asyncio.sleep(0)
        for task in left:
            task.cancel()
        await asyncio.wait(left)
        assert all(task.cancelled() for task in left)
        next_one = asyncio.create_task(worker.call(sum, [1, 2], seconds=SECONDS))
        await asyncio.sleep(0)
        held.set()
        assert await next_one == 3 and not begun.is_set()
        worker.close()

    asyncio.run(calls())
