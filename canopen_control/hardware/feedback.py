"""State interfaces of a joint, updated from the process data of the axis.

A value changes only with a new frame, and is nan without a node. Positions are continuous: the 32-bit wrap-around is
removed, a restarted drive continues at its position, and a step that no motor can make is a jump, which is reported and
does not count as motion. A step is plausible if it is at most one revolution longer than the distance at three times
the present velocity, or at the drive's maximum velocity if the present one is unknown. `unexplained` is a smaller step
that is probably a change of the drive's coordinates, as after a new initialisation of its encoder: for an axis that has
been at standstill for half a second, a step for which its velocity is too low; for an axis in motion, a step for which
both its velocity and its velocity limit are too low. Smaller steps cannot be distinguished from a shock or an
acceleration.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.units import INT32_MAX, PositionUnwrapper
from canopen_control.hardware.interfaces import StateInterface
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from canopen_control.hardware.axis import AxisProcessData
    from canopen_control.master.cycle import Input
    from canopen_control.od.model import Value
    from canopen_control.urdf.ros2_control import ControlJoint


# Units of velocity in drives, recognised by a motion that differs much from the reported velocity.
#
# Positions are assumed to be right, since their counts do not depend on a unit of time. A velocity is doubted if the
# motion is at least three times as fast or as slow; the probable unit is the unit in the table that fits the motion.
# The units are those of CiA 402-2 and CiA 303-2 that are common in drives, each as its value at one motor revolution
# per second.


# Accepted ratios of motion to reported velocity: at constant velocity, and for a drive that accelerates.
_STEADY_MIN: Final = 0.7
_STEADY_MAX: Final = 1.3
_RISING_MIN: Final = 0.25
_RISING_MAX: Final = 1.5
_FAR: Final = 3.0  # ratio of measured to reported speed from which the unit of velocities is doubtful
_COUNTS: Final = "counts per second"
_UNITS: Final = {
    "rpm": 60.0,
    "0.1 rpm": 600.0,
    "deg/s": 360.0,
    "0.1 deg/s": 3600.0,
    "rev/s": 1.0,
    "0.001 rev/s": 1000.0,
}
_SI_UNITS: Final = {"rpm": 0x00B44700, "0.1 rpm": 0xFFB44700}
"""Values of 0x60A9 for the units that are read from the EDS."""


class FeedbackStatus(enum.Enum):
    """Status of an axis' feedback; each value is a description in words."""

    LOST = "the node is not operational"
    STALE = "the node is operational, but a TPDO with feedback is overdue"
    LIVE = "the node is operational, and feedback arrives"


@dataclass(frozen=True, slots=True)
class UnitMismatch:
    """Suspected wrong unit of a drive's velocity: text, and whether the motion is `faster` than reported."""

    text: str
    faster: bool


def unit_mismatch(axis: AxisProcessData, speed: float, raw: int, *, rising: bool) -> UnitMismatch | None:
    """Compare a motion in counts/s with the drive's velocity; None if consistent or if no unit explains the ratio.

    `rising` is True if the motion is between two samples of a drive that may still accelerate.
    """
    reported = raw * axis.scale.vel_from_dev * axis.scale.pos_to_dev
    if not speed or not reported or 1.0 / _FAR < abs(speed / reported) < _FAR:
        return None
    least = _RISING_MIN if rising else _STEADY_MIN
    most = _RISING_MAX if rising else _STEADY_MAX
    fits: dict[float, tuple[str, float]] = {}
    for name, per_turn in {**_UNITS, _COUNTS: axis.turn}.items():
        ratio = abs(speed / axis.turn * per_turn / raw)
        if least < ratio < most:
            fits[abs(math.log(ratio))] = name, per_turn
    if not fits:
        return None
    faster = abs(speed) > abs(reported)
    return UnitMismatch(_words(axis, [fits[fit] for fit in sorted(fits)], faster=faster), faster)


