"""What a joint is to do, on its way to the drive: the claimed interface, the mode that serves it, the target of that.

The law of this file: one interface of motion at a time. A mode change of an enabled drive is preceded by a cycle in
which every target is at rest, since the new mode acts upon its target at once; whatever is not followed is held at the
actual position, without velocity and effort.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from canopen_control.cia402.modes import require_mode
from canopen_control.hardware.axis_modes import SetPointTarget, make_target
from canopen_control.hardware.choice import DIGITAL_OUTPUTS, choose_mode, listed_modes, require_targets
from canopen_control.hardware.interfaces import CommandInterface

if TYPE_CHECKING:
    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.cia402.modes import OperationMode
    from canopen_control.hardware.axis import Axis
    from canopen_control.hardware.axis_modes import ModeTarget
    from canopen_control.hardware.axis_parameters import AxisParameters
    from canopen_control.hardware.description import ControlJoint

__all__ = ["JointTargets"]


class JointTargets:
    """The command interfaces of a joint and what becomes of them; RobotConfigError for one that no RPDO serves.

    `claimed` is the command interface that a controller drives, `mode` the mode last asked for, `current` its target,
    `handshakes` whether that has events of its own.
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
        self.handshakes = False
        self.pending: OperationMode | None = None  # a mode that waits for a cycle at rest
        self._axis, self._machine, self._parameters = axis, machine, parameters
        self._outputs = self.commands.get(DIGITAL_OUTPUTS)
        self._command: CommandInterface | None = None
        self._held: int | None = None  # the position at which all targets are held; None: they are not

    def mode_for(self, interface: str) -> OperationMode:
        """Return the mode for a command interface: bus.yml's, else the best the drive lists; or DriveError."""
        return choose_mode(self._axis, self._parameters, interface)

    def mode_serves(self, mode: int) -> str | None:
        """Return the command interface that a mode serves here, None for none."""
        target = make_target(mode, self._axis, self._machine)
        return None if target is None else target.interface

    def claim(self, interface: str | None) -> None:
        """Let a controller's interface drive the joint, or none; the mode follows."""
        self.claimed = interface
        if interface is not None:
            self.set_mode(self.mode_for(interface))
        self._find_command()

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
        self.handshakes = isinstance(self.current, SetPointTarget)
        self._find_command()
        self._held = None

    def hold(self) -> None:
        """Let every target be standstill where the axis is."""
        raw = self._axis.raw_position
        if raw == self._held:
            return
        if self._held is None:
            if self.current is not None:
                self.current.hold()
            self._machine.mode_bits = 0
        self._held = raw
        self._axis.hold(raw)

    def hold_others(self) -> None:
        """Let the targets of the other modes stay with the axis while it moves."""
        if self.current is not None:
            self._axis.hold_others(self.current)

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
        current.follow(value, now, period)
        if current.bits or self.handshakes:
            self._machine.mode_bits = current.bits

    def write_mode(self) -> None:
        """Send the mode, and the digital outputs."""
        output, mode = self._axis.mode, self._machine.mode
        if output is not None and mode is not None and mode != output.value:
            output.set(mode)
        if self._outputs is not None and self._axis.digital_outputs is not None and math.isfinite(self._outputs.value):
            self._axis.digital_outputs.set(int(self._outputs.value) & 0xFFFFFFFF)

    def _find_command(self) -> None:
        """Find the interface whose value is the target: the one that is claimed, if the mode serves it."""
        fits = self.current is not None and self.current.interface == self.claimed
        self._command = self.commands[self.claimed] if fits and self.claimed is not None else None
