"""Targets of a joint: from a command interface to the target object of the drive's mode.

`JointTargets` has the interface that a controller claimed, the mode for this interface (`choose_mode`), and the target
of the mode (`mode_targets`).

Only one motion interface is commanded at a time, except for those that feed a position forward (`feed_forward`). Before
an enabled drive changes its mode, all targets are at standstill for one cycle, because the new mode uses its target at
once; targets of other modes are held at the actual position, without velocity and effort.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.modes import OperationMode, mode_name, mode_words, require_mode
from canopen_control.cia402.units import INT32_MIN, wrap_int32
from canopen_control.errors import ControlError, DriveError
from canopen_control.hardware.axis_parameters import choose_mode, listed_modes, require_mapped, require_targets
from canopen_control.hardware.interfaces import DIGITAL_OUTPUTS, TARGET, CommandInterface
from canopen_control.hardware.mode_targets import (
    HOLDING,
    OWN_CLASSES,
    TARGET_CLASSES,
    InterpolatedTarget,
    ModeTarget,
    PositionTarget,
    SetPointTarget,
    make_target,
)
from canopen_control.hardware.tracking import FeedForward, Tracking
from canopen_control.urdf.joint_element import POSITION

if TYPE_CHECKING:
    from collections.abc import Collection

    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.hardware.axis import AxisProcessData
    from canopen_control.hardware.axis_parameters import AxisParameters
    from canopen_control.urdf.ros2_control import ControlJoint


UINT32_MAX: Final = (1 << 32) - 1
_NAN: Final = math.nan
_SAG: Final = 0.01  # rad or m by which a load may move an enabled axis that holds its position
_PROFILE: Final = (objects.PROFILE_VELOCITY, objects.PROFILE_ACCELERATION)
_LIMITS: Final = objects.SOFTWARE_POSITION_LIMIT


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
        self._halted = False  # whether they are held since a halt

    @property
    def handshakes(self) -> bool:
        return self.current is not None and self.current.handshakes

    @property
    def interpolates(self) -> bool:
        """Whether the set-points are those of mode IP, which may have a buffer."""
        return isinstance(self.current, InterpolatedTarget)

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

    @property
    def unknown_position(self) -> str:
        """Text about the missing TPDO of `awaits_position`."""
        return (
            f"its position (0x{self._axis.index(objects.POSITION_ACTUAL):04X}) has not arrived since the boot, so it "
            "would move as soon as it is enabled; set `transmission: 1` for the TPDO that carries it"
        )

    def is_unserved_in(self, mode: int | None) -> bool:
        """Whether the claimed interface cannot be served, because the drive has stayed in `mode` (None: unknown)."""
        if self.claimed in (None, TARGET):
            return False
        return mode is None or self.mode_serves(mode) != self.claimed

    def check_mode(self, mode: int) -> None:
        """Raise DriveError if an enabled axis would move without a command after a change to this mode."""
        if self._machine.enabled and (reason := self.uncommanded_motion(mode)) is not None:
            raise DriveError(f"{self._axis.label}: {reason}")

    def _holds_position(self, mode: int) -> bool:
        """Whether the drive gets its actual position as a target at standstill, or the controller sends it."""
        kind = TARGET_CLASSES.get(mode) or OWN_CLASSES.get(self._axis.own_modes.get(mode, ""))
        return kind in HOLDING or (kind is SetPointTarget and self.claimed == POSITION)

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
        """Set all targets to standstill at the current position.

        An enabled axis keeps its target position while it is near. It may yield to its load, for example when its brake
        is released; if the target followed, the axis would sink further and further. At the end of a halt the target is
        the actual position, where the drive's own ramp has ended.
        """
        raw = self._axis.raw_position
        if raw == self._held or self._keeps_target(raw):
            return
        if self._held is None:
            if self.current is not None:
                self.current.hold()
            self.feed_forward.zero()
            self._machine.mode_bits = 0 if self.current is None else self.current.held_bits
        self._held, self._halted = raw, self._machine.halted
        self._axis.hold(raw)

    def _keeps_target(self, raw: int) -> bool:
        """Whether an enabled drive holds its target position, and the axis is near it."""
        held, machine = self._held, self._machine
        if held is None or not machine.enabled or not isinstance(self.current, HOLDING):
            return False
        if self._halted and not machine.halted:
            return False
        return machine.mode == self.mode and abs(wrap_int32(raw - held)) <= _SAG * abs(self._axis.scale.pos_to_dev)

    def node_ready(self) -> None:
        """Make the next `hold` write standstill targets, because a boot has overwritten the outputs."""
        self._held = None

    def is_left_by(self, raw: int, step: int) -> bool:
        """Whether a step of the position to `raw` has led an enabled axis away from its target position."""
        target = self.current
        if target is None or target.interface != POSITION or not self._machine.enabled:
            return False
        distance = wrap_int32(target.output.value - raw)
        return abs(distance) > abs(wrap_int32(distance + step))

    def shift(self) -> None:
        """Keep the axis where it is after its position has jumped: the target is sent in the new coordinates."""
        if isinstance(self.current, PositionTarget):
            self.current.shift()
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
