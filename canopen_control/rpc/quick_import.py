"""Quicker imports for verbs that only ask a running robot and are over in a tenth of a second."""

from __future__ import annotations

import contextlib
import sys
import threading


def import_msgspec() -> None:
    """Import msgspec without typing_extensions, which is half the time that its import takes.

    msgspec looks into typing_extensions for types that we have none of, and does with `typing` where it is missing.
    Nobody else may look for that module meanwhile, so this does nothing while other threads run; and it is for programs
    that run our own code alone, for another's structures may need what msgspec does not see then.
    """
    if {"msgspec", "typing_extensions"} & sys.modules.keys() or threading.active_count() > 1:
        return
    sys.modules["typing_extensions"] = None  # type: ignore[assignment] # the import system's own way to say "missing"
    try:
        with contextlib.suppress(ImportError):
            import msgspec  # noqa: F401 - for who imports it next
    finally:
        del sys.modules["typing_extensions"]
