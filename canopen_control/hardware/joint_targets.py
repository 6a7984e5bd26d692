"""Targets of a joint: from a command interface to the target object of the drive's mode.

`JointTargets` has the interface that a controller claimed and the mode for this interface (`choose_mode`). The target
of a mode (CiA 402-2) is a `ModeTarget`: `hold` commands standstill at the present position, for every cycle in which
nothing may move; `follow` sends a target in SI units, nan for none; `ramp_down` is one cycle of a controlled stop and
returns whether the target is at standstill. An unchanged target costs only a comparison.

Only one motion interface is commanded at a time, except for those that feed a position forward (`feed_forward`). Before
an enabled drive changes its mode, all targets are at standstill for one cycle, because the new mode uses its target at
once; targets of other modes are held at the actual position, without velocity and effort. CSP, IP and CSV have no ramp
in the drive, so the master computes their stop ramps; PP and PV leave the ramp to the drive. A target that is more than
half the range of the counter away, or does not fit its object, is not sent: the axis stops, and `out_of_range` of the
axis is this target.
"""

from __future__ import annotations

import math
from abc import ABCMeta, abstractmethod
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.modes import OperationMode, mode_name, mode_words, require_mode
from canopen_control.cia402.setpoint import SetPointHandshake
from canopen_control.cia402.units import INT16_MAX, INT16_MIN, INT32_MAX, INT32_MIN, to_object, wrap_int32
from canopen_control.errors import ControlError, DriveError
from canopen_control.hardware.axis import HELD
from canopen_control.hardware.axis_parameters import choose_mode, listed_modes, require_mapped, require_targets
from canopen_control.hardware.interfaces import DIGITAL_OUTPUTS, TARGET, CommandInterface
from canopen_control.hardware.tracking import FeedForward, Tracking, TrapezoidalProfile
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.cia402.setpoint import SetPointEvent
    from canopen_control.hardware.axis import AxisProcessData
    from canopen_control.hardware.axis_parameters import AxisParameters
    from canopen_control.master.cycle import Output
    from canopen_control.urdf.ros2_control import ControlJoint


UINT32_MAX: Final = (1 << 32) - 1
_NAN: Final = math.nan
_PROFILE: Final = (objects.PROFILE_VELOCITY, objects.PROFILE_ACCELERATION)
_LIMITS: Final = objects.SOFTWARE_POSITION_LIMIT
_DEFAULT_STOP_S: Final = 0.5  # duration of a stop if the drive has no deceleration
_VL_RUN: Final = 0x70  # CiA 402-2, 0x6040 in mode VL: bits 4, 5 and 6 enable, unlock and use the ramp's reference
_INTERPOLATE: Final = 0x10  # CiA 402-2, 0x6040 in mode IP: bit 4 enables interpolation
_FAR: Final = 0.01  # rad (m): at a larger distance the set-point is not reached
_FAST: Final = 0.05  # rad/s (m/s): a higher speed is motion
_WAY_CYCLES: Final = 2.0  # delay of a measured value and of a target, in cycles
_NEAR: Final = 1 << 30  # counts: a closer target is certainly within half the range of the counter


