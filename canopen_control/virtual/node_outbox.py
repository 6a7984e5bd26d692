"""Clock, SYNC timing and outbox of one node: frames, events and errors of its services.

An error is passed to the EMCY producer and added to the events. `changed` means that values changed without a write;
the node then compares the values of event-driven TPDOs at the end of the current event.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.emcy import code_text
from canopen_control.cia301.nmt import NmtStateChanged
from canopen_control.cia301.outbox import Outbox
from canopen_control.cia402.modes import mode_name
from canopen_control.cia402.state import State  # noqa: TC001 - compiled, a dataclass reads the types of its fields
from canopen_control.virtual.injection_point import InjectionPoint

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.cia301.emcy import EmcyProducer
    from canopen_control.frame import CanFrame


# Events of a virtual node in `VirtualNode.events`, next to `NmtStateChanged`.
#
# `in_words` turns an event into a line of the log, in the terms of the standard.


@dataclass(frozen=True, slots=True)
class DriveStateChanged:
    """Event: the power state machine of an axis has changed its state."""

    axis: int
    previous: State
    state: State


@dataclass(frozen=True, slots=True)
class DriveFaulted:
    """Event: an axis has a fault with the EMCY `code`."""

    axis: int
    code: int


@dataclass(frozen=True, slots=True)
class ControlwordIgnored:
    """Event: a controlword had no effect; `why` is the reason."""

    axis: int
    controlword: int
    why: str


@dataclass(frozen=True, slots=True)
class ModeChanged:
    """Event: the mode of operation (0x6061) of an axis has changed."""

    axis: int
    mode: int


@dataclass(frozen=True, slots=True)
class EmergencyRaised:
    """Event: the node has sent an EMCY with `code`; 0 is an error reset."""

    code: int
    data: bytes = b""


@dataclass(frozen=True, slots=True)
class HeartbeatMissed:
    """Event: the heartbeat of a node in 0x1016 is lost or has returned (node 0: node guarding by the master)."""

    node_id: int
    missed: bool


@dataclass(frozen=True, slots=True)
class FaultSwitched:
    """Event: a fault was switched on or off."""

    name: str
    on: bool


@dataclass(frozen=True, slots=True)
class QuirkSwitched:
    """Event: a quirk was switched on or off; `text` includes strength and axis."""

    text: str
    on: bool


@dataclass(frozen=True, slots=True)
class NodeIdChanged:
    """Event: LSS has changed the node-ID."""

    node_id: int


@dataclass(frozen=True, slots=True)
class BitRateActivated:
    """Event: LSS has changed the bit rate, in bit/s; 0 is automatic detection."""

    bitrate: int


@dataclass(frozen=True, slots=True)
class PdoLeftOff:
    """Event: a PDO is valid in its record but disabled, because its COB-ID is reserved or in use."""

    kind: str
    number: int
    cob_id: int


def _axis(axis: int) -> str:
    return f"axis {axis}: " if axis else ""


def _emergency(event: EmergencyRaised) -> str:
    if event.code == 0:
        return "error reset"
    extra = f", data {event.data.hex(' ')}" if any(event.data) else ""
    return f"EMCY {code_text(event.code)}{extra}"


def _missed(event: HeartbeatMissed) -> str:
    sender = f"heartbeat of node {event.node_id}" if event.node_id else "guarding"
    return f"{sender} {'lost' if event.missed else 'is back'}"


_WORDS: dict[type, Callable[..., str]] = {
    NmtStateChanged: lambda event: f"NMT {event.state.name}",
    DriveStateChanged: lambda event: f"{_axis(event.axis)}{event.previous.name} -> {event.state.name}",
    DriveFaulted: lambda event: f"{_axis(event.axis)}fault {code_text(event.code)}",
    ControlwordIgnored: lambda event: f"{_axis(event.axis)}controlword 0x{event.controlword:04X} ignored: {event.why}",
    ModeChanged: lambda event: f"{_axis(event.axis)}mode {mode_name(event.mode)}",
    EmergencyRaised: _emergency,
    HeartbeatMissed: _missed,
    NodeIdChanged: lambda event: f"LSS: node-ID {event.node_id}",
    PdoLeftOff: lambda event: (
        f"{event.kind} {event.number} is disabled: COB-ID 0x{event.cob_id:03X} is reserved or in use"
    ),
    BitRateActivated: lambda event: f"LSS: bit rate {event.bitrate or 'automatic'}",
    FaultSwitched: lambda event: f"fault {event.name} {'on' if event.on else 'off'}",
    QuirkSwitched: lambda event: f"quirk {event.text} {'on' if event.on else 'off'}",
}


def in_words(event: object) -> str | None:
    """Return an event as a line of the log, or None for an event without text."""
    words = _WORDS.get(type(event))
    return None if words is None else words(event)


# Recovery of the SYNC period from early and late SYNCs, as by the phase lock (PLL) of a drive.
#
# A filter with growing memory, up to `_MEMORY` SYNCs, fits a least-squares line to the times of the SYNCs, like a drive
# whose clock is locked to SYNC. A SYNC that is off by almost half a period, or comes after a long pause, restarts the
# filter. Times are monotonic nanoseconds.


_MEMORY: Final = 256  # SYNCs: 2.6 s at 100 Hz
_LOCKED: Final = 3  # SYNCs until a period is known
_MAX_MISSED: Final = 8  # consecutive SYNCs
_SAME: Final = 0.02  # tolerance of equal periods
_FORGETS: Final = 1.0 / 256
_MARGIN: Final = 1.25  # the next SYNC may be later than all earlier SYNCs


class SyncPll:
    """Phase lock (PLL) that recovers the SYNC period.

    `late_ns` is the delay of the newest SYNC (negative if early), `period_ns` the recovered period.
    """

    __slots__ = ("_count", "_edge", "_latest", "_missed", "late_ns", "period_ns")

    def __init__(self) -> None:
        self._begin(0)
        self._count = 0

    def _begin(self, now: int) -> None:
        self._count, self._edge, self._missed = 1, float(now), 0
        self.period_ns = self.late_ns = self._latest = 0.0

    @property
    def slack_ns(self) -> float:
        """Expected maximum delay of the next SYNC in ns, from earlier delays; 0 if no SYNC was late."""
        return min(self._latest * _MARGIN, 0.5 * self.period_ns)

    def has_period(self, seconds: float) -> bool:
        """Whether the recovered period equals `seconds` within 2 %."""
        return self._count >= _LOCKED and abs(self.period_ns * 1e-9 - seconds) <= _SAME * seconds

    def receive_sync(self, now: int) -> None:
        gap, period = now - self._edge, self.period_ns
        if not period and self._count and gap > 0:
            self._edge, self.period_ns, self._count = float(now), gap, 2
        elif not period:
            self._begin(now)
        else:
            steps = round(gap / period)
            error = gap - steps * period
            self._missed = self._missed + steps - 1 if steps > 1 else 0  # consecutive: many mean another period
            if steps < 1 or self._missed > _MAX_MISSED or abs(error) >= 0.45 * period:
                self._begin(now)
            else:
                self._follow(steps, error, now)

    def _follow(self, steps: int, error: float, now: int) -> None:
        count = self._count
        if count < _MEMORY:
            self._count = count = count + 1
        both = count * (count + 1)
        self._edge = edge = self._edge + (steps * self.period_ns + error * 2 * (2 * count - 1) / both)
        self.period_ns += error * 6 / both / steps
        self.late_ns = late = now - edge
        latest = self._latest * (1.0 - _FORGETS)
        self._latest = latest if latest > late else late


HEARTBEAT_ERROR = 0x8130  # EMCY: lost communication
_MAX_WAITING = 1000  # events, and frames of injected faults


class NodeClock:
    """Time of the node and of the last SYNC (None before the first SYNC), in monotonic ns.

    `rhythm` recovers the period of SYNC. The injection point `drift_ppm` is how much faster this clock runs than the
    master's clock, in ppm.
    """

    __slots__ = ("drift_ppm", "now", "rhythm", "sync_ns")

    def __init__(self) -> None:
        self.now = 0
        self.sync_ns: int | None = None
        self.rhythm = SyncPll()
        self.drift_ppm: InjectionPoint[float] = InjectionPoint(0.0)


class NodeOutbox:
    """Frames and events of a node that wait to be sent or read; their number is limited.

    `new_events` are the waiting events, for a check that does not remove them.
    """

    def __init__(self, emcy: EmcyProducer, clock: NodeClock) -> None:
        self._emcy, self._clock = emcy, clock
        self._events: Outbox[object] = Outbox(_MAX_WAITING)
        self.new_events = self._events.waiting
        self.outgoing: Outbox[CanFrame] = Outbox(_MAX_WAITING)  # frames not created by a service
        self.changed = False

    def values_changed(self) -> None:
        """Request a check of the event-driven TPDOs after values have changed without a write."""
        self.changed = True

    def publish(self, event: object) -> None:
        self._events.put(event)

    def send(self, frame: CanFrame) -> None:
        """Append a frame that does not come from a service, such as a frame of an injected fault."""
        self.outgoing.put(frame)

    def events(self) -> list[object]:
        """Return and clear the events, in order."""
        return self._events.drain()

    # -- errors

    def emergency(self, code: int, register: int, data: bytes = b"") -> None:
        """Raise an error that lasts until `clear_error`; an active error is not reported again."""
        if self._emcy.raise_error(code, int(register), self._clock.now, data):
            self.publish(EmergencyRaised(code, data))
        self.changed = True

    def report(self, code: int, register: int, data: bytes = b"") -> None:
        """Report an error that has no duration; do nothing while the same error is active."""
        if code not in self._emcy.active:
            self._emcy.report(code, self._clock.now, data, register=int(register))
            self.publish(EmergencyRaised(code, data))

    def clear_error(self, code: int) -> None:
        """Clear an error; no effect if it is not active."""
        if self._emcy.clear_error(code, self._clock.now):
            self.publish(EmergencyRaised(0))
            self.changed = True

    def clear_errors(self) -> None:
        """Clear every error except lost communication (0x8130), like transition 15."""
        for code in self._emcy.active:
            if code != HEARTBEAT_ERROR:
                self.clear_error(code)
