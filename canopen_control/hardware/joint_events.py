"""Events of a joint, and checks of its statusword, its fault and the RPDOs of other programs.

One table maps the events of the drive's state machine to a kind, a level and whether the group stops. A condition of
the statusword is reported when it begins, not while it lasts. An active limit forbids motion in the direction in which
the axis moved and leaves the other direction open; an axis that moves together with others stops with them at the
limit, and again when it is commanded beyond the limit. An axis that turns against its command is distinguished from one
that lags: target and speed are large and opposite in `WRONG_CHECKS` consecutive checks. If a drive has no error
code (0x603F), its EMCY message is the only report.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.cia402 import events, objects
from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import INTERNAL_LIMIT, WARNING
from canopen_control.master.event_log import Level
from canopen_control.rpc.messages.fault import FaultEvent
from canopen_control.urdf.joint_element import POSITION

if TYPE_CHECKING:
    from canopen_control.cia301.sdo_exchange import SdoRequest
    from canopen_control.cia402.events import DriveEvent
    from canopen_control.hardware.axis import AxisProcessData
    from canopen_control.hardware.mode_targets import ModeTarget
    from canopen_control.master.cycle import Output
    from canopen_control.master.remote_node import RemoteNode


WRONG_CHECKS: Final = 5  # checks, one every 0.1 s
SLOWING_FACTOR: Final = 0.95  # factor of a speed below which the axis is slowing down
_QUIET_CHECKS: Final = 10
_FOLLOWING: Final = 1 << 13
_BITS: Final = WARNING | INTERNAL_LIMIT | _FOLLOWING
_FOLLOWING_MODES = (OperationMode.PP, OperationMode.CSP)  # bit 13 has another meaning in HM and PV
_NEGATIVE_SWITCH, _POSITIVE_SWITCH = 1, 2  # CiA 402-2, 0x60FD: bits 0 and 1
_OTHER = "only motion in the other direction is permitted"
_BACK = "its group stops too, and only motion in the other direction is permitted"
_SIDES = {1: "positive", -1: "negative", 0: "unknown"}


class JointEvent(NamedTuple):
    """Event of a joint; `stops` is True if the event stops the stop group."""

    kind: str
    text: str
    level: Level = Level.WARNING
    stops: bool = False
    fault: FaultEvent | None = None


_TABLE: Final[dict[type, tuple[str, Level, bool]]] = {
    events.StateChanged: ("state", Level.INFO, False),
    events.FaultEntered: ("fault", Level.ERROR, True),
    events.FaultCleared: ("fault_cleared", Level.INFO, False),
    events.FaultResetFailed: ("fault_reset_failed", Level.ERROR, False),
    events.TransitionTimedOut: ("transition_timeout", Level.ERROR, False),
    events.ModeConfirmed: ("mode", Level.INFO, False),
    events.ModeTimedOut: ("mode_timeout", Level.ERROR, False),
    events.EnableLost: ("enable_lost", Level.ERROR, True),
    events.ControlChanged: ("control", Level.WARNING, False),
    events.StatuswordUndefined: ("statusword", Level.ERROR, False),
}


def joint_event_of(event: DriveEvent) -> JointEvent:
    """Convert an event of the drive's state machine to an event of the joint."""
    kind, level, stops = _TABLE[type(event)]
    if isinstance(event, events.TransitionTimedOut):
        stops = event.gave_up
    elif isinstance(event, events.ControlChanged):
        level = Level.INFO if event.remote else Level.ERROR
        stops = not event.remote
    fault = FaultEvent(statusword=event.statusword) if isinstance(event, events.FAULT_EVENTS) else None
    return JointEvent(kind, event.text, level, stops, fault)