class JointTargets:
    """Command interfaces of a joint and their targets; RobotConfigError if an interface has no RPDO.

    `claimed` is the command interface that a controller has claimed, `mode` the mode requested last, `current` the
    target of that mode; `tracked` is the command that `tracking` monitors, None for none.
    """

    def __init__(
        self, description: ControlJoint, axis: AxisProcessData, machine: DriveMachine, parameters: AxisParameters
    ) -> None:
        self.commands = {
            name: CommandInterface(description.name, name, minimum=info.minimum, maximum=info.maximum)
            for name, info in description.command_interfaces.items()
        }
        require_targets(axis, self.commands)
        self.claimed: str | None = None
        self.mode: int | None = None
        self.current: ModeTarget | None = None
        self.pending: int | None = None  # mode that waits for a cycle at standstill
        self.feed_forward = FeedForward(axis, self.commands)
        self.tracking = Tracking()
        self.tracked: CommandInterface | None = None
        self._axis, self._machine, self._parameters = axis, machine, parameters
        self._request = machine.mode_request
        self._outputs = self.commands.get(DIGITAL_OUTPUTS)
        if self._outputs is not None:
            self._outputs.lowest, self._outputs.highest = float(INT32_MIN), float(UINT32_MAX)
        self.has_outputs = self._outputs is not None
        self._command: CommandInterface | None = None
        self._held: int | None = None  # raw position at which all targets are held; None: not held

    @property
    def handshakes(self) -> bool:
        return self.current is not None and self.current.handshakes

    def mode_for(self, interface: str) -> int:
        """Return the mode for a command interface, from bus.yml or 0x6502; raise DriveError if no mode serves it."""
        return choose_mode(self._axis, self._parameters, interface)

    def mode_serves(self, mode: int) -> str | None:
        """Return the command interface that a mode serves, or None if the mode has no target."""
        target = make_target(mode, self._axis, self._machine)
        return None if target is None else target.interface

    def claim(self, interface: str | None, feed_forward: Collection[str] = ()) -> None:
        """Select the claimed interface and its mode; `feed_forward` names the feed-forward interfaces.

        A TARGET uses the current mode, which a user or the next enable requests.
        """
        self.claimed = interface
        self.feed_forward.claim(feed_forward)
        if interface not in (None, TARGET):
            self.set_mode(self.mode_for(interface))
        self.refresh()

    def require_claim(self, mode: int) -> None:
        """Raise an error if the claimed interface cannot be commanded in a mode.

        Raise ControlError if the mode is for another interface, or DriveError for a TARGET whose mode has no target in
        an RPDO.
        """
        if self.claimed == TARGET:
            if mode not in self._axis.target_objects:
                raise DriveError(
                    f"{self._axis.node.label}: {mode_words(mode)} has no target; choose a mode with a target"
                )
            require_mapped(self._axis, mode)
        elif self.claimed is not None and self.mode_serves(mode) != self.claimed:
            raise ControlError(
                f"{self._axis.node.label}: a controller commands its {self.claimed}, which mode "
                f"{mode_name(mode)} does not serve; deactivate that controller first"
            )

    def uncommanded_motion(self, mode: int | None) -> str | None:
        """Return why an enabled axis would move in a position mode without a command, or None.

        In these modes the target at standstill is the actual position, which must be known and within 0x607D. In PP
        the drive moves only to new set-points, such as those of a controller that holds a position.
        """
        axis, name = self._axis, self._axis.node.name
        if mode is None or not self._holds_position(mode):
            return None
        if axis.position is None:
            index = axis.index(objects.POSITION_ACTUAL)
            return (
                f"no TPDO carries its position (0x{index:04X}), so in {mode_name(mode)} it would move as soon as it is "
                f"enabled; map 0x{index:04X} in a TPDO of {name} in bus.yml"
            )
        limits, raw = axis.limits, axis.raw_position
        # CiA 402-2, 0x607D: the drive limits every position demand, also one that equals the actual position
        if not self._parameters.loaded or not axis.position.fresh or not limits.excludes(raw, axis.scale):
            return None
        listed = listed_modes(axis, self._parameters)
        home = f"home it (canopen-control axis home {name}), or " if not listed or OperationMode.HM in listed else ""
        return (
            f"its position {raw} is outside its software position limits (0x{axis.index(_LIMITS):04X}: {limits.low} "
            f"to {limits.high}), so in {mode_name(mode)} it would move to the limit as soon as it is enabled; {home}"
            f"end the robot and move it back with canopen-control jog {axis.node.node_id} --can CHANNEL --eds FILE"
        )

    def awaits_position(self, mode: int | None) -> bool:
        """Whether a position mode needs the actual position, whose TPDO has not arrived since the boot."""
        position = self._axis.position
        return position is not None and not position.fresh and mode is not None and self._holds_position(mode)

    def check_mode(self, mode: int) -> None:
        """Raise DriveError if an enabled axis would move without a command after a change to this mode."""
        if self._machine.enabled and (reason := self.uncommanded_motion(mode)) is not None:
            raise DriveError(f"{self._axis.label}: {reason}")

    def _holds_position(self, mode: int) -> bool:
        """Whether the drive gets its actual position as a target at standstill, or the controller sends it."""
        kind = TARGET_CLASSES.get(mode) or _OWN_CLASSES.get(self._axis.own_modes.get(mode, ""))
        return kind in _HOLDING or (kind is SetPointTarget and self.claimed == POSITION)

    def set_mode(self, mode: int) -> None:
        """Request a mode, which an enabled drive enters after one cycle with its targets at standstill.

        If that mode or the present one has no ramp in the drive, the axis is ramped down before.

        Raise UnsupportedMode if the drive does not list the mode, or DriveError if an enabled axis would move.
        """
        require_mode(mode, listed_modes(self._axis, self._parameters))
        self.check_mode(mode)
        self.mode = mode
        # the new mode uses its target object as soon as 0x6061 shows the mode
        if self._machine.enabled and self._machine.mode not in (None, mode):
            self.pending = mode
        else:
            self.take_mode(mode)

    def take_mode(self, mode: int) -> None:
        self.pending = None
        self._machine.set_mode(mode)
        self.current = make_target(mode, self._axis, self._machine)
        self.feed_forward.zero()
        self.refresh()
        self._held = None

    def hold(self) -> None:
        """Set all targets to standstill at the current position."""
        raw = self._axis.raw_position
        if raw == self._held:
            return
        if self._held is None:
            if self.current is not None:
                self.current.hold()
            self.feed_forward.zero()
            self._machine.mode_bits = 0 if self.current is None else self.current.held_bits
        self._held = raw
        self._axis.hold(raw)

    def node_ready(self) -> None:
        """Make the next `hold` write standstill targets, because a boot has overwritten the outputs."""
        self._held = None

    def hold_others(self) -> None:
        """Set the targets of all other modes to the current position or 0, in case of a later mode change."""
        if self.current is not None:
            self._axis.hold_others(self.current.output)

    def change(self) -> None:
        """Command standstill for this cycle, then change to the pending mode."""
        self.hold()
        if self.pending is not None:
            self.take_mode(self.pending)

    @property
    def ends_abruptly(self) -> bool:
        """Whether the drive stops at once if its target is set to standstill, because it has no ramp in its mode."""
        return self.current is not None and self.current.ramped

    @property
    def changes_abruptly(self) -> bool:
        """Whether the present mode or the pending one has no ramp in the drive."""
        if self.pending is None or self.current is None:
            return False
        target = make_target(self.pending, self._axis, self._machine)
        return self.current.ramped or (target is not None and target.ramped)

    def come_to_rest(self, now: int, period: float) -> bool:
        """Run one cycle of a ramp to standstill in the present mode; return True once the target is at standstill."""
        current = self.current
        if current is None or not current.handshakes:
            return self.ramp_down(period)
        self._held = None
        current.follow(_NAN, now, period)
        self._machine.mode_bits = current.bits
        return True

    def ramp_down(self, period: float) -> bool:
        """Run one cycle of a controlled stop; return True once the target is at standstill."""
        current, self._held = self.current, None
        if current is None:
            return True
        if self.feed_forward.fed:
            self.feed_forward.zero()
        at_standstill = current.ramp_down(period)
        self._machine.mode_bits = current.bits
        return at_standstill

    def follow(self, now: int, period: float) -> None:
        """Send the command of this cycle, within the limits of the description."""
        current, command = self.current, self._command
        if current is None:
            return
        self._held = None
        value = _NAN
        if command is not None:
            value = command.value
            if value < command.minimum or value > command.maximum:
                value = current.within(value, command.minimum, command.maximum)
            if self.feed_forward.fed and self.mode is OperationMode.CSP:
                self.feed_forward.follow(command, period)
        if not current.steady or value != current.value or self._axis.limits.blocked != current.blocked:
            current.follow(value, now, period)
        if current.bits or current.handshakes:
            self._machine.mode_bits = current.bits

    def write_outputs(self) -> None:
        """Write the mode of operation and the digital outputs to their RPDOs."""
        output, mode = self._axis.mode, self._request.sent
        if output is not None and mode is not None and mode != output.value:
            output.set(mode)
        if self._outputs is not None and self._axis.digital_outputs is not None:
            value = self._outputs.value
            if self._outputs.lowest <= value <= self._outputs.highest:  # False for nan
                self._axis.digital_outputs.set(int(value) & 0xFFFFFFFF)

    def refresh(self) -> None:
        """Select the command to follow, if its quantity fits the mode, and update its range.

        Call this again after the scale has changed.
        """
        current, command = self.current, self._command
        if command is not None:
            command.lowest, command.highest, command.range = -math.inf, math.inf, None
        self.feed_forward.refresh()
        fits = current is not None and self.claimed in (current.interface, TARGET)
        self._command = command = self.commands[self.claimed] if fits and self.claimed is not None else None
        if command is not None and current is not None and command.quantity != current.interface:
            command.quantity, command.value = current.interface, _NAN  # the old command had another unit
        self._track(command if current is not None and current.tracks else None)
        if current is not None and current.handshakes:
            self._parameters.bound_ramp()
        if current is None or command is None:
            return
        if command.interface == TARGET:
            velocity, slope = (self._parameters.get(index) or math.inf for index in _PROFILE)
            current.ramp(velocity, slope)
        if command.quantity == POSITION:
            command.range = current
        else:
            command.lowest, command.highest = current.value_range()

    def _track(self, command: CommandInterface | None) -> None:
        self.tracked = command
        name = "" if command is None else command.quantity
        if name != self.tracking.interface:
            self.tracking.compare(name, positions=name == POSITION)