def _words(axis: AxisProcessData, units: list[tuple[str, float]], *, faster: bool) -> str:
    """Return the text of a mismatch with the probable `units`, best first, and the keys of bus.yml to set."""
    (first, per_turn), scale = units[0], axis.scale
    to_dev = math.copysign(per_turn * abs(scale.pos_to_dev) / axis.turn, scale.vel_to_dev)
    names = " or ".join(name for name, _ in units)
    in_eds = f"by 0x60A9 in its EDS (0x{_SI_UNITS[first]:08X}), or " if first in _SI_UNITS else ""
    of_first = f" for {first}" if len(units) > 1 else ""
    instead = "another unit" if first == _COUNTS else _COUNTS
    return (
        f"it turns much {'faster' if faster else 'slower'} than its velocity (0x606C) shows, as if its velocities "
        f"were in {names} instead of {instead}; set the unit {in_eds}by the four scales in bus.yml{of_first} "
        f"(scale_vel_to_dev: {to_dev:.7g}, scale_vel_from_dev: {1.0 / to_dev:.7g})"
    )


STANDSTILL: Final = 0.05  # rad/s (or m/s): a lower speed counts as standstill
_STEADY_NS: Final = 60_000_000  # an axis below `STANDSTILL` for this time is at standstill
_RESTS_NS: Final = 300_000_000  # an axis whose position stays within `REST_WAY` for this time too
_STILL_NS: Final = 100_000_000  # duration of a constant position that counts as standstill of a drive without velocity
_DERIVE_NS: Final = 1_000_000_000
_DERIVED_NS: Final = 19_000_000  # minimum time between two positions for a velocity, because counts are coarse
_MISMATCHES: Final = 3  # consecutive checks
_COARSE: Final = 2  # counts by which a position may change at standstill
_HIDDEN: Final = 4 * STANDSTILL  # rad/s (or m/s): a faster motion that 0x606C does not show is reported
_HIDDEN_TEXT: Final = (
    "its velocity (0x606C) shows standstill although its position (0x6064) changes; remove 0x606C from its TPDOs in "
    "bus.yml, so that the velocity is computed from positions"
)
MEASURED: Final = {
    POSITION: objects.POSITION_ACTUAL,
    VELOCITY: objects.VELOCITY_ACTUAL,
    EFFORT: objects.TORQUE_ACTUAL,
}
"""Object of axis 0 for each state interface."""
_EXTRAS: Final = ("nmt_state", "statusword", "error_code", "age", "digital_inputs")
_SLACK: Final = math.tau  # rad: motion between two samples that is possible without a reported velocity
_RESTED_NS: Final = 500_000_000  # duration of a standstill after which a step needs a velocity
REST_WAY: Final = 0.01  # rad (or m): a smaller step at standstill is noise
_RETURN_NS: Final = 50_000_000  # time in which a position that was wrong once returns
_SAME_SYNC_NS: Final = 10_000_000  # a velocity that is older than its position says nothing about the step
# Factors of the velocity limit and of the velocity that a motion does not exceed within the time of two samples. One of
# the samples may be up to a period late, and 0x606C may be filtered.
_LEAP_OF_LIMIT: Final = 1.2
_LEAP_OF_VELOCITY: Final = 2.0


def _rest_way(axis: AxisProcessData) -> int:
    """Return the counts by which a position may change at standstill, at least `_COARSE` for a coarse encoder."""
    return max(_COARSE, round(abs(axis.scale.pos_to_dev) * REST_WAY))


