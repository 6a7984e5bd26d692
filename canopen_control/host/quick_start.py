"""Faster program start: dataclass methods and regular expressions are created on first use; no garbage collection."""

from __future__ import annotations

import contextlib
import gc
from typing import TYPE_CHECKING

from canopen_control.host.lazy_patterns import lazy_patterns
from canopen_control.host.quick_dataclasses import quick_dataclasses

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextlib.contextmanager
def quick_imports() -> Iterator[None]:
    """Create dataclass methods and compile regular expressions of modules imported in this context on first use."""
    with quick_dataclasses(), lazy_patterns():
        yield


@contextlib.contextmanager
def quick_start() -> Iterator[None]:
    """Speed up imports as `quick_imports` does, with the garbage collector disabled until the end of the context."""
    gc.disable()
    try:
        with quick_imports():
            yield
        gc.freeze()
    finally:
        gc.enable()
