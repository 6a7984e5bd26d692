"""Clock and outbox of one node: frames, events and errors of its services.

An error goes to the EMCY producer and to the events. `changed` means that values changed without being written; the
node lets the event-driven PDOs compare them at the end of the current event.
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
# `in_words` makes each the line of a log, in the standard's terms; a message without a reader has no words.


@dataclass(frozen=True, slots=True)
class DriveStateChanged:
    """The power state machine moved."""

    axis: int
    previous: State
    state: State


@dataclass(frozen=True, slots=True)
class DriveFaulted:
    """Fault with its EMCY `code`."""

    axis: int
    code: int


@dataclass(frozen=True, slots=True)
class ControlwordIgnored:
    """Controlword for a transition that the axis refuses, and the reason."""

    axis: int
    controlword: int
    why: str


@dataclass(frozen=True, slots=True)
class ModeChanged:
    """Change of the mode in 0x6061."""

    axis: int
    mode: int


@dataclass(frozen=True, slots=True)
class EmergencyRaised:
    """The node reports an error; 0: error reset."""

    code: int
    data: bytes = b""


@dataclass(frozen=True, slots=True)
class HeartbeatMissed:
    """Missing or returned heartbeat of a node in 0x1016 (0: of the guarding master)."""

    node_id: int
    missed: bool


@dataclass(frozen=True, slots=True)
class FaultSwitched:
    """Fault switched on or off."""

    name: str
    on: bool


@dataclass(frozen=True, slots=True)
class QuirkSwitched:
    """Quirk switched on or off; `text` includes strength and axis."""

    text: str
    on: bool


@dataclass(frozen=True, slots=True)
class NodeIdChanged:
    """Change of the node id by LSS."""

    node_id: int


@dataclass(frozen=True, slots=True)
class BitRateActivated:
    """Change of the bit rate by LSS, in bit/s; 0: automatic detection."""

    bitrate: int


@dataclass(frozen=True, slots=True)
class PdoLeftOff:
    """PDO marked valid in its record but disabled for an invalid COB-ID; `kind` is RPDO or TPDO."""

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
    NodeIdChanged: lambda event: f"LSS: node id {event.node_id}",
    PdoLeftOff: lambda event: (
        f"{event.kind} {event.number} stays off: its COB-ID 0x{event.cob_id:03X} is reserved, or has another user"
    ),
    BitRateActivated: lambda event: f"LSS: bit rate {event.bitrate or 'detected by itself'}",
    FaultSwitched: lambda event: f"fault {event.name} {'on' if event.on else 'off'}",
    QuirkSwitched: lambda event: f"quirk {event.text} {'on' if event.on else 'off'}",
}


def in_words(event: object) -> str | None:
    """Return the line of an event, None for one without text."""
    words = _WORDS.get(type(event))
    return None if words is None else words(event)


# The rhythm of SYNC as the phase lock (PLL) of a drive recovers it from SYNCs that come early and late.
#
# A filter of growing memory, up to `_MEMORY` SYNCs: the least-squares line through the times at which they came, the
# way a drive's own clock is pulled to SYNC. A SYNC off by almost half a period, or after a long silence, begins it
# again. SYNCs that come in time are taken as they are, to the nanosecond. Times are monotonic nanoseconds.


_MEMORY: Final = 256  # SYNCs: 2.6 s at 100 Hz
_LOCKED: Final = 3  # SYNCs until a period is known
_MOST_MISSED: Final = 8  # one after the other
_SAME: Final = 0.02  # by which two periods may differ
_FORGETS: Final = 1.0 / 256
_MARGIN: Final = 1.25  # the next one may be later than any before


class SyncPll:
    """SYNC timing: `late_ns` is the delay of the newest SYNC (negative: early), `period_ns` the recovered period.

    `slack_ns` is how late the next one may be, by those before: 0 where all came in time.
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
        """Maximum delay at which the next SYNC still belongs to its period."""
        return min(self._latest * _MARGIN, 0.5 * self.period_ns)

    def has_period(self, seconds: float) -> bool:
        """Whether the SYNC period equals the interpolation time period."""
        return self._count >= _LOCKED and abs(self.period_ns * 1e-9 - seconds) <= _SAME * seconds

    def receive_sync(self, now: int) -> None:
        """Process a received SYNC."""
        gap, period = now - self._edge, self.period_ns
        if not period and self._count and gap > 0:
            self._edge, self.period_ns, self._count = float(now), gap, 2
        elif not period:
            self._begin(now)
        else:
            steps = round(gap / period)
            error = gap - steps * period
            self._missed = self._missed + steps - 1 if steps > 1 else 0  # in a row: of another period by now
            if steps < 1 or self._missed > _MOST_MISSED or abs(error) >= 0.45 * period:
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


HEARTBEAT_ERROR = 0x8130  # EMCY: a communication is lost
_MOST_WAITING = 1000  # events, and frames of injected faults


class NodeClock:
    """Time of the node and of its last SYNC (None without one), in monotonic ns.

    `rhythm` is that of the SYNCs.
    Seam `drift_ppm`: how much faster than the master's it is.
    """

    __slots__ = ("drift_ppm", "now", "rhythm", "sync_ns")

    def __init__(self) -> None:
        self.now = 0
        self.sync_ns: int | None = None
        self.rhythm = SyncPll()
        self.drift_ppm: InjectionPoint[float] = InjectionPoint(0.0)


class NodeOutbox:
    """Collects frames and events of a node's services, bounded in size.

    `happened` are the waiting events, for a check without taking them.
    """

    def __init__(self, emcy: EmcyProducer, clock: NodeClock) -> None:
        self._emcy, self._clock = emcy, clock
        self._events: Outbox[object] = Outbox(_MOST_WAITING)
        self.happened = self._events.waiting
        self.outgoing: Outbox[CanFrame] = Outbox(_MOST_WAITING)  # frames that no service made
        self.changed = False

    def values_changed(self) -> None:
        """Report values that changed without a write."""
        self.changed = True

    def publish(self, event: object) -> None:
        """Record an event."""
        self._events.put(event)

    def send(self, frame: CanFrame) -> None:
        """Send a frame that belongs to no service."""
        self.outgoing.put(frame)

    def events(self) -> list[object]:
        """Return and clear the events, in order."""
        return self._events.drain()

    # -- errors

    def emergency(self, code: int, register: int, data: bytes = b"") -> None:
        """Raise an error until it is cleared; an active one is not reported again."""
        if self._emcy.raise_error(code, int(register), self._clock.now, data):
            self.publish(EmergencyRaised(code, data))
        self.changed = True

    def report(self, code: int, register: int, data: bytes = b"") -> None:
        """Report an error without duration; an active one is not reported again."""
        if code not in self._emcy.active:
            self._emcy.report(code, self._clock.now, data, register=int(register))
            self.publish(EmergencyRaised(code, data))

    def clear_error(self, code: int) -> None:
        """Clear one error; no-op if it is not active."""
        if self._emcy.clear_error(code, self._clock.now):
            self.publish(EmergencyRaised(0))
            self.changed = True

    def clear_errors(self) -> None:
        """Clear every error except that of a lost communication (transition 15)."""
        for code in self._emcy.active:
            if code != HEARTBEAT_ERROR:
                self.clear_error(code)