class StatusWatch:
    """Checks of an axis' statusword and velocity; `action` on a following error is stop, warn or ignore."""

    def __init__(self, axis: AxisProcessData, action: str) -> None:
        self._axis, self._action = axis, action
        self._bits = 0
        self._against = self._against_from = 0
        self._last_target = 0
        self._limit_at = 0  # raw position at which the limit was reached
        self._out_of_range = math.nan  # target that was last reported as out of range
        self._quiet = 0  # countdown of checks; a target that is too fast is reported again only when it is 0
        self._targets: tuple[Output | None, Output | None] = (
            axis.output(objects.TARGET_VELOCITY),
            axis.output(objects.TARGET_POSITION),
        )

    def check(
        self, word: int, mode: int | None, target: ModeTarget | None, stops_at_limits: bool = False
    ) -> list[JointEvent]:
        """Return the events for warning, limit and following error bits that are newly set in a statusword."""
        rose, fell = word & ~self._bits & _BITS, self._bits & ~word & _BITS
        if not rose | fell:
            return []
        self._bits = word & _BITS
        events = []
        # CiA 402-2, 0x6041: bit 7 warning, bit 11 internal limit active, bit 13 following error in PP and CSP
        if rose & WARNING:
            events.append(JointEvent("warning", f"warning (statusword 0x{word:04X})"))
        if rose & INTERNAL_LIMIT:
            events += self._limit(target, stops_at_limits)
        if rose & _FOLLOWING and mode in _FOLLOWING_MODES and self._action != "ignore":
            text = f"following error (statusword 0x{word:04X})"
            stops = self._action == "stop"
            events.append(JointEvent("following_error", text, Level.ERROR if stops else Level.WARNING, stops))
        return events

    def limit_event(self) -> JointEvent:
        """Return the event for a command beyond an active limit."""
        side = _SIDES[self._axis.limits.blocked]
        return JointEvent("limit", f"commanded beyond its limit, {side} side; {_BACK}", Level.ERROR, stops=True)

    def leaves_limit(self) -> bool:
        """Whether the axis has left its limit, so that all motion is permitted again; call at 10 Hz."""
        limits = self._axis.limits
        if not limits.blocked or self._bits & INTERNAL_LIMIT:
            return False
        way = self._axis.raw_position - self._limit_at
        if way * limits.blocked >= 0:
            return False
        limits.blocked = 0
        return True

    def turns_the_wrong_way(self, enabled: bool) -> bool:
        """Return True once if the axis turns against its velocity target; call at 10 Hz."""
        output, actual = self._targets[0], self._axis.velocity
        if output is None or actual is None or not enabled or not actual.fresh:
            self._against = 0
            return False
        target, speed = output.value, actual.value
        steady, self._last_target = target == self._last_target, target
        against = steady and target * speed < 0 and abs(speed) * 2 > abs(target)
        self._against = self._against + 1 if against else 0
        if self._against == 1:
            self._against_from = abs(speed)
        elif self._against == WRONG_CHECKS and abs(speed) < SLOWING_FACTOR * self._against_from:
            self._against, self._against_from = 1, abs(speed)  # the axis decelerates before it reverses
        return self._against == WRONG_CHECKS

    def refuses(self, interface: str | None) -> str | None:
        """Return a text once if a target does not fit its object, and again after a valid target; call at 10 Hz."""
        target, reported = self._axis.out_of_range, self._out_of_range
        self._out_of_range = target
        if math.isnan(target) or not math.isnan(reported):
            return None
        return f"{interface} target {target:g} does not fit the drive's object, so the axis stands still"

    def held_back(self) -> str | None:
        """Return a text when the speed limit starts to reduce targets, else None; call at 10 Hz."""
        limits = self._axis.limits
        is_held, limits.held = limits.held, False
        was_reported, self._quiet = self._quiet > 0, _QUIET_CHECKS if is_held else max(0, self._quiet - 1)
        if not is_held or was_reported:
            return None
        if limits.most < limits.velocity:
            return f"the target of {self._axis.joint} exceeds {limits.words}, so it is reduced"
        return "its target exceeds the drive's maximum velocity (0x607F, 0x6080), so it is reduced"

    def _limit(self, target: ModeTarget | None, stops: bool) -> list[JointEvent]:
        limits, here, side = self._axis.limits, self._axis.raw_position, self._direction(target)
        opposite = side * limits.blocked < 0 and (here - self._limit_at) * limits.blocked < 0
        if limits.blocked and not opposite:
            return []  # the same limit became active again
        limits.blocked, self._limit_at = side, here
        text = f"limit reached, {_SIDES[limits.blocked]} side; {_BACK if stops else _OTHER}"
        return [JointEvent("limit", text, Level.ERROR if stops else Level.WARNING, stops)]

    def _direction(self, target: ModeTarget | None) -> int:
        """Return the direction of an active limit, from the limit switch (0x60FD) or the target; 0 if unknown."""
        inputs = self._axis.digital_inputs
        switches = inputs.value & 3 if inputs is not None and inputs.fresh else 0
        if switches in (_NEGATIVE_SWITCH, _POSITIVE_SWITCH):
            return 1 if switches == _POSITIVE_SWITCH else -1
        velocity, position = self._targets
        if target is not None and target.interface == POSITION and position is not None:
            way: int = position.value - self._axis.raw_position
        else:
            way = velocity.value if velocity is not None else 0
        return (way > 0) - (way < 0)


class ForeignRpdoWatch:
    """Check of RPDOs that another program sends to a node; a single frame is only overwritten by the next RPDO."""

    def __init__(self, node: RemoteNode) -> None:
        self.seen = 0
        """Value of `contradicted` of the node at the last check."""
        self._node = node
        self._last = -_REPEATED_NS

    def check(self, now: int, *, enabled: bool) -> list[JointEvent]:
        """Return an event that stops the group of an enabled axis if a further frame has arrived within a second."""
        count, self.seen = self._node.contradicted - self.seen, self._node.contradicted
        since, self._last = now - self._last, now
        if enabled and (count > 1 or since < _REPEATED_NS):
            return [JointEvent("contradicted", _CONTRADICTED_TEXT, Level.ERROR, stops=True)]
        return []


JUMP_TEXT: Final = (
    "its position (0x{:04X}) jumped by {} counts; home it again, or if its encoder is absolute start the robot again"
)
_REPEATED_NS: Final = 1_000_000_000
_CONTRADICTED_TEXT: Final = (
    "another program on the bus sends its RPDOs with other values, so that it follows two masters; end that program"
)


class FaultWatch:
    """Fault of one axis, first with its statusword, then with its error code (0x603F)."""

    def __init__(self, axis: AxisProcessData, events: list[JointEvent]) -> None:
        self.fault: FaultEvent | None = None
        """Last fault since the boot, which may have been reset; None if the drive had no fault."""
        self._axis, self._events = axis, events
        self.asking = False

    def enter(self, fault: FaultEvent) -> None:
        """Store a new fault, and read the error code if the drive has 0x603F."""
        self.fault = fault
        # CiA 402-2: 0x603F is optional; without it the EMCY has the error code (CiA 301, 7.2.7)
        if self._axis.has(objects.ERROR_CODE) and not self.asking:
            self.asking = True
            self._axis.node.read(self._axis.index(objects.ERROR_CODE), 0, self._answered)

    def _answered(self, request: SdoRequest) -> None:
        self.asking = False
        code = 0 if request.error is not None else int.from_bytes(request.data[:2], "little")
        if code:
            statusword = None if self.fault is None else self.fault.statusword
            self.fault = FaultEvent(error_code=code, statusword=statusword)
            text = f"0x603F is {self.fault.code_text}"
            self._events.append(JointEvent("error_code", text, Level.INFO, fault=self.fault))