class ModeTarget(metaclass=ABCMeta):
    """Base class of the targets of modes of operation.

    `output` is the target object in an RPDO, `bits` are the mode-specific bits of the controlword, `held_bits` those at
    standstill; `handshakes` is True if the target has events, `tracks` if the axis must reach the position or velocity
    in every cycle, `ramped` if the master computes its ramps, because the drive has none in this mode. `value` is the
    last target, nan for none, and `blocked` the direction in which an active limit forbade motion then; `steady` is
    True if repeating a target changes nothing.
    """

    interface = ""
    bits = 0
    held_bits = 0
    handshakes = False
    tracks = False
    ramped = False
    steady = False

    def __init__(self, axis: AxisProcessData, output: Output, machine: DriveMachine) -> None:
        self._axis, self.output, self._machine = axis, output, machine
        self.value = _NAN
        self.blocked = 0
        self._slope = 0.0  # deceleration of a stop that the master ramps

    @abstractmethod
    def hold(self) -> None:
        """Command standstill at the current position."""

    @abstractmethod
    def follow(self, value: float, now: int, period: float) -> None:
        """Send a target in SI units (nan: no target); `now` is in ns, `period` in s."""

    def within(self, value: float, low: float, high: float) -> float:
        """Clamp a target to the range of its command interface."""
        return max(low, min(high, value))

    def ramp(self, velocity: float, slope: float) -> None:
        """Set the maximum speed and acceleration in device units, if the master computes a position profile."""
        del velocity, slope

    @abstractmethod
    def ramp_down(self, period: float) -> bool:
        """Run one cycle of a controlled stop; return True once the target is at standstill."""

    @abstractmethod
    def value_range(self) -> tuple[float, float]:
        """Return the smallest and largest value of the target object in SI units."""

    def commands_into_limit(self, value: float) -> bool:  # noqa: ARG002 - the verb of every mode
        """Whether a target moves the axis beyond its active limit; never for positions, which end there."""
        return False

    def events(self) -> Sequence[SetPointEvent]:
        """Return the new set-point events; only PP has any."""
        return ()

    def _same(self, value: float) -> bool:
        """Whether the target and the blocked direction are unchanged since the last cycle; if not, store both."""
        if value == self.value and self._axis.limits.blocked == self.blocked:
            return True
        self.value, self.blocked = value, self._axis.limits.blocked
        return False


