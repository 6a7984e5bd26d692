"""Wire faults of a ``local:`` bus (cut cables, dropped frames), by the labels of its members.

A label without a member is allowed: its cable is cut when a member with this label joins.
"""

from __future__ import annotations

from canopen_control.frame import RECORD, RECORD_SIZE


class DropRule:
    """Rule that drops frames of `label` ("" for all) with identifier `can_id` (None for any).

    Each `every`-th matching frame is dropped, `count` of them in all (None: no limit).
    """

    __slots__ = ("can_id", "count", "every", "label", "lost", "matched")

    def __init__(self, label: str = "", can_id: int | None = None, every: int = 1, count: int | None = None) -> None:
        self.label, self.can_id, self.every, self.count = label, can_id, max(1, every), count
        self.matched = 0
        self.lost = 0

    @property
    def spent(self) -> bool:
        """Whether the rule has dropped its `count` frames."""
        return self.count is not None and self.lost >= self.count

    def takes(self, label: str, can_id: int) -> bool:
        """Count a frame that matches the rule, and return whether the rule drops it."""
        if self.spent or self.label not in ("", label) or self.can_id not in (None, can_id):
            return False
        self.matched += 1
        lost = self.matched % self.every == 0
        self.lost += lost
        return lost


class WireFaults:
    """Faults of one bus by label: cut cables, controllers in bus-off, delays and drop rules."""

    def __init__(self) -> None:
        self.cut: set[str] = set()
        self.bus_off: set[str] = set()
        self.delays: dict[str, int] = {}  # label, "" for all ports -> ns
        self.drops: list[DropRule] = []

    @property
    def active(self) -> bool:
        """Whether frames must be checked before delivery because of delays or drop rules."""
        return bool(self.delays or self.drops)

    def silences(self, label: str) -> bool:
        """Whether members with this label are disconnected, by a cut cable or bus-off."""
        return label in self.cut or label in self.bus_off

    def delay_of(self, label: str) -> int:
        """Return the delay of frames from this label, in ns."""
        return self.delays.get(label, self.delays.get("", 0))

    def delay(self, label: str, delay_ns: int) -> None:
        """Delay frames from this label ("" for all) by `delay_ns`; 0 ends the delay."""
        if delay_ns > 0:
            self.delays[label] = delay_ns
        else:
            self.delays.pop(label, None)

    def survivors(self, label: str, records: bytes) -> bytes:
        """Apply the drop rules, and return the records that are not dropped."""
        if not self.drops:
            return records
        remaining = b"".join(
            records[at : at + RECORD_SIZE]
            for at in range(0, len(records), RECORD_SIZE)
            if not self._lost(label, RECORD.unpack_from(records, at)[0])
        )
        self.drops = [rule for rule in self.drops if not rule.spent]
        return remaining

    def _lost(self, label: str, can_id: int) -> bool:
        return any(rule.takes(label, can_id) for rule in self.drops)
