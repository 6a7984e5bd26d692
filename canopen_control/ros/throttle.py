"""A sentence that is said at most once per interval, however often it becomes true."""

from __future__ import annotations

__all__ = ["Throttle"]


class Throttle:
    """`allows(key, now)` is True once per `interval_ns` for each key; the first time always."""

    def __init__(self, interval_ns: int = 1_000_000_000) -> None:
        self.interval_ns = interval_ns
        self._last: dict[str, int] = {}

    def allows(self, key: str, now: int) -> bool:
        """Whether it may be said again; `now` in ns."""
        last = self._last.get(key)
        if last is not None and now - last < self.interval_ns:
            return False
        self._last[key] = now
        return True
