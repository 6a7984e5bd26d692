"""Throttling of repeated log messages.

This module imports no ROS.
"""

from __future__ import annotations

import re
from typing import Final

_NUMBERS: Final = re.compile(r"[-+]?[0-9]+(?:\.[0-9]+)?(?:e[-+]?[0-9]+)?")


def without_numbers(text: str) -> str:
    """Replace the numbers in a message by "#", which gives a key for messages of the same kind."""
    return _NUMBERS.sub("#", text)


class Throttle:
    """Rate limit of log messages: one per `interval_ns` for each key."""

    def __init__(self, interval_ns: int = 1_000_000_000) -> None:
        self.interval_ns = interval_ns
        self._last: dict[str, int] = {}

    def allows(self, key: str, now: int) -> bool:
        """Whether a message with this key may be logged at `now` in ns; if so, the key's next interval starts."""
        last = self._last.get(key)
        if last is not None and now - last < self.interval_ns:
            return False
        self._last[key] = now
        return True


class Refusals:
    """Refused commands of each controller; only the first one, and finally their number, is reported.

    The commands of a publisher that continues while the drives are off are refused fifty times a second for the same
    reason. A new reason is reported again; a message in which only the numbers differ is not a new reason.
    """

    def __init__(self) -> None:
        self._reasons: dict[str, str] = {}
        self._counts: dict[str, int] = {}

    def answered(self, controller: str, error: str | None) -> str | None:
        """Record the reply to a command (None: accepted); return the message to log, if any."""
        if error is None:
            count = self._counts.pop(controller, 0)
            self._reasons.pop(controller, None)
            return f"{controller} accepts commands again; {count} were refused" if count > 1 else None
        self._counts[controller] = self._counts.get(controller, 0) + 1
        reason = without_numbers(error)
        if self._reasons.get(controller) == reason:
            return None
        self._reasons[controller] = reason
        return error
