"""Motion check of an enabled axis, ten times a second: detects standstill and motion away from the target.

Positions are compared in counts. A drive that is enabled but gets its set-points from another source, or whose brake
is still closed, does not move; a drive whose feedback is inverted moves away from its target. An axis at an active
limit (statusword bit 11), or a halted axis, is at standstill for a reason that is reported elsewhere. If the
set-points of a cyclic position mode continue while the axis has not moved since it was enabled, the axis is late: it
would jump to the set-points when its brake has released. The same applies to an axis that has moved and then does
not move for half a second while its set-points continue (STO without a change of state): it is stuck. An axis that
does not move for 1.5 s in another mode is reported. A wheel or steering axis then stops its base, which would leave
its path, once the axis is `_BASE_WAY` behind. An axis has to slow down at the target velocity 0 and in a controlled
stop.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.state import INTERNAL_LIMIT
from canopen_control.cia402.units import wrap_int32
from canopen_control.hardware.axis_statechart import AxisPhase
from canopen_control.hardware.feedback import STANDSTILL
from canopen_control.hardware.joint_events import SLOWING_FACTOR, WRONG_CHECKS, JointEvent
from canopen_control.hardware.mode_targets import VelocityTarget
from canopen_control.master.event_log import Level
from canopen_control.urdf.joint_element import EFFORT, POSITION

if TYPE_CHECKING:
    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.hardware.axis import AxisProcessData
    from canopen_control.hardware.axis_statechart import AxisStatechart
    from canopen_control.hardware.mode_targets import ModeTarget


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
        if not self._checks or abs(speed) < SLOWING_FACTOR * self._from:
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
        free = target is not None and target.interface == EFFORT  # a torque of 0 does not brake
        commanded = 0.0 if statechart.state in _AT_REST and not free else math.inf
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
