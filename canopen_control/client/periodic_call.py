"""Function calls at a fixed interval on a separate thread, while other work blocks the calling thread."""

from __future__ import annotations

import contextlib
import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@contextlib.contextmanager
def periodic_call(
    function: Callable[[], object], period_s: float, *, name: str, join_s: float | None = None
) -> Iterator[None]:
    """Context in which the thread `name` calls `function` every `period_s`, first after one period.

    The exit waits for a running call, for `join_s` at most (None: without limit). An exception of `function` ends the
    calls.
    """
    ended = threading.Event()

    def run() -> None:
        while not ended.wait(period_s):
            function()

    thread = threading.Thread(target=run, name=name, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join(join_s)
