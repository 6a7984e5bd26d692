"""Faults of this program while a robot runs: told like any other event, and the robot goes on.

The law of this file: an exception that nobody expected is one sentence with its place, once for each place; its
traceback is for those who ask for it with CANOPEN_CONTROL_DEBUG.
"""

from __future__ import annotations

import os
import sys
import traceback
from typing import TYPE_CHECKING

from canopen_control.master.event_log import Event, Level

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["ProgramErrors"]

_MOST_PLACES = 20


class ProgramErrors:
    """A reactor's `on_error`: hands an event to `report`; `now` tells the time."""

    def __init__(self, now: Callable[[], int], report: Callable[[Event], None]) -> None:
        self._now, self._report = now, report
        self._told: set[str] = set()

    def __call__(self, error: BaseException) -> None:
        """Tell an exception, unless its place has been told."""
        if os.environ.get("CANOPEN_CONTROL_DEBUG"):
            traceback.print_exception(error, file=sys.stderr)
        place = _place_of(error)
        if place in self._told or len(self._told) >= _MOST_PLACES:
            return
        self._told.add(place)
        text = (
            f"a fault of this program at {place}: {type(error).__name__}: {error}; the robot goes on, please report it"
        )
        self._report(Event(self._now(), "program_error", "", text, Level.ERROR))


def _place_of(error: BaseException) -> str:
    frames = traceback.extract_tb(error.__traceback__)
    if not frames:
        return "an unknown place"
    last = frames[-1]
    return f"{last.filename.rpartition('canopen_control/')[2]}:{last.lineno}"
