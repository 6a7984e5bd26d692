"""Signal handlers for the duration of a `with` block, in a program without a reactor."""

from __future__ import annotations

import contextlib
import signal
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator


@contextlib.contextmanager
def on_signals(numbers: Iterable[signal.Signals], call: Callable[[], object]) -> Iterator[None]:
    """Call `call` on the main thread at any of these signals during the block; then restore the handlers."""
    before = {number: signal.signal(number, lambda *_: call()) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            # None: the handler was not set by Python, and Python cannot restore it
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def interrupt() -> None:
    """Raise KeyboardInterrupt like Ctrl-C, for signals that end a program in the same way."""
    raise KeyboardInterrupt
