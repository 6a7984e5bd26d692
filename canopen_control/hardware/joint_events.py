"""Events of a joint; checks of its statusword, fault and motion; homing.

One table maps the events of the drive's state machine to a kind, a level and whether the group stops. A condition of
the statusword is reported when it begins, not while it lasts. An active limit forbids motion in the direction in which
the axis moved and leaves the other direction open; an axis that moves together with others stops with them at the
limit, and again when it is commanded beyond the limit. An axis that turns against its command is distinguished from one
that lags: target and speed are large and opposite in `WRONG_CHECKS` consecutive checks. If a drive has no error
code (0x603F), its EMCY message is the only report.
"""

from __future__ import annotations

import enum
import math
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.cia402 import events, objects
from canopen_control.cia402.homing import (
    METHODS_WITHOUT_MOTION,
    HomingDone,
    HomingPosition,
    HomingSequence,
    require_method,
)
from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import INTERNAL_LIMIT, WARNING
from canopen_control.cia402.units import wrap_int32
from canopen_control.errors import DriveError
from canopen_control.hardware.axis_statechart import AxisPhase
from canopen_control.hardware.feedback import STANDSTILL
from canopen_control.hardware.mode_targets import VelocityTarget
from canopen_control.master.event_log import Level
from canopen_control.rpc.messages.fault import FaultEvent
from canopen_control.urdf.joint_element import POSITION

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from canopen_control.cia301.sdo_exchange import SdoRequest
    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.cia402.events import DriveEvent
    from canopen_control.hardware.axis import AxisProcessData
    from canopen_control.hardware.axis_parameters import AxisParameters
    from canopen_control.hardware.axis_statechart import AxisStatechart
    from canopen_control.hardware.mode_targets import ModeTarget
    from canopen_control.master.cycle import Output
    from canopen_control.master.remote_node import RemoteNode


WRONG_CHECKS: Final = 5  # checks, one every 0.1 s
_LESS: Final = 0.95  # factor of a speed below which the axis is slowing down
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
        elif self._against == WRONG_CHECKS and abs(speed) < _LESS * self._against_from:
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


# Motion check of an enabled axis, ten times a second: detects standstill and motion away from the target.
#
# Positions are compared in counts. A drive that is enabled but gets its set-points from another source, or whose brake
# is still closed, does not move; a drive whose feedback is inverted moves away from its target. An axis at an active
# limit (statusword bit 11), or a halted axis, is at standstill for a reason that is reported elsewhere. If the
# set-points of a cyclic position mode continue while the axis has not moved since it was enabled, the axis is late: it
# would jump to the set-points when its brake has released. The same applies to an axis that has moved and then does
# not move for half a second while its set-points continue (STO without a change of state): it is stuck. An axis that
# does not move for 1.5 s in another mode is reported. A wheel or steering axis then stops its base, which would leave
# its path, once the axis is `_BASE_WAY` behind. An axis has to slow down at the target velocity 0 and in a controlled
# stop.


STANDING_CHECKS: Final = 15  # checks, one every 0.1 s
_LATE_CHECKS: Final = 2
_STUCK_CHECKS: Final = 5
_WAY: Final = 0.02  # rad or m: a smaller distance to the target commands no motion
_STEP: Final = STANDSTILL / 10  # rad or m in one check
_CHECK_S: Final = 0.1
_SURE_COUNTS: Final = 3.0  # a coarse encoder may not show a shorter distance
_BASE_WAY: Final = 0.3  # rad: a wheel that is less far behind, as with a motor that starts late, does not stop its base
_LATE_TEXT: Final = (
    "it is enabled but does not follow its set-points, and would jump to them; set `enable_settle_ms` "
    "in bus.yml, longer than its brake needs to release, or check its power and the source of its set-points"
)
_STUCK_TEXT: Final = (
    "it does not follow its set-points any more, and would jump to them; check its power (STO), its brake and whether "
    "something blocks it"
)
_STANDSTILL_TEXT: Final = (
    "it is enabled but does not follow its set-points; check its brake, its power and the source of its set-points "
    "(for a brake that releases late, set `enable_settle_ms` in bus.yml)"
)
_BASE_TEXT: Final = (
    "it has stood for 1.5 s although a motion is commanded, so the base would leave its path; check its power (STO), "
    "its brake, the source of its set-points and whether something blocks it (`following_error_action: warn` in "
    "bus.yml does not stop the base)"
)
_UNSEEN_WAY: Final = 0.2  # rad or m
_BLIND_TEXT: Final = (
    "its position (0x6064) stands although its velocity (0x606C) shows a motion, so its limits cannot end it; check "
    "its position sensor (`following_error_action: warn` in bus.yml does not stop the robot)"
)
_WRONG_WAY_TEXT: Final = "it turns against its command; check polarity (0x607E), the scale's sign and the wiring"