def stop_slope(axis: AxisProcessData, speed: float) -> float:
    """Return the deceleration of a stop in units/s^2: 0x6084, or the value that stops `speed` in half a second."""
    slope = axis.limits.deceleration
    return slope if math.isfinite(slope) and slope > 0 else speed / _DEFAULT_STOP_S


class _ScaledTarget(ModeTarget):
    """Target of velocity or torque with a scale factor and an integer range."""

    low = INT16_MIN
    high = INT16_MAX

    @abstractmethod
    def factor(self) -> float:
        """Return the device units per SI unit, with the sign of the direction."""

    def value_range(self) -> tuple[float, float]:
        factor = self.factor()
        ends = self.low / factor, self.high / factor
        return min(ends), max(ends)

    def commands_into_limit(self, value: float) -> bool:
        return value * self.factor() * self._axis.limits.blocked > 0  # False for nan

    def _scaled(self, value: float) -> int:
        """Return a target in device units; 0 for nan or a target out of range, which is stored in `out_of_range`."""
        raw = to_object(value * self.factor(), self.low, self.high)
        self._axis.out_of_range = _NAN if raw is not None else value
        return 0 if raw is None else raw


class VelocityTarget(_ScaledTarget):
    """Target of mode PV; the drive computes the ramp."""

    interface = VELOCITY
    tracks = True
    steady = True
    low = INT32_MIN
    high = INT32_MAX
    ramped = False  # the master ramps

    def hold(self) -> None:
        self.value = _NAN
        self._slope = 0.0
        self.output.set(0)

    def follow(self, value: float, now: int, period: float) -> None:  # noqa: ARG002 - the verb of every mode
        axis = self._axis
        blocked = axis.limits.blocked
        if value == self.value and blocked == self.blocked:
            return  # same as `_same`, but faster
        self.value, self.blocked = value, blocked
        self._slope = 0.0
        self.output.set(self._bounded(self._scaled(value)))

    def _bounded(self, raw: int) -> int:
        return self._axis.limits.of_velocity(raw)

    def factor(self) -> float:
        return self._axis.scale.vel_to_dev

    def ramp_down(self, period: float) -> bool:
        """Ramp to zero with the drive's deceleration; command zero at once if the drive computes the ramp."""
        raw: int = self.output.value
        self.value = _NAN
        if not self.ramped or raw == 0:
            self.output.set(0)
            return True
        self._slope = self._slope or stop_slope(self._axis, abs(raw))
        step = max(1, round(self._slope * period))
        raw = max(0, raw - step) if raw > 0 else min(0, raw + step)
        self.output.set(raw)
        return raw == 0


