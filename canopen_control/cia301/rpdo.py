"""An RPDO on the device's side: when its data count (CiA 301, 7.2.2.2 and 7.5.2.35).

Types 0 to 240 hold the newest data until the next SYNC; 254 and 255 apply it at once. Other types are no RPDO's.
Data shorter than the mapping are dropped and told (EMCY 0x8210); of longer data the mapped part counts and the rest
is told (0x8220). The event timer, where set, is a deadline: it starts with the first reception (0x8250).
"""

from __future__ import annotations

import enum
from typing import NamedTuple

from canopen_control.cia301.outbox import Outbox
from canopen_control.cia301.pdo import LAST_CYCLIC, PdoParameters, is_event_driven
from canopen_control.frame import EXTENDED_FLAG, CanFrame

__all__ = ["EMCY_OF", "RpdoConsumer", "RpdoEvent", "RpdoEventKind"]


class RpdoEventKind(enum.Enum):
    """What an RPDO tells."""

    APPLY = "apply"  # write `data` to the mapped objects now
    TOO_SHORT = "too short"
    TOO_LONG = "too long"
    TIMEOUT = "timeout"
    RESOLVED = "resolved"  # the first data after a timeout


EMCY_OF: dict[RpdoEventKind, int] = {
    RpdoEventKind.TOO_SHORT: 0x8210,
    RpdoEventKind.TOO_LONG: 0x8220,
    RpdoEventKind.TIMEOUT: 0x8250,
}


class RpdoEvent(NamedTuple):
    """`kind`; `data` are exactly the mapped bytes for APPLY, empty otherwise; `length` is the frame's."""

    kind: RpdoEventKind
    data: bytes = b""
    length: int = 0


class RpdoConsumer:
    """One RPDO whose mapping has `length` bytes.

    Deaf before `start` (OPERATIONAL) and after `stop`. `received` counts accepted frames, `short` and `long` length
    errors, `late` synchronous data that came outside the window `window_ns` after the SYNC (0x1007; 0: no window).
    `length_error` is what was wrong with the length of the last frame, None for nothing.
    """

    def __init__(self, parameters: PdoParameters, length: int, *, window_ns: int = 0) -> None:
        self.length = length
        self.window_ns = window_ns
        self.running = False
        self.received = self.short = self.long = self.late = 0
        self.length_error: RpdoEventKind | None = None
        self.happened: Outbox[RpdoEvent] = Outbox()
        self._sync_ns: int | None = None
        self._held: bytes | None = None
        self._deadline_ns: int | None = None
        self._timed_out = False
        self._adopt(parameters)

    @property
    def holds(self) -> bool:
        """Whether data wait for the next SYNC."""
        return self._held is not None

    @property
    def parameters(self) -> PdoParameters:
        """The communication record."""
        return self._parameters

    def configure(self, parameters: PdoParameters, length: int) -> None:
        """Take a new communication record and mapping length; held data are forgotten."""
        self.length = length
        self._clear()
        self._adopt(parameters)

    def start(self) -> None:
        """Begin: the node became OPERATIONAL."""
        self._clear()
        self.running = True

    def stop(self) -> None:
        """End: the node left OPERATIONAL; held data are forgotten. No-op when stopped."""
        self._clear()
        self.running = False

    def receive(self, frame: CanFrame, now: int) -> None:
        """Take the PDO; other frames are ignored."""
        if frame.can_id != self._can_id or not self.running:
            return
        if self._deadline_ns is not None:
            self.tick(now)  # data behind the deadline resolve a timeout, they do not hide it
        data = self._checked(frame.data)
        if data is None:
            return
        if self.window_ns and not self._immediate and self._is_late(now):
            self.late += 1
            return
        self.received += 1
        if self._timed_out or self._event_ns:
            self._alive(now)
        if self._immediate:
            self.happened.put(RpdoEvent(RpdoEventKind.APPLY, data, len(frame.data)))
        else:
            self._held = data

    def hold(self, data: bytes) -> bool:
        """Take data that do nothing but wait for the next SYNC; False: `receive` has to look at them."""
        usual = self._waits and self.running and len(data) == self.length
        if not usual or self.window_ns or self._timed_out or self.length_error is not None:
            return False
        self.received += 1
        self._held = data
        return True

    def sync(self, now: int) -> None:
        """Take a SYNC: held data count now."""
        self._sync_ns = now
        if self._held is not None:
            self.happened.put(RpdoEvent(RpdoEventKind.APPLY, self._held, len(self._held)))
            self._held = None

    def tick(self, now: int) -> None:
        """Tell that the deadline passed, once."""
        if self._deadline_ns is not None and now >= self._deadline_ns:
            self._deadline_ns, self._timed_out = None, True
            self.happened.put(RpdoEvent(RpdoEventKind.TIMEOUT))

    def next_deadline(self) -> int | None:
        """Return when the data are too old."""
        return self._deadline_ns

    def frames(self) -> list[CanFrame]:
        """Return nothing: a consumer does not send."""
        return []

    def events(self) -> list[RpdoEvent]:
        """Drain what happened, in order."""
        return self.happened.drain()

    def _adopt(self, parameters: PdoParameters) -> None:
        self._parameters, self._event_ns = parameters, parameters.event_ns
        self._immediate = is_event_driven(parameters.transmission_type)
        usable = parameters.enabled and (self._immediate or parameters.transmission_type <= LAST_CYCLIC)
        self._can_id = parameters.cob_id | (EXTENDED_FLAG if parameters.extended else 0) if usable else -1
        self._waits = usable and not self._immediate and not self._event_ns

    def _clear(self) -> None:
        self._held = self._deadline_ns = None
        self._timed_out = False
        self.length_error = None

    def _checked(self, data: bytes) -> bytes | None:
        self.length_error = None
        if len(data) < self.length:
            self.length_error = RpdoEventKind.TOO_SHORT
            self.short += 1
            self.happened.put(RpdoEvent(RpdoEventKind.TOO_SHORT, length=len(data)))
            return None
        if len(data) > self.length:
            self.length_error = RpdoEventKind.TOO_LONG
            self.long += 1
            self.happened.put(RpdoEvent(RpdoEventKind.TOO_LONG, length=len(data)))
        return data[: self.length]

    def _is_late(self, now: int) -> bool:
        return self._sync_ns is not None and now - self._sync_ns > self.window_ns

    def _alive(self, now: int) -> None:
        if self._timed_out:
            self._timed_out = False
            self.happened.put(RpdoEvent(RpdoEventKind.RESOLVED))
        if self._event_ns:
            self._deadline_ns = now + self._event_ns
