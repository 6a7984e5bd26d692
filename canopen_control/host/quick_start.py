"""Faster start of a program: what its imports make is made on first use, and no garbage is looked for."""

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
    """Make methods of dataclasses and regular expressions of the imports in this context on first use."""
    with quick_dataclasses(), lazy_patterns():
        yield


@contextlib.contextmanager
def quick_start() -> Iterator[None]:
    """Do that without the garbage collector: a start creates almost no garbage."""
    gc.disable()
    try:
        with quick_imports():
            yield
        gc.freeze()
    finally:
        gc.enable()