_SLOWING_CHECKS: Final = 20
_MOVING: Final = 5 * STANDSTILL  # rad/s or m/s
_AT_REST: Final = (AxisPhase.ENABLED, AxisPhase.READY, AxisPhase.HALTED)  # also a homing that has ended
_EXCESS: Final = 1.5  # ratio of the speed to the commanded speed from which an axis has to slow down
_RPDOS_OFF: Final = (
    "check whether the drive has switched off its RPDOs (bit 31 of 0x1400:01 or 0x1401:01, which a reset of the node "
    "clears)"
)
_RUNS_ON_TEXTS: Final = {
    True: f"it moves on although it has to stand; {_RPDOS_OFF}, its brake and its load",
    False: f"it moves faster than commanded and does not slow down; {_RPDOS_OFF}, the scale of its velocity (0x606C), "
    "its brake and its load",
}


class SlowingWatch:
    """Check of an axis that has to slow down, ten times a second."""

    def __init__(self) -> None:
        self._checks, self._from = 0, 0.0

    def fails(self, speed: float, *, required: bool) -> bool:
        """Return True once if a required decrease of the speed has not begun within two seconds."""
        if not required or not abs(speed) > _MOVING:  # also nan
            self._checks = 0
            return False
        if not self._checks or abs(speed) < _LESS * self._from:
            self._checks, self._from = 0, abs(speed)
        self._checks += 1
        return self._checks == _SLOWING_CHECKS

    def continue_from(self, other: SlowingWatch) -> None:
        """Fail at the next check, unless the axis is slower than at the failure of `other`."""
        self._checks, self._from = other._checks - 1, other._from


