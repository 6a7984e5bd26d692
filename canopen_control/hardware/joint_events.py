"""Events of a joint: emergencies, warning and limit bits of the statusword, wrong direction, fault codes.

One table from the kind of a drive's event to its name, its level and whether it stops. What is
seen in the statusword is told when it begins, not while it lasts. An active limit closes the direction in which the
axis went and leaves the other open; an axis that moves with others stops with them at it, and again when it is
commanded beyond it. An axis that turns against its command is told from one that lags by both being large for
`WRONG_LOOKS` looks on end. A drive that has no error code (0x603F) has said what it has to say by EMCY.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.cia301.emcy import error_text
from canopen_control.cia402 import events, objects
from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import INTERNAL_LIMIT, WARNING
from canopen_control.master.event_log import Level
from canopen_control.urdf.joint_element import POSITION

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.cia301.sdo_exchange import SdoRequest
    from canopen_control.cia402.events import DriveEvent
    from canopen_control.hardware.axis import AxisProcessData
    from canopen_control.hardware.joint_targets import ModeTarget
    from canopen_control.master.cycle import Output


WRONG_LOOKS: Final = 5  # of a tenth of a second each
_LESS: Final = 0.95  # of a speed: the axis is slowing down
_QUIET_LOOKS: Final = 10
_FOLLOWING: Final = 1 << 13
_BITS: Final = WARNING | INTERNAL_LIMIT | _FOLLOWING
_FOLLOWING_MODES = (OperationMode.PP, OperationMode.CSP)
_NEGATIVE_SWITCH, _POSITIVE_SWITCH = 1, 2  # 0x60FD
_OTHER = "only the other direction is followed"
_BACK = "those that move with it stop too, and only the way back is followed"
_SIDES = {1: "positive", -1: "negative", 0: "unknown"}


class JointEvent(NamedTuple):
    """Event of one joint; `stops` means that its group has to stop."""

    kind: str
    text: str
    level: Level = Level.WARNING
    stops: bool = False


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
    """Return the joint's event for an event of the drive's state machine."""
    kind, level, stops = _TABLE[type(event)]
    if isinstance(event, events.TransitionTimedOut):
        stops = event.gave_up
    elif isinstance(event, events.ControlChanged):
        level = Level.INFO if event.remote else Level.ERROR
        stops = not event.remote
    return JointEvent(kind, event.text, level, stops)


class StatusWatch:
    """Monitor of one axis; `action` is the reaction to a following error: stop, warn or ignore."""

    def __init__(self, axis: AxisProcessData, action: str) -> None:
        self._axis, self._action = axis, action
        self._bits = 0
        self._against = self._against_from = 0
        self._last_target = 0
        self._limit_at = 0  # the position at which the limit was reached
        self._out_of_range = math.nan  # the target that was told not to fit its object
        self._quiet = 0  # so many looks without a target that is too fast, and the next one is told again
        self._targets: tuple[Output | None, Output | None] = (
            axis.output(objects.TARGET_VELOCITY),
            axis.output(objects.TARGET_POSITION),
        )

    def look(
        self, word: int, mode: int | None, target: ModeTarget | None, stops_at_limits: bool = False
    ) -> list[JointEvent]:
        """Process a statusword and return the events that begin or end."""
        rose, fell = word & ~self._bits & _BITS, self._bits & ~word & _BITS
        if not rose | fell:
            return []
        self._bits = word & _BITS
        found = []
        if rose & WARNING:
            found.append(JointEvent("warning", f"warning (statusword 0x{word:04X})"))
        if rose & INTERNAL_LIMIT:
            found += self._limit(target, stops_at_limits)
        if rose & _FOLLOWING and mode in _FOLLOWING_MODES and self._action != "ignore":
            text = f"following error (statusword 0x{word:04X})"
            stops = self._action == "stop"
            found.append(JointEvent("following_error", text, Level.ERROR if stops else Level.WARNING, stops))
        return found

    def limit_event(self) -> JointEvent:
        """Return the event of a command beyond the limit of an axis in a coordinated motion."""
        side = _SIDES[self._axis.limits.blocked]
        return JointEvent("limit", f"commanded beyond its limit, {side} side; {_BACK}", Level.ERROR, stops=True)

    def leaves_limit(self) -> bool:
        """Return whether an inactive limit was left by a motion in the other direction; called ten times a second."""
        limits = self._axis.limits
        if not limits.blocked or self._bits & INTERNAL_LIMIT:
            return False
        way = self._axis.raw_position - self._limit_at
        if way * limits.blocked >= 0:
            return False
        limits.blocked = 0
        return True

    def turns_the_wrong_way(self, enabled: bool) -> bool:
        """Return whether the axis turns against its velocity target; called ten times a second."""
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
        elif self._against == WRONG_LOOKS and abs(speed) < _LESS * self._against_from:
            self._against, self._against_from = 1, abs(speed)  # it slows down before it turns: its ramp is slow
        return self._against == WRONG_LOOKS

    def refuses(self, interface: str | None) -> str | None:
        """Return the text that a controller's target does not fit its object, once until one fits.

        Called ten times a second.
        """
        target, reported = self._axis.out_of_range, self._out_of_range
        self._out_of_range = target
        if math.isnan(target) or not math.isnan(reported):
            return None
        return f"{interface} target {target:g} does not fit the drive's object; it stands"

    def held_back(self) -> str | None:
        """Return the text that targets are limited, when that begins; called ten times a second."""
        limits = self._axis.limits
        is_held, limits.held = limits.held, False
        was_reported, self._quiet = self._quiet > 0, _QUIET_LOOKS if is_held else max(0, self._quiet - 1)
        if not is_held or was_reported:
            return None
        if limits.most < limits.velocity:
            return f"the target of {self._axis.joint} is faster than {limits.words}: slowed down"
        return "its target is faster than the drive's largest velocity (0x607F, 0x6080): slowed down to that"

    def _limit(self, target: ModeTarget | None, stops: bool) -> list[JointEvent]:
        limits = self._axis.limits
        if limits.blocked:
            return []  # the same limit, touched again
        limits.blocked = self._direction(target)
        self._limit_at = self._axis.raw_position
        text = f"limit reached, {_SIDES[limits.blocked]} side; {_BACK if stops else _OTHER}"
        return [JointEvent("limit", text, Level.ERROR if stops else Level.WARNING, stops)]

    def _direction(self, target: ModeTarget | None) -> int:
        """Return the side of the limit: the active switch, else the direction of the target."""
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


class FaultReason:
    """Error code of the last fault; `report` is called with a sentence once it is read."""

    def __init__(self, axis: AxisProcessData, report: Callable[[str], None]) -> None:
        self.code: int | None = None
        self.asking = False
        self._axis, self._report = axis, report

    def ask(self) -> None:
        """Read the error code, if the drive has one."""
        if self._axis.has(objects.ERROR_CODE) and not self.asking:
            self.asking = True
            self._axis.node.read(self._axis.index(objects.ERROR_CODE), 0, self._answered)

    @property
    def text(self) -> str:
        """Text of the error code, "" while it is unknown."""
        return "" if not self.code else f"0x603F is 0x{self.code:04X} ({error_text(self.code)})"

    def _answered(self, request: SdoRequest) -> None:
        self.asking = False
        if request.error is None:
            self.code = int.from_bytes(request.data[:2], "little")
            if self.text:
                self._report(self.text)