class RampedVelocityTarget(VelocityTarget):
    """Target of mode CSV; the master computes the stop ramp."""

    ramped = True


class WordVelocityTarget(VelocityTarget):
    """Target of mode VL: 0x6042 in rpm of the motor, 16 bits, with the drive's ramp enabled."""

    bits = _VL_RUN
    held_bits = _VL_RUN  # without bit 5 the ramp keeps its speed, also in a drive that ignores a quick stop
    low = INT16_MIN
    high = INT16_MAX

    def factor(self) -> float:
        """Return the motor rpm per rad/s (m/s)."""
        return self._axis.rpm_to_dev

    def _bounded(self, raw: int) -> int:
        axis = self._axis
        return axis.limits.within(raw, axis.limits.most * abs(axis.rpm_to_dev / axis.scale.vel_to_dev))


class EffortTarget(_ScaledTarget):
    """Target of modes TQ and CST; a stop commands zero torque.

    A torque does not limit the velocity: a torque that would drive a joint beyond the velocity limit of its description
    is set to zero, as in ros2_control's joint limiter. The joint continues to accelerate during the two cycles that a
    measured value takes from the drive and a target takes to the drive, so that the velocity expected after these
    cycles is compared with the limit.
    """

    interface = EFFORT

    def __init__(self, axis: AxisProcessData, output: Output, machine: DriveMachine) -> None:
        super().__init__(axis, output, machine)
        self._last: int | None = None  # position in the previous cycle, if no velocity is measured
        self._speed = _NAN  # speed in the previous cycle

    def hold(self) -> None:
        self.value, self._last, self._speed = _NAN, None, _NAN
        self.output.set(0)

    def follow(self, value: float, now: int, period: float) -> None:  # noqa: ARG002 - the verb of every mode
        """Send a torque within the drive's limits, or 0 if the velocity limit would be exceeded."""
        limits = self._axis.limits
        same = self._same(value)
        if limits.described == math.inf:
            if not same:
                self.output.set(limits.of_torque(self._scaled(value)))
            return
        before, self._speed = self._speed, self._measured(period)
        speed = self._speed
        if speed == speed and before == before:  # both speeds are known
            speed += _WAY_CYCLES * (speed - before)
        if value * speed > 0.0 and abs(speed) >= limits.described:  # False for nan
            limits.held = True
            value = 0.0
        self.output.set(limits.of_torque(self._scaled(value)))

    def _measured(self, period: float) -> float:
        """Return the measured speed in SI units, if necessary from positions; nan if unknown."""
        axis = self._axis
        if axis.velocity is not None and axis.velocity.fresh:
            speed: float = axis.velocity.value * axis.scale.vel_from_dev
            return speed
        here = axis.raw_position + axis.unwrap.offset
        last, self._last = self._last, here
        return _NAN if last is None or period <= 0.0 else (here - last) / axis.scale.pos_to_dev / period

    def factor(self) -> float:
        return self._axis.scale.eff_to_dev

    def ramp_down(self, period: float) -> bool:  # noqa: ARG002 - the verb of every mode
        self.hold()
        return True


