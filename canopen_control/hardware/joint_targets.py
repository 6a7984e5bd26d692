"""From a command interface to the target object of a drive: the claimed interface, the mode that serves it, its target.

The law of this file: bus.yml decides the mode where it says something, else the best mode that the drive lists (0x6502)
and whose target an RPDO carries, cyclic before profile; what cannot be is refused before anything is sent. One
interface of motion at a time, but for what feeds a position forward (`feed_forward`). A mode change of an enabled drive
is preceded by a cycle in which every target is at rest, since the new mode acts upon its target at once; whatever is
not followed is held at the actual position, without velocity and effort.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.modes import (
    INTERFACE_MODES,
    OperationMode,
    mode_for_interface,
    require_mode,
    supported_modes,
)
from canopen_control.cia402.units import INT32_MIN
from canopen_control.errors import ControlError, DriveError, RobotConfigError
from canopen_control.hardware.feed_forward import FEED_FORWARD, FeedForward
from canopen_control.hardware.interfaces import EFFORT, POSITION, TARGET, VELOCITY, CommandInterface
from canopen_control.hardware.mode_targets import make_target, target_address
from canopen_control.hardware.tracking import Tracking

if TYPE_CHECKING:
    from collections.abc import Collection

    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.hardware.axis import Axis
    from canopen_control.hardware.axis_parameters import AxisParameters
    from canopen_control.hardware.mode_target import ModeTarget
    from canopen_control.urdf.ros2_control import ControlJoint

__all__ = [
    "DIGITAL_OUTPUTS",
    "MOTION",
    "JointTargets",
    "choose_mode",
    "listed_modes",
    "require_targets",
    "serving_objects",
]

UINT32_MAX: Final = (1 << 32) - 1
DIGITAL_OUTPUTS: Final = "digital_outputs"
MOTION: Final = (POSITION, VELOCITY, EFFORT)
_PROFILE: Final = (objects.PROFILE_VELOCITY, objects.PROFILE_ACCELERATION)
_M: Final = OperationMode
_SERVED: Final = {
    POSITION: (*INTERFACE_MODES[POSITION], OperationMode.IP),
    VELOCITY: (*INTERFACE_MODES[VELOCITY], OperationMode.VL),
    EFFORT: INTERFACE_MODES[EFFORT],
    TARGET: (_M.PP, _M.PV, _M.VL, _M.CSP, _M.CSV, _M.IP, _M.TQ, _M.CST),
}
"""Command interface to the modes that serve it; the last ones only where no better one is there.

