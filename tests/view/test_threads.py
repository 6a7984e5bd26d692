import asyncio
import threading
import time

import pytest

from canopen_control.view.threads import in_thread


def test_it_returns_and_raises_what_the_function_does_while_the_loop_goes_on():
    ticked = threading.Event()

    async def play():
        async def tick():
            await asyncio.sleep(0)
            ticked.set()

        task = asyncio.ensure_future(tick())
        assert await in_thread(lambda: "done" if ticked.wait(10) else "the loop stood still") == "done"
        with pytest.raises(ZeroDivisionError):
            await in_thread(lambda: 1 / 0)
        await task

    asyncio.run(play())


def test_what_hangs_does_not_hold_up_the_end():
    release, hangs = threading.Event(), threading.Event()

    def hang():
        hangs.set()
        release.wait(30)

    async def play():
        task = asyncio.ensure_future(in_thread(hang))
        while not hangs.is_set():
            await asyncio.sleep(0)
        task.cancel()

    begin = time.monotonic()
    asyncio.run(play())
    release.set()
    assert time.monotonic() - begin < 5
