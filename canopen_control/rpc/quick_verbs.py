"""Helpers for CLI verbs that only query a running robot and end within a tenth of a second: no slow imports."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import types


def import_msgspec() -> None:
    """Import msgspec without typing_extensions and platform, which take most of its import time.

    msgspec searches typing_extensions for types that this package does not use, and works with `typing` alone. It
    imports uuid, which before Python 3.12 needs only the name of the operating system from platform. No other code may
    import these modules meanwhile, so this function does nothing while other threads run. Call it only in programs
    without foreign code, whose structures may need types that msgspec would not find.
    """
    if {"msgspec", "typing_extensions"} & sys.modules.keys() or threading.active_count() > 1:
        return
    sys.modules["typing_extensions"] = None  # type: ignore[assignment] # the import system's mark for "missing"
    quick_platform = "platform" not in sys.modules and hasattr(os, "uname")
    if quick_platform:
        sys.modules["platform"] = types.ModuleType("platform")
        sys.modules["platform"].system = lambda: os.uname().sysname  # type: ignore[attr-defined] # the only use in uuid
    try:
        with contextlib.suppress(ImportError):
            import msgspec  # noqa: F401 - for later imports
    finally:
        del sys.modules["typing_extensions"]
        if quick_platform:
            del sys.modules["platform"]


def state_name(state: str | None) -> str:
    """Return a CiA 402 or NMT state name with spaces, as in the standards; "-" for None."""
    return "-" if state is None else state.replace("_", " ")