class Feedback:
    """State interfaces of one joint; `at_standstill` is True while the drive shows almost no motion.

    A velocity of 0 does not prove standstill while the position changes: drives without a sensor for the velocity, or
    with a coarse unit of velocity, show 0 in 0x606C during a motion; `hidden_motion` is the text that reports it once.
    """

    def __init__(self, description: ControlJoint, axis: AxisProcessData) -> None:
        self._axis = axis
        present = {POSITION: axis.position, VELOCITY: axis.velocity, EFFORT: axis.effort}
        names = [name for name, signal in present.items() if signal is not None]
        # some drives have no 0x606C, or no space for this object in a TPDO
        self._derives = axis.velocity is None and axis.position is not None and VELOCITY in description.state_interfaces
        if self._derives:
            names.append(VELOCITY)
        names += [name for name in description.state_interfaces if name in _EXTRAS]
        self.states = {name: StateInterface(description.name, name) for name in names}
        self.at_standstill = True
        self.hidden_motion: str | None = None
        self._moves_hidden = False  # by positions, at the last check
        self._shows_motion = False  # 0x606C has shown motion since the last check
        self._hidden_checks = 0
        self._extras = [name for name in names if name in _EXTRAS]
        self._position, self._velocity, self._effort = axis.position, axis.velocity, axis.effort
        self._position_count = self._velocity_count = self._effort_count = -1
        self._raw_position: int | None = None
        self._raw_velocity: int | None = None
        self._last_velocity: int | None = None  # raw velocity before its last change
        self._raw_effort: int | None = None
        self._more = self._effort is not None or bool(self._extras)
        present_pdos = [None if signal is None else signal.pdo for signal in (axis.position, axis.velocity)]
        self._position_pdo, self._velocity_pdo = (pdo or axis.statusword.pdo for pdo in present_pdos)
        self._rests = None not in present_pdos and not self._more  # unchanged values in both PDOs need no processing
        self._position_values: tuple[Value, ...] | None = None  # processed last
        self._velocity_values: tuple[Value, ...] | None = None
        self._position_state = self.states.get(POSITION, StateInterface(description.name, POSITION))
        self._velocity_state = self.states.get(VELOCITY, StateInterface(description.name, VELOCITY))
        self.unexplained = 0
        """Step in counts that no motion explains, at the last read; 0 for none."""
        self._slack = round(abs(axis.scale.pos_to_dev) * _SLACK) + 1
        self._rest_way = _rest_way(axis)
        self._rest_at = self._rested_since = 0  # position and beginning of a standstill
        self._stamp = self.moved_at = 0
        """Time of the last motion, as an oscillating axis is at standstill at each turning point."""
        self._jumps = self._discounted = self._discounted_at = 0  # the last step of `discount`, and its time
        self._jump_speed = 0.0  # counts/s that would explain the last jump
        self._sampled = self._sampled_before = self._sampled_first = 0  # stamps of the last three positions
        self._checked_at = self._checked_count = self._mismatches = 0
        self._derived_from, self._derived_at = 0, -_DERIVE_NS  # count and stamp

    def node_ready(self) -> None:
        """Continue at the last joint position after the node has returned, whatever its raw position is."""
        self._axis.unwrap.rebase()
        self._derived_at = -_DERIVE_NS
        self._position_values = self._velocity_values = None
        self._raw_position = self._raw_velocity = self._raw_effort = None

    def restart(self) -> None:
        """Restart at the drive's raw position after homing."""
        self._axis.unwrap = PositionUnwrapper(span=self._axis.unwrap.span)
        self._position_values = self._raw_position = None
        self._derived_at = -_DERIVE_NS
        self._jumps = 0

    def node_lost(self) -> None:
        self.at_standstill = True
        self._moves_hidden = self._shows_motion = False
        self._position_values = self._velocity_values = None
        for state in self.states.values():
            state.value = math.nan

    def read(self, now: int) -> int:
        """Update the state interfaces from new frames; return a position jump in counts, or 0."""
        self.unexplained = 0
        same = self._position_pdo.values is self._position_values
        if same and self._velocity_pdo.values is self._velocity_values and self._rests:
            self._sampled_first, self._sampled_before = self._sampled_before, self._sampled
            self._sampled = self._position_pdo.stamp
            return 0
        jump = 0
        velocity = self._velocity
        if velocity is not None:
            pdo = velocity.pdo
            if pdo.count != self._velocity_count and pdo.stamp >= 0:
                self._velocity_count = pdo.count
                self._velocity_values = values = pdo.values
                raw: int = values[velocity.position]  # type: ignore[assignment]  # mapped drive objects are integers
                if raw != self._raw_velocity:
                    self._last_velocity, self._raw_velocity = self._raw_velocity, raw
                    # + 0.0: a mirrored drive at standstill has no velocity of -0.0
                    self._velocity_state.value = speed = raw * self._axis.scale.vel_from_dev + 0.0
                    self._shows_motion = self._shows_motion or not -STANDSTILL <= speed <= STANDSTILL
                    self._set_standstill(-STANDSTILL <= speed <= STANDSTILL and not self._moves_hidden, now)
        position = self._position
        if position is not None:
            pdo = position.pdo
            if pdo.count != self._position_count and pdo.stamp >= 0:
                self._position_count = pdo.count
                self._position_values = values = pdo.values
                self._sampled_first, self._sampled_before = self._sampled_before, self._sampled
                self._sampled = pdo.stamp
                raw = values[position.position]  # type: ignore[assignment]  # as above
                if raw != self._raw_position:
                    jump = self._take_position(raw, pdo.stamp)
                if velocity is None:
                    self._without_velocity(pdo.stamp, now)
        if self._more:
            self._read_more(now)
        return jump

    def stands(self, now: int) -> bool:
        """Whether the axis is at standstill, for longer than an oscillating axis is at its turning point.

        A velocity that flickers at standstill does not count if the position shows no motion.
        """
        rests = self._position is not None and now - self._rested_since >= _RESTS_NS
        return self.at_standstill and (rests or now - self.moved_at >= _STEADY_NS)

    def _set_standstill(self, at_standstill: bool, now: int) -> None:
        if not (at_standstill and self.at_standstill):
            self.moved_at = now
        self.at_standstill = at_standstill

    def ramp_ns(self, default: int) -> int:
        """Return the time in ns to allow for the drive's ramp from the current velocity to 0, at most `default`."""
        slope = self._axis.limits.deceleration
        if self._raw_velocity is None or not math.isfinite(slope):
            return default
        return min(default, round((1.2 * abs(self._raw_velocity) / slope + 0.1) * 1e9))

    def refresh_scale(self) -> None:
        """Convert the latest values again after a scale change."""
        self._slack = round(abs(self._axis.scale.pos_to_dev) * _SLACK) + 1
        self._rest_way = _rest_way(self._axis)
        self._position_values = self._velocity_values = None
        self._raw_position = self._raw_velocity = self._raw_effort = None
        self._position_count = self._velocity_count = self._effort_count = -1

    def _take_position(self, raw: int, stamp: int) -> int:
        axis, last, slack = self._axis, self._raw_position, self._slack
        unwrap, scale = axis.unwrap, axis.scale
        # a step within a revolution is always plausible, so that the largest step need not be computed
        if last is None or not -slack <= raw - last <= slack:
            unwrap.max_step = self._largest_step(stamp - self._stamp)
        before, since = unwrap.count, self._stamp
        count = unwrap.update(raw)
        self._raw_position, self._stamp = raw, stamp
        if last is None or not -self._rest_way <= raw - self._rest_at <= self._rest_way:
            if last is not None and count != before:
                self._check(count - before - self._expected(stamp - since), stamp, since)
            self._rest_at, self._rested_since = raw, stamp
        self._position_state.value = count * scale.pos_from_dev + scale.offset_pos_from_dev
        if self._velocity is None:
            self.at_standstill, self.moved_at = False, stamp
        if unwrap.jumps == self._jumps:
            return 0
        self._jumps = unwrap.jumps
        self._jump_speed = unwrap.last_jump * 1e9 / max(stamp - self._sampled_before, 1)
        return unwrap.last_jump

    def _expected(self, elapsed_ns: int) -> int:
        """Return the counts by which the axis has moved in a time according to its velocity."""
        scale, raw = self._axis.scale, 0 if self.at_standstill else self._raw_velocity or 0
        return round(raw * scale.vel_from_dev * scale.pos_to_dev * elapsed_ns / 1e9)

    def _check(self, step: int, stamp: int, since: int) -> None:
        """Set `unexplained` to a step, apart from the motion that the velocity shows, that no motion explains."""
        if self._discounted and stamp - self._discounted_at < _RETURN_NS:
            # a single position was wrong: without this check, its small step back would count as a motion
            if abs(step + self._discounted) <= max(self._rest_way, abs(self._discounted) // 4):
                self.unexplained = step
        elif stamp - self._rested_since >= _RESTED_NS:
            self._check_step(step, stamp, since)
        elif not -self._rest_way <= step <= self._rest_way:
            self._check_leap(step, stamp)

    def _check_step(self, step: int, stamp: int, since: int) -> None:
        """Set `unexplained` to a step of an axis at standstill until `since`, unless its velocity may explain it."""
        velocity, least = self._velocity, float(self._rest_way)
        if velocity is None:
            pace = self._axis.limits.pace
            least = least + 1.5 * pace * (stamp - since) / 1e9 if pace < INT32_MAX else math.inf
        elif not self.at_standstill or stamp - velocity.pdo.stamp > _SAME_SYNC_NS:
            return
        if abs(step) > least:
            self.unexplained = step

    def _check_leap(self, step: int, stamp: int) -> None:
        """Set `unexplained` to a step of an axis in motion that neither its velocity nor its limit explains."""
        limits, velocity = self._axis.limits, self._velocity
        if limits.pace >= INT32_MAX:
            return
        speed = _LEAP_OF_LIMIT * limits.pace
        if velocity is not None:
            if stamp - velocity.pdo.stamp > _SAME_SYNC_NS or self._raw_velocity is None or self._last_velocity is None:
                return
            fastest = max(abs(self._raw_velocity), abs(self._last_velocity))
            scale = self._axis.scale
            speed = max(speed, _LEAP_OF_VELOCITY * fastest * abs(scale.vel_from_dev * scale.pos_to_dev))
        if abs(step) > self._rest_way + speed * (stamp - self._sampled_first) / 1e9:
            self.unexplained = step

    def discount(self, step: int) -> None:
        """Treat the last step as a change of the drive's coordinates instead of a motion."""
        axis = self._axis
        axis.unwrap.discount(step)
        self._discounted, self._discounted_at = step, self._stamp
        self._position_state.value = axis.unwrap.count * axis.scale.pos_from_dev + axis.scale.offset_pos_from_dev
        self._derived_at = -_DERIVE_NS

    def _without_velocity(self, stamp: int, now: int) -> None:
        """Detect standstill from positions, and compute the velocity if the description has that interface."""
        if self.moved_at != stamp:
            self.at_standstill = now - self.moved_at >= _STILL_NS
        if self._derives:
            self._derive(stamp)

    def _derive(self, stamp: int) -> None:
        """Compute the velocity from two positions at least `_DERIVED_NS` apart."""
        elapsed, count = stamp - self._derived_at, self._axis.unwrap.count
        if elapsed < _DERIVED_NS:
            return
        if elapsed < _DERIVE_NS:  # a longer interval means that the node was absent in between
            speed = (count - self._derived_from) * 1e9 / elapsed
            self._velocity_state.value = speed * self._axis.scale.pos_from_dev + 0.0
        self._derived_from, self._derived_at = count, stamp

    def unit_mismatch_of_jump(self, commanded: float = 0.0) -> UnitMismatch | None:
        """Return the wrong velocity unit that would explain the last jump, or None.

        `commanded` is the velocity sent to the drive in rad/s (nan: none); it is compared first, because the reported
        velocity may lag.
        """
        raw = round(commanded * self._axis.scale.vel_to_dev) if math.isfinite(commanded) else None
        return self._check_unit(self._jump_speed, raw, rising=True) or self._check_unit(
            self._jump_speed, self._raw_velocity, rising=True
        )

    def velocity_unit_mismatch(self, now: int) -> UnitMismatch | None:
        """Return a mismatch of the velocity unit once, when several checks in a row have found one; call at 10 Hz."""
        count = self._axis.unwrap.count
        moved, elapsed = count - self._checked_count, now - self._checked_at
        self._checked_count, self._checked_at = count, now
        steady = 0 < elapsed < _DERIVE_NS
        mismatch = self._check_unit(moved * 1e9 / elapsed, self._raw_velocity) if steady else None
        if self._velocity is not None and self._raw_velocity is not None:
            self._check_standstill(self._raw_velocity, abs(moved) if steady else 0, elapsed / 1e9)
        self._mismatches = 0 if mismatch is None else self._mismatches + 1
        return mismatch if self._mismatches == _MISMATCHES else None

    def _check_standstill(self, raw: int, moved: int, seconds: float) -> None:
        """Compare a velocity that shows standstill with the counts `moved` since the last check."""
        axis = self._axis
        shown = abs(raw * axis.scale.vel_from_dev) > STANDSTILL
        counts = abs(axis.scale.pos_to_dev) * seconds  # of 1 rad/s or m/s
        silent = not (shown or self._shows_motion)
        self._moves_hidden = silent and moved > STANDSTILL * counts + _COARSE
        self._shows_motion, self.at_standstill = shown, not (shown or self._moves_hidden)
        self._hidden_checks = self._hidden_checks + 1 if silent and moved > _HIDDEN * counts + _COARSE else 0
        self.hidden_motion = _HIDDEN_TEXT if self._hidden_checks == _MISMATCHES else None

    def _check_unit(self, speed: float, raw: int | None, *, rising: bool = False) -> UnitMismatch | None:
        """Compare a measured speed in counts/s with the drive's velocity; None if consistent."""
        if not raw or self._position is None or abs(raw * self._axis.scale.vel_from_dev) <= STANDSTILL:
            return None
        return unit_mismatch(self._axis, speed, raw, rising=rising)

    def _largest_step(self, elapsed_ns: int) -> int:
        """Return the largest plausible step in counts: one revolution plus the distance at three times the velocity."""
        axis = self._axis
        slack = self._slack
        if self._raw_velocity is not None:
            # velocity and position may have different units, so convert through SI
            speed = abs(axis.scale.velocity_from_device(self._raw_velocity) * axis.scale.pos_to_dev)
        elif axis.limits.velocity < INT32_MAX:
            speed = axis.limits.velocity * abs(axis.scale.vel_from_dev * axis.scale.pos_to_dev)
        else:
            return INT32_MAX
        return min(INT32_MAX, slack + round(3.0 * speed * max(elapsed_ns, 0) / 1e9))

    def _read_more(self, now: int) -> None:
        effort = self._effort
        if effort is not None and effort.pdo.count != self._effort_count and effort.pdo.stamp >= 0:
            self._effort_count = effort.pdo.count
            if (raw := effort.value) != self._raw_effort:
                self._raw_effort = raw
                self.states[EFFORT].value = self._axis.scale.effort_from_device(raw)
        for name in self._extras:
            self.states[name].value = self._extra(name, now)

    def _extra(self, name: str, now: int) -> float:
        axis = self._axis
        if name == "nmt_state":
            state = axis.node.nmt_state
            return math.nan if state is None else float(state)
        if name == "age":
            age = axis.statusword.age_ns(now)
            return math.nan if age is None else age / 1e9
        source: dict[str, Input | None] = {
            "statusword": axis.statusword,
            "digital_inputs": axis.digital_inputs,
            "error_code": axis.error_code,
        }
        signal = source[name]
        if signal is not None:
            return float(signal.value) if signal.fresh else math.nan
        fault = axis.node.fault
        return float(fault.error_code or 0) if name == "error_code" and fault is not None else math.nan