class _PositionTarget(ModeTarget):
    """Target position, unwrapped beyond the drive's 32-bit counter."""

    def value_range(self) -> tuple[float, float]:
        """Return the positions half the counter's range away, beyond which the drive would turn the other way."""
        here, scale = self._axis.raw_position + self._axis.unwrap.offset, self._axis.scale
        ends = [(here + way - scale.offset_pos_to_dev) / scale.pos_to_dev for way in (INT32_MIN + 1, INT32_MAX)]
        return min(ends), max(ends)

    def within(self, value: float, low: float, high: float) -> float:
        """Clamp a target to the range; an axis outside the range stays there for a target that is outside too."""
        scale = self._axis.scale
        here = (self._start() - scale.offset_pos_to_dev) / scale.pos_to_dev
        return super().within(value, min(low, here), max(high, here))

    def _start(self) -> int:
        """Return the count from which a target leads on, with the turns of the counter."""
        return self._axis.raw_position + self._axis.unwrap.offset

    def _count_of(self, value: float, none: int) -> int:
        """Return the count of a target; `none` for nan or a target out of range, which is stored in `out_of_range`."""
        axis = self._axis
        scale = axis.scale
        count = value * scale.pos_to_dev + scale.offset_pos_to_dev
        if -_NEAR <= count - (axis.raw_position + axis.unwrap.offset) <= _NEAR:  # False for nan
            axis.out_of_range = _NAN
            return round(count)
        if value != value:
            return none
        low, high = self.value_range()
        fits = low <= value <= high
        axis.out_of_range = _NAN if fits else value
        return scale.position_count(value) if fits else none


