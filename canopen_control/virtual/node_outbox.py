"""What all services of one node share: its clock, and the outbox for what they say, errors, events and frames.

An error goes to the EMCY producer and to the events. `changed` says that values changed which nobody wrote; the node
lets the event-driven PDOs look at them when the event under way is over.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.outbox import Outbox
from canopen_control.virtual.fault_seam import Seam
from canopen_control.virtual.node_events import EmergencyRaised
from canopen_control.virtual.sync_rhythm import SyncRhythm

if TYPE_CHECKING:
    from canopen_control.cia301.emcy import EmcyProducer
    from canopen_control.frame import CanFrame

__all__ = ["HEARTBEAT_ERROR", "Clock", "NodeOutbox"]

HEARTBEAT_ERROR = 0x8130  # EMCY: a communication is lost
_MOST_WAITING = 1000  # events, and frames of injected faults


class Clock:
    """The time the node was brought to, and that of the last SYNC (None: none came), in monotonic ns.

    `rhythm` is that of the SYNCs.
    Seam `drift_ppm`: how much faster than the master's it is.
    """

    __slots__ = ("drift_ppm", "now", "rhythm", "sync_ns")

    def __init__(self) -> None:
        self.now = 0
        self.sync_ns: int | None = None
        self.rhythm = SyncRhythm()
        self.drift_ppm: Seam[float] = Seam(0.0)


class NodeOutbox:
    """Collects what the services of one node say; bounded where nobody fetches it.

    `happened` are the events that wait, for whoever only asks whether there are any.
    """

    def __init__(self, emcy: EmcyProducer, clock: Clock) -> None:
        self._emcy, self._clock = emcy, clock
        self._events: Outbox[object] = Outbox(_MOST_WAITING)
        self.happened = self._events.waiting
        self.outgoing: Outbox[CanFrame] = Outbox(_MOST_WAITING)  # frames that no service made
        self.changed = False

    def values_changed(self) -> None:
        """Say that values changed which nobody wrote."""
        self.changed = True

    def tell(self, event: object) -> None:
        """Note an event for whoever shows them."""
        self._events.put(event)

    def send(self, frame: CanFrame) -> None:
        """Put a frame on the wire that no service made."""
        self.outgoing.put(frame)

    def events(self) -> list[object]:
        """Drain what happened, in order."""
        return self._events.drain()

    # -- errors

    def emergency(self, code: int, register: int, data: bytes = b"") -> None:
        """Raise an error that stays until it is cleared; one that is active already is not said again."""
        if self._emcy.raise_error(code, int(register), self._clock.now, data):
            self.tell(EmergencyRaised(code, data))
        self.changed = True

    def report(self, code: int, register: int, data: bytes = b"") -> None:
        """Say an error that does not stay; one that is active already is not said again."""
        if code not in self._emcy.active:
            self._emcy.report(code, self._clock.now, data, register=int(register))
            self.tell(EmergencyRaised(code, data))

    def clear_error(self, code: int) -> None:
        """Clear one error; no-op where it is not active."""
        if self._emcy.clear_error(code, self._clock.now):
            self.tell(EmergencyRaised(0))
            self.changed = True

    def clear_errors(self) -> None:
        """Clear every error but that of a communication still lost (transition 15)."""
        for code in self._emcy.active:
            if code != HEARTBEAT_ERROR:
                self.clear_error(code)