A TARGET is served by all of them. The first is what a drive begins with: those in which the drive makes the ramp.
"""


class JointTargets:
    """The command interfaces of a joint and what becomes of them; RobotConfigError for one that no RPDO serves.

    `claimed` is the command interface that a controller drives, `mode` the mode last asked for, `current` its target;
    `tracked` the command whose `tracking` is watched, None where none is.
    """

    def __init__(
        self, description: ControlJoint, axis: Axis, machine: DriveMachine, parameters: AxisParameters
    ) -> None:
        self.commands = {
            name: CommandInterface(description.name, name, minimum=info.minimum, maximum=info.maximum)
            for name, info in description.command_interfaces.items()
        }
        require_targets(axis, self.commands)
        self.claimed: str | None = None
        self.mode: OperationMode | None = None
        self.current: ModeTarget | None = None
        self.pending: OperationMode | None = None  # a mode that waits for a cycle at rest
        self.feed_forward = FeedForward(axis, self.commands)
        self.tracking = Tracking()
        self.tracked: CommandInterface | None = None
        self._axis, self._machine, self._parameters = axis, machine, parameters
        self._request = machine.mode_request
        self._outputs = self.commands.get(DIGITAL_OUTPUTS)
        if self._outputs is not None:
            self._outputs.lowest, self._outputs.highest = float(INT32_MIN), float(UINT32_MAX)
        self._command: CommandInterface | None = None
        self._held: int | None = None  # the position at which all targets are held; None: they are not

    @property
    def handshakes(self) -> bool:
        """Whether the target has events of its own."""
        return self.current is not None and self.current.handshakes

    def mode_for(self, interface: str) -> OperationMode:
        """Return the mode for a command interface: bus.yml's, else the best the drive lists; or DriveError."""
        return choose_mode(self._axis, self._parameters, interface)

    def mode_serves(self, mode: int) -> str | None:
        """Return the command interface that a mode serves here, None for none."""
        target = make_target(mode, self._axis, self._machine)
        return None if target is None else target.interface

    def primary(self, interfaces: Collection[str]) -> str:
        """Return which of the interfaces that are claimed together drives the joint; DriveError where none could.

        Beside a position in CSP there may be its velocity and effort, whose offsets RPDOs carry.
        """
        if len(interfaces) == 1:
            return next(iter(interfaces))
        node, names = self._axis.node, " and ".join(interfaces)
        if POSITION not in interfaces:
            raise DriveError(f"joint {self._axis.joint}: {names} cannot be commanded together")
        if (mode := self.mode_for(POSITION)) is not OperationMode.CSP:
            raise DriveError(
                f"joint {self._axis.joint}: {names} can be commanded together in mode CSP alone, and position is "
                f"commanded in {mode.name}; give {node.name} position_mode: 8 in bus.yml, or command the position alone"
            )
        for each in interfaces:
            if each != POSITION and not self.feed_forward.carries(each):
                index = objects.VELOCITY_OFFSET if each == VELOCITY else objects.TORQUE_OFFSET
                raise DriveError(
                    f"joint {self._axis.joint}: {names} can be commanded together where an RPDO carries "
                    f"0x{self._axis.index(index):04X}; give {node.name} feed_forward: [{each}] in bus.yml, or command "
                    "the position alone"
                )
        return POSITION

    def claim(self, interface: str | None, beside: Collection[str] = ()) -> None:
        """Let a controller's interface drive the joint, or none; the mode follows. `beside`: what feeds it forward.

        A TARGET follows the mode instead, which a user asks for, or the next enable.
        """
        self.claimed = interface
        self.feed_forward.claim(beside)
        if interface not in (None, TARGET):
            self.set_mode(self.mode_for(interface))
        self.refresh()

    def require_claim(self, mode: OperationMode) -> None:
        """Raise ControlError where what is claimed could not be commanded in a mode, DriveError for a TARGET."""
        if self.claimed == TARGET:
            if target_address(mode) is None:
                raise DriveError(f"{self._axis.node.who}: mode {mode.name} takes no target; stay in one that does")
            _require_mapped(self._axis, mode)
        elif self.claimed is not None and self.mode_serves(mode) != self.claimed:
            raise ControlError(
                f"{self._axis.node.who}: a controller commands its {self.claimed}, which mode "
                f"{mode.name} does not serve; deactivate that controller first"
            )

    def set_mode(self, mode: OperationMode) -> None:
        """Ask for a mode that the drive lists; UnsupportedMode for another."""
        require_mode(mode, listed_modes(self._axis, self._parameters))
        self.mode = mode
        if self._machine.enabled and self._machine.mode not in (None, mode):
            self.pending = mode
        else:
            self.take_mode(mode)

    def take_mode(self, mode: OperationMode) -> None:
        """Change to a mode now."""
        self.pending = None
        self._machine.set_mode(mode)
        self.current = make_target(mode, self._axis, self._machine)
        self.feed_forward.zero()
        self.refresh()
        self._held = None

    def hold(self) -> None:
        """Let every target be standstill where the axis is."""
        raw = self._axis.raw_position
        if raw == self._held:
            return
        if self._held is None:
            if self.current is not None:
                self.current.hold()
            self.feed_forward.zero()
            self._machine.mode_bits = 0
        self._held = raw
        self._axis.hold(raw)

    def came(self) -> None:
        """Hold anew: the boot of a node puts what it read into its targets, and the axis may have moved since."""
        self._held = None

    def hold_others(self) -> None:
        """Let the targets of the other modes stay with the axis while it moves."""
        if self.current is not None:
            self._axis.hold_others(self.current.output)

    def change(self) -> None:
        """Rest for this cycle, then take the mode that waits."""
        self.hold()
        if self.pending is not None:
            self.take_mode(self.pending)

    def slow(self, period: float) -> bool:
        """Make one cycle of a controlled stop; True when the target stands."""
        current, self._held = self.current, None
        if current is None:
            return True
        if self.feed_forward.fed:
            self.feed_forward.zero()
        stands = current.slow(period)
        self._machine.mode_bits = current.bits
        return stands

    def follow(self, now: int, period: float) -> None:
        """Send the command within the limits of the description, or none."""
        current, command = self.current, self._command
        if current is None:
            return
        self._held = None
        value = math.nan
        if command is not None:
            value = command.value
            if value < command.minimum:
                value = command.minimum
            elif value > command.maximum:
                value = command.maximum
            if self.feed_forward.fed and self.mode is OperationMode.CSP:
                self.feed_forward.follow(command, period)
        current.follow(value, now, period)
        if current.bits or current.handshakes:
            self._machine.mode_bits = current.bits

    def write_mode(self) -> None:
        """Send the mode, and the digital outputs."""
        output, mode = self._axis.mode, self._request.mode
        if output is not None and mode is not None and mode != output.value:
            output.set(mode)
        if self._outputs is not None and self._axis.digital_outputs is not None:
            value = self._outputs.value
            if self._outputs.lowest <= value <= self._outputs.highest:  # False for nan
                self._axis.digital_outputs.set(int(value) & 0xFFFFFFFF)

    def refresh(self) -> None:
        """Find the interface whose value is the target: the one that is claimed, if the mode serves it; and its span.

        Called again when the scale has changed.
        """
        current, command = self.current, self._command
        if command is not None:
            command.lowest, command.highest, command.span = -math.inf, math.inf, None
        self.feed_forward.refresh()
        fits = current is not None and self.claimed in (current.interface, TARGET)
        self._command = command = self.commands[self.claimed] if fits and self.claimed is not None else None
        if command is not None and current is not None and command.quantity != current.interface:
            command.quantity, command.value = current.interface, math.nan  # what it was told was another quantity
        self._track(command if current is not None and current.tracks else None)
        if current is None or command is None:
            return
        if command.interface == TARGET:
            velocity, slope = (self._parameters.get(each) or math.inf for each in _PROFILE)
            current.ramp(velocity, slope)
        if command.quantity == POSITION:
            command.span = current.span
        else:
            command.lowest, command.highest = current.span()

    def _track(self, command: CommandInterface | None) -> None:
        self.tracked = command
        name = "" if command is None else command.quantity
        if name != self.tracking.interface:
            self.tracking.compare(name, positions=name == POSITION)