class PositionTarget(_PositionTarget):
    """Target of mode CSP: one position per SYNC within the velocity limit; the master computes the stop ramp."""

    interface = POSITION
    tracks = True
    ramped = True

    def __init__(self, axis: AxisProcessData, output: Output, machine: DriveMachine) -> None:
        super().__init__(axis, output, machine)
        self._count: int | None = None  # target with the turns of the counter; None: the present position
        self._speed = 0.0  # counts per second
        self._rest = 0.0  # fraction of a count that is left for the next cycle at the velocity limit
        self._ramp = TrapezoidalProfile()

    def hold(self) -> None:
        self._count, self.value = None, _NAN
        self._speed = self._slope = 0.0
        self._ramp.rest()
        self.output.set(self._axis.raw_position)

    def ramp(self, velocity: float, slope: float) -> None:
        """Set the maximum speed and acceleration in device units; if both are infinite, no ramp is computed."""
        counts = abs(self._axis.scale.pos_to_dev / self._axis.scale.vel_to_dev)
        self._ramp.limit(velocity * counts, slope * counts)

    def follow(self, value: float, now: int, period: float) -> None:  # noqa: ARG002 - the verb of every mode
        """Send a position within the velocity limit; for nan, stop or hold the last target."""
        if self._same(value) and self._speed == 0.0:
            return
        if self._ramp.speed and value != value:
            if self.ramp_down(period):
                self._ramp.rest()
            return
        here = self._here() if self._count is None else self._count
        self._send_position(here, self._towards(here, self._count_of(value, here), period), period)

    def ramp_down(self, period: float) -> bool:
        self.value = _NAN
        if self._speed == 0.0:
            return True
        here = self._here()
        self._slope = self._slope or stop_slope(self._axis, abs(self._speed))
        remaining = max(0.0, abs(self._speed) - self._slope * period)
        speed = math.copysign(remaining, self._speed)
        self._send_position(here, here + round(speed * period), period)
        self._speed = speed
        return remaining == 0.0

    def _start(self) -> int:
        return super()._start() if self._count is None else self._count

    def _here(self) -> int:
        if self._count is None:
            self._count = self._axis.raw_position + self._axis.unwrap.offset
        return self._count

    def _towards(self, here: int, target: int, period: float) -> int:
        limits, way = self._axis.limits, target - here
        if way * limits.blocked > 0:
            self._ramp.rest()
            return here
        if self._ramp.limited:
            return here + self._ramp.step(way, period, limits.pace)
        reach = limits.pace * period + self._rest
        if -reach <= way <= reach:
            self._rest = 0.0
            return target
        limits.held = limits.held or abs(way) > reach * HELD + 1
        step = int(reach)
        self._rest = reach - step
        if step == 0:
            self.value = _NAN  # nan, so that the next cycle continues
        return here + step if way > 0 else here - step

    def _send_position(self, here: int, count: int, period: float) -> None:
        """Send a position count within the software position limits; store count and speed."""
        axis = self._axis
        limits, offset = axis.limits, axis.unwrap.offset
        raw = wrap_int32(count - offset)
        if not limits.low <= raw <= limits.high:
            bounded = limits.of_position(raw)
            if bounded != raw:
                raw, count = bounded, bounded + offset
        self._speed = (count - here) / period if period > 0 else 0.0
        self._count = count
        if raw != self.output.value:
            self.output.set(raw)


class InterpolatedTarget(PositionTarget):
    """Target of mode IP: as in CSP, with interpolation enabled by bit 4."""

    bits = _INTERPOLATE


