"""A TPDO on the device's side: when it is sent (CiA 301, 7.2.2.1 to 4 and 7.5.2.37).

The law, by transmission type:
  0         at the next SYNC after `changed`
  1 to 240  at every nth SYNC; with a start value the SYNC whose counter equals it is number 1
  252       sampled at SYNC, sent on a remote frame
  253       sampled and sent on a remote frame
  254, 255  on `changed`, on the event timer, and once when process data starts; never closer than the inhibit time
The event timer runs from one transmission to the next. What changes within the inhibit time is sent once, with the
newest values, when it is over. The phase of types 1 to 240 is not portable: without a start value the nth SYNC is
the first one that sends here, others send at half of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.outbox import Outbox
from canopen_control.cia301.pdo import (
    ACYCLIC_SYNCHRONOUS,
    RTR_EVENT,
    RTR_SYNCHRONOUS,
    PdoParameters,
    is_cyclic,
    is_event_driven,
)
from canopen_control.frame import EXTENDED_FLAG, REMOTE_FLAG, CanFrame

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["TpdoProducer"]


class TpdoProducer:
    """One TPDO; `sample` returns the packed present values of its objects whenever it is asked.

    Nothing is sent before `start` (the node became OPERATIONAL) and after `stop`. `sent` counts transmissions,
    `unanswered` remote frames that found no sample or a type that does not answer.
    """

    def __init__(self, parameters: PdoParameters, sample: Callable[[], bytes]) -> None:
        self.sample = sample
        self.sent = 0
        self.unanswered = 0
        self.running = False
        self.outgoing: Outbox[CanFrame] = Outbox()
        self._pending = False
        self._sampled: bytes | None = None
        self._count = 0
        self._started = False  # whether the SYNC of the start value was seen
        self._inhibited_until: int | None = None
        self._event_at: int | None = None
        self._adopt(parameters)

    @property
    def parameters(self) -> PdoParameters:
        """The communication record."""
        return self._parameters

    def configure(self, parameters: PdoParameters, now: int) -> None:
        """Take a new communication record; a running PDO starts anew with it."""
        self._adopt(parameters)
        if not self._valid:
            self.outgoing.clear()
        if self.running:
            self.start(now)

    def start(self, now: int, *, shows: bool = True) -> None:
        """Begin: the node became OPERATIONAL, or the PDO valid. Event-driven ones show their first values.

        With `shows` False they do not, as those of a profile that is to be asked for events first.
        """
        self._clear()
        self.running = True
        if not self._valid or not is_event_driven(self._type):
            return
        if shows:
            self._send(now)
        elif self._event_ns:
            self._event_at = now + self._event_ns

    def stop(self) -> None:
        """End: the node left OPERATIONAL. No-op when stopped."""
        self._clear()
        self.running = False
        self.outgoing.clear()

    def changed(self, now: int) -> None:
        """Note that a mapped value changed (or a profile event happened); types that do not care ignore it."""
        if not self._active:
            return
        transmission_type = self._type
        if transmission_type == ACYCLIC_SYNCHRONOUS:
            self._pending = True
        elif is_event_driven(transmission_type):
            self._pending = True
            self.tick(now)

    def sync(self, now: int, counter: int | None = None) -> None:
        """Take a SYNC, with its counter if it has one."""
        if not (self.running and self._valid):
            return
        if self._cyclic:
            if self._is_turn(counter):
                self._send(now)
        elif self._type == ACYCLIC_SYNCHRONOUS:
            if self._pending:
                self._send(now)
        elif self._type == RTR_SYNCHRONOUS:
            self._sampled = self.sample()

    def receive(self, frame: CanFrame, now: int) -> None:
        """Answer a remote frame on the own COB-ID; other frames are ignored."""
        if frame.can_id != self._can_id | REMOTE_FLAG or not self._active:
            return
        transmission_type = self._type
        if transmission_type == RTR_EVENT and self._parameters.rtr_allowed:
            self._send(now)
        elif transmission_type == RTR_SYNCHRONOUS and self._parameters.rtr_allowed and self._sampled is not None:
            self._put(self._sampled)
        else:
            self.unanswered += 1

    def tick(self, now: int) -> None:
        """Send what the event timer or the end of the inhibit time makes due."""
        deadline = self.next_deadline()
        if deadline is not None and now >= deadline:
            self._send(now)

    def next_deadline(self) -> int | None:
        """Return when `tick` has something to do."""
        if not (self._driven_by_events and self.running and self._valid):
            return None
        if self._pending:
            return self._inhibited_until or 0
        if self._event_at is None:
            return None
        return max(self._event_at, self._inhibited_until or 0)

    def frames(self) -> list[CanFrame]:
        """Drain the frames to send."""
        return self.outgoing.drain()

    def events(self) -> list[object]:
        """Return nothing: nothing happens to a producer."""
        return []

    @property
    def _active(self) -> bool:
        return self.running and self._valid

    def _adopt(self, parameters: PdoParameters) -> None:
        self._parameters = parameters
        self._can_id = parameters.cob_id | (EXTENDED_FLAG if parameters.extended else 0)
        self._valid = parameters.enabled
        self._type, self._event_ns = parameters.transmission_type, parameters.event_ns
        self._inhibit_ns = parameters.inhibit_ns
        self._cyclic, self._driven_by_events = is_cyclic(self._type), is_event_driven(self._type)

    def _clear(self) -> None:
        self._pending = self._started = False
        self._sampled = self._inhibited_until = self._event_at = None
        self._count = 0

    def _is_turn(self, counter: int | None) -> bool:
        if not self._started:
            start = self._parameters.sync_start
            self._started = counter is None or not start or counter == start
            if not self._started:
                return False
        self._count += 1
        if self._count < self._type:
            return False
        self._count = 0
        return True

    def _send(self, now: int) -> None:
        self._pending = False
        self._inhibited_until = now + self._inhibit_ns if self._inhibit_ns else None
        self._event_at = now + self._event_ns if self._event_ns else None
        self._put(self.sample())

    def _put(self, data: bytes) -> None:
        self.sent += 1
        self.outgoing.put(CanFrame(self._can_id, data))