def listed_modes(axis: Axis, parameters: AxisParameters) -> tuple[OperationMode, ...]:
    """Return what 0x6502 lists: as read from the drive, else as the EDS has it; () where neither says.

    0 says nothing: a drive has a mode, and a maker who gives no value writes it too.
    """
    identity, entry = axis.node.identity, axis.node.od.get(axis.index(objects.SUPPORTED_DRIVE_MODES), 0)
    at_boot = identity.supported_modes if identity is not None and len(axis.node.plan.axes) == 1 else None
    in_eds = entry.value if entry is not None and isinstance(entry.value, int) else None
    return supported_modes(parameters.get(objects.SUPPORTED_DRIVE_MODES) or at_boot or in_eds or 0)


def choose_mode(axis: Axis, parameters: AxisParameters, interface: str) -> OperationMode:
    """Return the mode for a command interface; raises DriveError (UnsupportedMode) where there is none."""
    config = axis.node.config
    keys = config.motion
    given = {POSITION: keys.position_mode, VELOCITY: keys.velocity_mode, EFFORT: keys.effort_mode}
    given[TARGET] = next((mode for mode in given.values() if mode is not None), None)
    wanted = given[interface]
    listed = listed_modes(axis, parameters)
    if wanted is not None:
        require_mode(wanted, listed)
        _require_mapped(axis, OperationMode(wanted))
        return OperationMode(wanted)
    if not listed:
        raise DriveError(
            f"{axis.node.who}: neither the drive nor its EDS tells which modes it has (0x6502); "
            f"give {POSITION if interface == TARGET else interface}_mode in bus.yml"
        )
    candidates = [mode for mode in _SERVED[interface] if mode in listed]
    for mode in candidates:
        if _is_mapped(axis, mode):
            return mode
    for mode in candidates[:1]:
        _require_mapped(axis, mode)
    return mode_for_interface(POSITION if interface == TARGET else interface, listed)


def serving_objects(interface: str) -> tuple[tuple[int, int], ...]:
    """Return index and subindex, on axis 0, of the targets of all modes that serve a command interface."""
    return tuple(each for each in map(target_address, _SERVED[interface]) if each is not None)


def require_targets(axis: Axis, interfaces: Collection[str]) -> None:
    """Raise RobotConfigError for a command interface that no RPDO could serve, whatever the drive lists."""
    for name in interfaces:
        if name == DIGITAL_OUTPUTS:
            if axis.digital_outputs is None:
                raise _unmapped(axis, name, "0x60FE:01")
        elif name == TARGET or (name in FEED_FORWARD and POSITION in interfaces and _feeds(axis, name)):
            continue  # a drive on a bus alone may be there to be looked at: its enable says what is missing
        elif name not in _SERVED:
            raise RobotConfigError(
                f"joint {axis.joint}: no command interface {name!r}; there are: {', '.join((*MOTION, DIGITAL_OUTPUTS))}"
            )
        elif not any(_is_mapped(axis, mode) for mode in _SERVED[name]):
            index, _ = target_address(_SERVED[name][0]) or (0, 0)
            what = f"0x{axis.index(index):04X}"
            if name in FEED_FORWARD and POSITION in interfaces:
                what += f", or beside its position give feed_forward: [{name}],"
            raise _unmapped(axis, name, what)


def _feeds(axis: Axis, interface: str) -> bool:
    """Whether an RPDO carries the offset of a command interface that has no target of its own."""
    return (axis.velocity_offset if interface == VELOCITY else axis.torque_offset) is not None


def _is_mapped(axis: Axis, mode: int) -> bool:
    address = target_address(mode)
    return address is not None and axis.output(*address) is not None


def _require_mapped(axis: Axis, mode: OperationMode) -> None:
    if not _is_mapped(axis, mode):
        index, subindex = target_address(mode) or (0, 0)
        raise DriveError(
            f"{axis.node.who}: no RPDO carries 0x{axis.index(index):04X}:{subindex:02X}, "
            f"the target of mode {mode.name}; map it in bus.yml"
        )


def _unmapped(axis: Axis, interface: str, what: str) -> RobotConfigError:
    return RobotConfigError(
        f"joint {axis.joint}: no RPDO of {axis.node.name} carries the target of its command interface {interface!r}; "
        f"map {what} in bus.yml or drop the interface"
    )