class MotionWatch:
    """Motion check of one axis: `lacks_motion`, `leaves_path`, `late`, `stuck` and `moves_away` are results of `check`.

    `blind` means that the position is constant while the velocity shows a motion; `unmoved` is True if the axis has not
    followed its set-points since it was enabled. `action` on `blind`, and on an axis of a base that stands, is stop,
    warn or ignore.
    """

    def __init__(self, axis: AxisProcessData, machine: DriveMachine, action: str = "stop") -> None:
        self._axis, self._machine, self._action = axis, machine, action
        self.lacks_motion = self.leaves_path = self.late = self.stuck = self.moves_away = self.blind = False
        self._standing = self._away = 0
        self._unseen, self._unseen_checks = 0.0, 0  # counts by 0x606C, and checks, since the position has changed
        self._owed = 0.0  # counts that a velocity has commanded during the standstill
        self._named = self._left = False  # the standstill, and that a base leaves its path, have been reported
        self._stood_at = 0  # target when the axis began to stand
        self._moved = False  # True if the axis has moved since it was enabled
        self._still: int | None = None  # position at the last check with motion
        self._rest: int | None = None  # position at which the current motion began
        self._last = 0
        self._received = -1  # number of TPDOs at the last check
        self._right = False  # the current motion was towards its target
        self._idle: ModeTarget | None = None  # target without motion at the last check, value `_idle_at`
        self._idle_at = 0
        self._stopping, self._following = SlowingWatch(), SlowingWatch()
        self._runs_on = self._at_zero = False

    def check_slowing(self, speed: float, target: ModeTarget | None, statechart: AxisStatechart, now: int) -> None:
        """Check whether an axis slows down to its target velocity, and in a stop, which is not waited for if not."""
        commanded = 0.0 if statechart.state in _AT_REST else math.inf
        if statechart.following and isinstance(target, VelocityTarget) and not self._machine.halted:
            if target.output.value == 0:
                commanded = 0.0
            elif not target.has_minimum:
                commanded = abs(target.output.value / target.factor())
        self._runs_on = self._following.fails(speed, required=abs(speed) > _EXCESS * commanded + _MOVING)
        self._at_zero = commanded == 0.0
        if self._runs_on:
            self._stopping.continue_from(self._following)  # the stop commands 0
        elif self._stopping.fails(speed, required=statechart.falling or statechart.state is AxisPhase.DISABLING):
            statechart.expire(now)

    def check(self, target: ModeTarget | None, enabled: bool) -> None:
        """Compare the motion since the last check with the target."""
        self.lacks_motion = self.leaves_path = self.late = self.stuck = self.moves_away = self.blind = False
        position = self._axis.position
        if not enabled or target is None or position is None or not position.fresh or self._machine.halted:
            self._standing = self._away = 0
            self._unseen, self._unseen_checks = 0.0, 0
            self._still = self._rest = None
            self._moved = self._moved and enabled
            self._idle = None
            return
        pdo = position.pdo
        if pdo.every > 1 and pdo.count == self._received:  # a position on every n-th SYNC: no news since the last check
            return
        self._received = pdo.count
        here = self._axis.raw_position + self._axis.unwrap.offset
        step, self._last = here - self._last, here
        if not step and target is self._idle and target.output.value == self._idle_at:
            return  # same as in the last check
        scale = abs(self._axis.scale.pos_to_dev)
        self._check_standstill(target, here, scale)
        self._check_sight(scale, moved=bool(step))
        if target.interface == POSITION and self._rest is not None:
            self._check_direction(self._distance(target), here, step, scale)
        else:
            self._away = 0
            self._rest = here
        at_standstill = not step and self._rest == self._still == here
        self._idle = target if at_standstill and not self._commands_motion(target, scale) else None
        self._idle_at = target.output.value

    def events(self, *, wrong_way: bool, in_base: bool) -> list[JointEvent]:
        """Return the events of the last check; `wrong_way` is the result of `StatusWatch.turns_the_wrong_way`."""
        events = []
        stops = self._action == "stop"
        level = Level.ERROR if stops else Level.WARNING
        if wrong_way or self.moves_away:
            events.append(JointEvent("direction", _WRONG_WAY_TEXT, stops=True))
        if self._runs_on:
            events.append(JointEvent("runs_on", _RUNS_ON_TEXTS[self._at_zero], level, stops=stops))
        if self.late or self.stuck:
            text = _LATE_TEXT if self.late else _STUCK_TEXT
            events.append(JointEvent("late", text, Level.ERROR, stops=True))
        if self.blind:
            events.append(JointEvent("position_stands", _BLIND_TEXT, level, stops=stops))
        if self.leaves_path and in_base and self._action == "stop":
            events.append(JointEvent("standing", _BASE_TEXT, Level.ERROR, stops=True))
        elif self.lacks_motion:
            events.append(JointEvent("standing", _STANDSTILL_TEXT))
        return events

    @property
    def unmoved(self) -> bool:
        """Whether the axis has not moved although its target commands motion: since it was enabled, or for long."""
        return self._standing > 0 and (not self._moved or self._standing >= _STUCK_CHECKS)

    def _distance(self, target: ModeTarget) -> int:
        """Return the distance to the target in counts, modulo 2**32."""
        raw: int = target.output.value
        return (raw - self._axis.raw_position + (1 << 31)) % (1 << 32) - (1 << 31)

    def _commands_motion(self, target: ModeTarget, scale: float) -> bool:
        """Whether the target commands a motion large enough to be measured."""
        if target.interface == POSITION:
            return abs(self._distance(target)) > _WAY * scale
        return isinstance(target, VelocityTarget) and abs(target.output.value / target.factor()) > STANDSTILL

    def _check_standstill(self, target: ModeTarget, here: int, scale: float) -> None:
        limited = self._axis.limits.blocked != 0 or bool((self._machine.statusword or 0) & INTERNAL_LIMIT)
        moved = self._still is None or abs(here - self._still) > max(1.0, _STEP * scale)
        if moved:
            self._moved = self._moved or self._still is not None
            self._still = here
        self._standing = 0 if moved or limited or not self._commands_motion(target, scale) else self._standing + 1
        if not self._standing:
            self._owed, self._named, self._left = 0.0, False, False
        elif isinstance(target, VelocityTarget):
            self._owed += abs(target.output.value / target.factor()) * scale * _CHECK_S
        else:
            self._owed = math.inf
        self.lacks_motion = self._standing >= STANDING_CHECKS and self._owed > _SURE_COUNTS and not self._named
        self._named = self._named or self.lacks_motion
        self.leaves_path = self._named and not self._left and self._owed > _BASE_WAY * scale
        self._left = self._left or self.leaves_path
        cyclic = target.tracks and target.interface == POSITION
        self.late = cyclic and not self._moved and self._standing == _LATE_CHECKS
        if self._standing <= 1:
            self._stood_at = target.output.value
        leads = abs(wrap_int32(target.output.value - self._stood_at)) > _WAY * scale
        self.stuck = cyclic and self._moved and self._standing >= _STUCK_CHECKS and leads

    def _check_sight(self, scale: float, *, moved: bool) -> None:
        """Add up the motion that 0x606C shows while the position is constant, so that joint limits could not end it."""
        velocity = self._axis.velocity
        speed = 0.0
        if velocity is not None and velocity.fresh and not moved:
            speed = abs(velocity.value * self._axis.scale.vel_from_dev)
        if speed <= STANDSTILL:
            self._unseen, self._unseen_checks = 0.0, 0
            return
        self._unseen += speed * scale * _CHECK_S
        # a velocity may lead its position by a cycle
        if self._unseen_checks < _STUCK_CHECKS:
            self._unseen_checks += 1
        elif self._unseen > max(_UNSEEN_WAY * scale, _SURE_COUNTS):
            self.blind = self._unseen_checks == _STUCK_CHECKS
            self._unseen_checks = _STUCK_CHECKS + 1

    def _check_direction(self, way: int, here: int, step: int, scale: float) -> None:
        """Count checks in which the axis moves away from its target without having moved towards it in this motion."""
        if abs(step) < _STEP * scale:
            self.moves_away = self._ended_away(way, here, scale)
            self._rest, self._right, self._away = here, False, 0
            return
        if way * step > 0:
            self._right = True
        wrong = not self._right and way * step < 0 and abs(way) > _WAY * scale
        self._away = self._away + 1 if wrong else 0
        self.moves_away = self._away == WRONG_CHECKS

    def _ended_away(self, way: int, here: int, scale: float) -> bool:
        """Whether a motion that ended too early for `WRONG_CHECKS` checks led away from its target."""
        if self._right or self._rest is None:
            return False
        moved = here - self._rest
        commanded = way + moved  # distance from the start of the motion
        least = _WAY * scale
        return commanded * moved < 0 and abs(commanded) > least and abs(moved) > max(least, abs(commanded) / 2)