class SetPointTarget(_PositionTarget):
    """Target of mode PP: set-points with a handshake; a stop uses the halt bit (0x605D)."""

    interface = POSITION
    handshakes = True

    def __init__(self, axis: AxisProcessData, output: Output, machine: DriveMachine) -> None:
        super().__init__(axis, output, machine)
        self._handshake = SetPointHandshake()
        self._sent: int | None = None

    def hold(self) -> None:
        """Abandon the set-point and command the actual position."""
        self.value, self._sent = _NAN, None
        if self._handshake.busy:
            self._handshake.abort("the axis is not enabled")
            self._handshake.update(None, ready=False, now=0)
        self.bits = 0
        self.output.set(self._axis.raw_position)

    def follow(self, value: float, now: int, period: float) -> None:  # noqa: ARG002 - the verb of every mode
        """Send a new set-point, which replaces an active one; for nan, stop with the drive's ramp."""
        handshake, machine = self._handshake, self._machine
        if self._same(value):
            pass
        elif not math.isnan(value):
            self._send_set_point(value)
        elif self._sent is not None:
            self._brake(self._sent)
        if handshake.busy:
            self.bits = handshake.update(
                machine.statusword, ready=True, now=now, halted=machine.halted, under_way=self._is_moving()
            )
            if handshake.target is not None:
                self.output.set(handshake.target)

    def _is_moving(self) -> bool:
        """Whether the axis moves, faster than `_FAST`, and is farther than `_FAR` from its set-point."""
        axis, target = self._axis, self._handshake.target
        velocity, position = axis.velocity, axis.position
        if target is None or velocity is None or position is None or not (velocity.fresh and position.fresh):
            return False
        far = abs(wrap_int32(target - axis.raw_position)) > _FAR * abs(axis.scale.pos_to_dev)
        return far and abs(velocity.value * axis.scale.vel_from_dev) > _FAST

    def move(self, count: int, *, relative: bool) -> None:
        """Send one set-point in device units, independent of controllers."""
        self._handshake.move(count, relative=relative, immediately=True)

    def ramp_down(self, period: float) -> bool:  # noqa: ARG002 - the verb of every mode
        """Stop with the halt bit (0x605D); return True at once."""
        self.value, self._sent = _NAN, None
        if self._handshake.busy:
            self._handshake.abort("stopped")
            self._handshake.update(self._machine.statusword, ready=False, now=0)
        self.bits = 0
        self._machine.halt(True)
        return True

    def events(self) -> Sequence[SetPointEvent]:
        return self._handshake.events()

    def _brake(self, target: int) -> None:
        """Stop by moving the set-point to where the drive's braking ramp ends, but not beyond `target`."""
        self._sent = None
        axis, here = self._axis, self._axis.raw_position
        if not self._handshake.busy:
            return
        velocity = axis.velocity.value if axis.velocity is not None and axis.velocity.fresh else 0
        way = velocity * abs(velocity) / (2 * stop_slope(axis, max(1, abs(velocity))))
        resting = here + round(way * abs(axis.scale.pos_to_dev / axis.scale.vel_to_dev))
        low, high = min(here, target), max(here, target)
        self._handshake.stop_at(max(low, min(high, resting)))

    def _send_set_point(self, value: float) -> None:
        axis = self._axis
        if axis.limits.ramp_unbounded:
            self.value = _NAN  # waits until the drive's own speed is known to be within the limit
            return
        count = self._count_of(value, axis.raw_position + axis.unwrap.offset)
        raw = axis.limits.of_position(axis.unwrap.raw_of(count))
        if raw != self._sent:
            self._sent = raw
            self._handshake.move(raw, immediately=True)


TARGET_CLASSES: Final[Mapping[int, Callable[[AxisProcessData, Output, DriveMachine], ModeTarget]]] = MappingProxyType(
    {
        OperationMode.PP: SetPointTarget,
        OperationMode.VL: WordVelocityTarget,
        OperationMode.PV: VelocityTarget,
        OperationMode.TQ: EffortTarget,
        OperationMode.IP: InterpolatedTarget,
        OperationMode.CSP: PositionTarget,
        OperationMode.CSV: RampedVelocityTarget,
        OperationMode.CST: EffortTarget,
    }
)
"""Class of each mode's target, for the object in `cia402.modes.TARGET_OBJECTS`."""


_OWN_CLASSES: Final[Mapping[str, Callable[[AxisProcessData, Output, DriveMachine], ModeTarget]]] = MappingProxyType(
    {POSITION: PositionTarget, VELOCITY: RampedVelocityTarget, EFFORT: EffortTarget}
)
"""Class of the target of a manufacturer-specific mode, by command interface; the master computes the ramp."""

_HOLDING: Final = (PositionTarget, InterpolatedTarget)
"""Classes whose target at standstill is the actual position, to which the drive moves as soon as it is enabled."""


def make_target(mode: int, axis: AxisProcessData, machine: DriveMachine) -> ModeTarget | None:
    """Return the target of a mode, or None if the mode has no target object or no RPDO contains it."""
    address = axis.target_objects.get(mode)
    output = None if address is None else axis.output(*address)
    if address is None or output is None:
        return None
    target = (TARGET_CLASSES.get(mode) or _OWN_CLASSES[axis.own_modes[mode]])(axis, output, machine)
    # EDS files of drives differ from the data types of CiA 402-2, such as 0x6071 with 32 bits
    entry = axis.node.od.get(axis.index(address[0]), address[1])
    if isinstance(target, _ScaledTarget) and entry is not None and (bits := entry.data_type.bits) is not None:
        target.low, target.high = -(1 << bits - 1), (1 << bits - 1) - 1
    return target
