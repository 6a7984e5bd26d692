"""Signal handlers for the length of a `with`, in a program without a reactor."""

from __future__ import annotations

import contextlib
import signal
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator


@contextlib.contextmanager
def on_signals(numbers: Iterable[signal.Signals], call: Callable[[], object]) -> Iterator[None]:
    """Call `call` at any of these signals, on the main thread, until the end of the block; then as it was before."""
    before = {number: signal.signal(number, lambda *_: call()) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            # None: the handler was not Python's, and Python cannot put it back
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def interrupt() -> None:
    """Do as Ctrl-C does; for signals that shall end a program in the same way."""
    raise KeyboardInterrupt