# Homing of one axis, from the request to the return to the previous mode (CiA 402-2, mode HM).
#
# The method is checked against the drive's list before anything is written. Homing may enable the drive, because a user
# requested the motion; afterwards mode and power are restored. Bit 4 is 0 at every exit, and only a homing run whose
# success was observed makes the axis homed. The joint calls `step` in every cycle and applies the result.


_SETTLED: Final = 0.01  # rad or m: a position that changes less after homing has settled
_NEAR: Final = 0.1  # rad or m: distance in which a drive stops after it has found its home position


class HomingPhase(enum.Enum):
    """Phase of homing; each value is a description in words."""

    METHOD = "the method is being written, and the speeds are being limited"
    KNOWN = "method and speeds are set; the drive can be enabled in mode HM"
    ENABLE = "the drive is being enabled in mode HM"
    RUN = "homing"
    HOMED = "ended: the drive has found its zero"
    FAILED = "ended without success"


class JointHoming:
    """Homing in progress; `result` is None until the end, then "" or the reason for a failure.

    `mode_before` and `was_enabled` are restored afterwards. Raises DriveError for a method that is not in `methods`,
    the drive's list (None: no list). `bound` reduces the homing speeds to the velocity limit, and calls back with "" or
    the reason why that failed; then homing is refused.
    """

    def __init__(
        self,
        axis: AxisProcessData,
        machine: DriveMachine,
        method: int | None,
        methods: Collection[int] | None,
        bound: Callable[[Callable[[str], None]], None],
        *,
        was_enabled: bool,
        timeout_ns: int,
    ) -> None:
        if method is not None:
            require_method(method, methods)
        self.result: str | None = None
        self.phase = HomingPhase.METHOD
        self.mode_before, self.was_enabled = machine.mode, was_enabled
        self._machine = machine
        self._method, self._bound = method, bound
        self._ended_at: int | None = None
        self._axis = axis
        counts = abs(axis.scale.pos_to_dev)
        self._sequence = HomingSequence(
            timeout_ns=timeout_ns, tolerance=max(1, round(_SETTLED * counts)), near=max(1, round(_NEAR * counts))
        )
        index = axis.index(objects.HOMING_METHOD)
        if method is None:
            axis.node.read(index, 0, self._method_known)
        else:
            axis.node.write(index, 0, method.to_bytes(1, "little", signed=True), self._method_known)

    @property
    def over(self) -> bool:
        """Whether the homing has ended, successfully or not."""
        return self.homed or self.phase is HomingPhase.FAILED

    @property
    def homed(self) -> bool:
        return self.phase is HomingPhase.HOMED

    def ended_within(self, now: int, limit_ns: int) -> bool:
        """Whether at most `limit_ns` have passed since the first call after the end."""
        if self._ended_at is None:
            self._ended_at = now
        return now - self._ended_at < limit_ns

    def abort(self, reason: str) -> None:
        """End the homing as failed, unless it has already ended; bit 4 is 0 from the next cycle on."""
        if not self.over:
            self._fail(reason)

    def step(
        self, enable_requested: bool, may_home: bool, now: int, *, standing: bool, position: HomingPosition | None
    ) -> int:
        """Run one cycle of the homing; return the mode-specific bits of the controlword.

        `enable_requested` is True if the axis is enabled or being enabled, `may_home` if its statechart permits
        homing, `standing` if the axis is known to stand still; `position` is None if unknown.
        """
        machine = self._machine
        ready = may_home and machine.may_move and machine.mode == OperationMode.HM
        if self.phase is HomingPhase.ENABLE:
            if not enable_requested:
                self._fail("the drive was not enabled")
            elif ready:
                self.phase = HomingPhase.RUN
                self._sequence.start(self._method or 0)
        if self.phase is not HomingPhase.RUN:
            return 0
        bits = self._sequence.update(machine.statusword, ready, now, standing=standing, position=position)
        for event in self._sequence.events():
            if isinstance(event, HomingDone):
                self.phase, self.result = HomingPhase.HOMED, ""
            else:
                self._fail(event.text)
        return bits

    def _method_known(self, request: SdoRequest) -> None:
        if self.phase is not HomingPhase.METHOD:
            return
        if request.error is not None:
            self._fail(str(request.error))
            return
        if self._method is None:
            self._method = int.from_bytes(request.data[:1], "little", signed=True)
        if self._axis.has(objects.HOME_OFFSET):
            self._axis.node.read(self._axis.index(objects.HOME_OFFSET), 0, self._offset_known)
        else:
            self._bound_speeds()

    def _offset_known(self, request: SdoRequest) -> None:
        if self.phase is not HomingPhase.METHOD:
            return
        if request.error is None:
            self._sequence.home_offset = int.from_bytes(request.data[:4], "little", signed=True)
        self._bound_speeds()

    def _bound_speeds(self) -> None:
        # CiA 402-2, 0x6098: methods 35 and 37 use the present position, so the speeds have no effect
        if self._method in METHODS_WITHOUT_MOTION:
            self.phase = HomingPhase.KNOWN
        else:
            self._bound(self._speeds_bounded)

    def _speeds_bounded(self, why: str) -> None:
        if self.phase is not HomingPhase.METHOD:
            return
        if why:
            self._fail(why)
        else:
            self.phase = HomingPhase.KNOWN

    def _fail(self, reason: str) -> None:
        self.phase, self.result = HomingPhase.FAILED, reason


