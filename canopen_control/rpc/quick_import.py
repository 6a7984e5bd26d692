"""Faster imports for verbs that only query a running robot and end within a tenth of a second."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import types


def import_msgspec() -> None:
    """Import msgspec without typing_extensions and platform, which take most of the time of its import.

    msgspec looks into typing_extensions for types that we have none of, and does with `typing` where it is missing.
    It imports uuid, which asks platform, until Python 3.12, for the name of the system and nothing else.
    No other code may look for these modules meanwhile, so this does nothing while other threads run; and it is for
    programs that run our own code alone, for another's structures may need what msgspec does not see then.
    """
    if {"msgspec", "typing_extensions"} & sys.modules.keys() or threading.active_count() > 1:
        return
    sys.modules["typing_extensions"] = None  # type: ignore[assignment] # the import system's own way to say "missing"
    quick_platform = "platform" not in sys.modules and hasattr(os, "uname")
    if quick_platform:
        sys.modules["platform"] = types.ModuleType("platform")
        sys.modules["platform"].system = lambda: os.uname().sysname  # type: ignore[attr-defined] # all that uuid calls
    try:
        with contextlib.suppress(ImportError):
            import msgspec  # noqa: F401 - for who imports it next
    finally:
        del sys.modules["typing_extensions"]
        if quick_platform:
            del sys.modules["platform"]