class HomePosition:
    """Home position of an axis: the homing in progress, and the result of the last homing."""

    def __init__(self, axis: AxisProcessData, machine: DriveMachine, parameters: AxisParameters) -> None:
        self.homing: JointHoming | None = None
        self._last: JointHoming | None = None
        self._axis, self._machine, self._parameters = axis, machine, parameters

    @property
    def known(self) -> bool:
        """Whether the last homing was successful and the home position is still valid."""
        return self._last is not None and self._last.homed

    @property
    def result(self) -> str | None:
        """Result of the last homing: "" on success, else the reason for the failure; None if no homing has ended."""
        return None if self._last is None else self._last.result

    def begin(self, method: int | None, *, was_enabled: bool) -> None:
        """Start homing; raise DriveError if homing is in progress already, or if the drive does not list the method."""
        node = self._axis.node
        if self.homing is not None:
            raise DriveError(f"{node.label}: homing is already in progress; wait for its end")
        timeout = round(node.config.motion.homing_timeout_seconds * 1e9)
        methods = self._parameters.homing_methods
        bound = self._parameters.bound_homing
        self.homing = JointHoming(
            self._axis, self._machine, method, methods, bound, was_enabled=was_enabled, timeout_ns=timeout
        )
        self._last = None

    def end(self, run: JointHoming) -> None:
        """Record the result of a completed homing."""
        self.homing, self._last = None, run

    def forget(self) -> None:
        """Discard a successful homing when the home position is lost; keep the result of a failed homing."""
        if self.known:
            self._last = None
