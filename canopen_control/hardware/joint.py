"""One joint and the drive axis behind it: SI on one side, process data and the CiA 402 machine on the other.

The law of this file: a target reaches the drive only while the joint is enabled, the drive says OPERATION_ENABLED and
the node is ready; in every other case the target is zero velocity at the actual position. A stop first commands zero
and waits for the drive's own ramp, then disables; the wait ends after `STOP_NS` whatever the drive says.
"""

from __future__ import annotations

import enum
import math
from typing import TYPE_CHECKING

from canopen_control.cia402 import objects
from canopen_control.cia402.drive import DriveMachine
from canopen_control.cia402.modes import OperationMode, mode_for_interface, require_mode, supported_modes
from canopen_control.cia402.state import State
from canopen_control.cia402.units import PositionUnwrapper, Scale
from canopen_control.errors import RobotConfigError
from canopen_control.hardware.interfaces import EFFORT, POSITION, VELOCITY, CommandInterface, StateInterface

if TYPE_CHECKING:
    from canopen_control.master.cycle import Input, Output, ProcessImage
    from canopen_control.master.node import RemoteNode

__all__ = ["Action", "JointDrive", "Wish"]

STOP_NS = 10_000_000_000  # a ramp that takes longer ends in the drive's own disable ramp
STANDSTILL = 0.05  # rad/s (or m/s) and below count as standing
_FAULTED = (State.FAULT, State.FAULT_REACTION_ACTIVE)


class Wish(enum.Enum):
    """What the joint is to do with its drive."""

    OFF = "off"
    ON = "on"
    STOPPING = "stopping"


class Action(enum.Enum):
    """What a user may ask of an axis."""

    ENABLE = "enable"
    DISABLE = "disable"
    HALT = "halt"
    QUICK_STOP = "quick-stop"
    FAULT_RESET = "fault-reset"


class JointDrive:
    """A joint bound to one axis of one node; the interfaces are what controllers claim."""

    def __init__(
        self, joint: str, node: RemoteNode, image: ProcessImage, interfaces: tuple[str, ...], axis: int = 0
    ) -> None:
        self.joint, self.node, self.axis = joint, node, axis
        self.machine = DriveMachine(node.name)
        self.scale = _scale(node)
        self.wish = Wish.OFF
        self.mode: OperationMode | None = None
        self.claimed: str | None = None  # the command interface that a controller drives
        self.states = {name: StateInterface(joint, name) for name in (POSITION, VELOCITY, EFFORT)}
        self.commands = {name: CommandInterface(joint, name) for name in interfaces}
        self._unwrap = PositionUnwrapper()
        self._image = image
        self._statusword = self._need(objects.STATUSWORD, "tpdo")
        self._position = self._input(objects.POSITION_ACTUAL)
        self._velocity = self._input(objects.VELOCITY_ACTUAL)
        self._effort = self._input(objects.TORQUE_ACTUAL)
        self._display = self._need(objects.MODES_OF_OPERATION_DISPLAY, "tpdo")
        self._controlword = self._need_output(objects.CONTROLWORD)
        self._mode = self._need_output(objects.MODES_OF_OPERATION)
        self._targets = {
            POSITION: self._output(objects.TARGET_POSITION),
            VELOCITY: self._output(objects.TARGET_VELOCITY),
            EFFORT: self._output(objects.TARGET_TORQUE),
        }
        self._position_pdo = self._position.pdo if self._position is not None else None
        self._since = 0
        for name, present in ((POSITION, self._position), (VELOCITY, self._velocity), (EFFORT, self._effort)):
            if present is None:
                del self.states[name]
        for name in interfaces:
            if self._targets.get(name) is None:
                raise RobotConfigError(
                    f"joint {joint}: no RPDO of {node.name} carries the target of its command interface {name!r}; "
                    f"map 0x{_TARGETS[name]:04X} in bus.yml or drop the interface"
                )

    @property
    def state(self) -> State | None:
        """The CiA 402 state, None while the node is not there."""
        return self.machine.state if self.node.ready and self._statusword.fresh else None

    @property
    def statusword(self) -> int | None:
        """The newest statusword, None before the first."""
        return self._statusword.value if self._statusword.fresh else None

    @property
    def enabled(self) -> bool:
        """Whether the drive follows commands."""
        return self.wish is Wish.ON and self.node.ready and self.machine.may_move

    @property
    def standing(self) -> bool:
        """Whether the drive reports (nearly) no motion; without a velocity it counts as standing."""
        return self._velocity is None or abs(self.scale.velocity_from_device(self._velocity.value)) <= STANDSTILL

    def age_ns(self, now: int) -> int | None:
        """How old the newest statusword is."""
        return self._statusword.age_ns(now)

    def mode_for(self, interface: str) -> OperationMode:
        """Return the mode for a command interface: bus.yml's, else the best the drive lists; or UnsupportedMode."""
        config = self.node.config
        wanted = {POSITION: config.position_mode, VELOCITY: config.velocity_mode, EFFORT: config.effort_mode}[interface]
        modes = self._supported()
        if wanted is None:
            return mode_for_interface(interface, modes)
        if modes:
            require_mode(wanted, modes)
        return OperationMode(wanted)

    def claim(self, interface: str | None) -> None:
        """Let a controller's interface drive the joint, or none; the mode follows."""
        self.claimed = interface
        if interface is not None:
            self.mode = self.mode_for(interface)
            self.machine.set_mode(self.mode)

    def enable(self) -> None:
        """Ask the drive into OPERATION_ENABLED; it follows commands from there. DriveError in a fault."""
        self.machine.enable()
        self.machine.halt(False)
        self.wish = Wish.ON

    def stop(self, now: int) -> None:
        """Ramp to zero, then disable."""
        if self.wish is Wish.ON:
            self.wish, self._since = Wish.STOPPING, now
        elif self.wish is Wish.OFF:
            self.machine.disable()

    def quick_stop(self) -> None:
        """Use the drive's quick stop (0x605A); it is disabled or holds afterwards, as that says."""
        self.wish = Wish.OFF
        self.machine.quick_stop()

    def halt(self) -> None:
        """Hold the motion with the halt bit; `enable` goes on."""
        self.machine.halt(True)

    def fault_reset(self) -> None:
        """Acknowledge a fault; the drive stays disabled. Without a fault nothing changes."""
        if self.machine.fault:
            self.wish = Wish.OFF
        self.machine.fault_reset()

    def give_up(self) -> None:
        """Forget the wish: the drive left on its own, or its node is gone."""
        self.wish = Wish.OFF
        self.machine.disable()

    def read(self) -> None:
        """Latch the newest process data into the state interfaces; nan while the node is not there."""
        if not self.node.ready:
            for state in self.states.values():
                state.value = math.nan
            return
        if self._position is not None and self._position.fresh:
            self.states[POSITION].value = self.scale.position_from_device(self._unwrap.update(self._position.value))
        if self._velocity is not None and self._velocity.fresh:
            # + 0.0: a mirrored drive that stands still has no velocity of -0.0
            self.states[VELOCITY].value = self.scale.velocity_from_device(self._velocity.value) + 0.0
        if self._effort is not None and self._effort.fresh:
            self.states[EFFORT].value = self.scale.effort_from_device(self._effort.value)

    def restarted(self) -> None:
        """Say that the node lost its position counter: the joint goes on where it was."""
        self._unwrap.rebase()

    def write(self, now: int) -> None:
        """Advance the machine by one cycle and set controlword, mode and targets."""
        fresh = self.node.ready and self._statusword.fresh
        if self.wish is Wish.STOPPING and (not fresh or self.standing or now - self._since > STOP_NS):
            self.wish = Wish.OFF
            self.machine.disable()
        self.machine.standstill = self.standing
        word = self.machine.update(
            self._statusword.value if fresh else None, self._display.value if fresh else None, now
        )
        self._controlword.set(word)
        if (mode := self.machine.mode) is not None:
            self._mode.set(int(mode))
        self._write_targets()

    def reached(self, action: Action) -> bool:
        """Whether what was asked for has been done."""
        state = self.state
        if action is Action.ENABLE:
            return self.enabled and self.machine.reached
        if action is Action.HALT:
            return self.standing
        if action is Action.FAULT_RESET:
            return state is not None and state not in _FAULTED
        return state is None or state not in (
            State.OPERATION_ENABLED,
            State.QUICK_STOP_ACTIVE,
            State.FAULT_REACTION_ACTIVE,
        )

    def _write_targets(self) -> None:
        following = self.enabled
        for name, output in self._targets.items():
            if output is None:
                continue
            value = self.commands[name].value if following and name == self.claimed else math.nan
            output.set(self._to_device(name, value))

    def _to_device(self, interface: str, value: float) -> int:
        """Convert a target; without one the target is to stay: the actual position, no velocity, no effort."""
        if not math.isfinite(value):
            if interface == POSITION and self._position is not None:
                return self._position.value
            return 0
        if interface == POSITION:
            return self._unwrap.raw_of(self.scale.position_count(value))
        if interface == VELOCITY:
            return self.scale.velocity_to_device(value)
        return self.scale.effort_to_device(value)

    def _supported(self) -> tuple[OperationMode, ...]:
        identity = self.node.identity
        listed = identity.supported_modes if identity is not None else None
        if listed is None:
            entry = self.node.od.get(objects.axis_index(objects.SUPPORTED_DRIVE_MODES, self.axis), 0)
            listed = entry.value if entry is not None and isinstance(entry.value, int) else 0
        return supported_modes(listed)

    def _input(self, index: int) -> Input | None:
        return self._image.input(self.node.node_id, objects.axis_index(index, self.axis))

    def _output(self, index: int) -> Output | None:
        return self._image.output(self.node.node_id, objects.axis_index(index, self.axis))

    def _need(self, index: int, kind: str) -> Input:
        if (found := self._input(index)) is None:
            raise self._unmapped(index, kind)
        return found

    def _need_output(self, index: int) -> Output:
        if (found := self._output(index)) is None:
            raise self._unmapped(index, "rpdo")
        return found

    def _unmapped(self, index: int, kind: str) -> RobotConfigError:
        name = objects.object_name(objects.axis_index(index, self.axis))
        return RobotConfigError(
            f"joint {self.joint}: no {kind.upper()} of node {self.node.node_id} ({self.node.name}) carries "
            f"0x{index:04X} {name}; map it in bus.yml"
        )


_TARGETS = {POSITION: objects.TARGET_POSITION, VELOCITY: objects.TARGET_VELOCITY, EFFORT: objects.TARGET_TORQUE}


def _scale(node: RemoteNode) -> Scale:
    config = node.config
    return Scale(
        pos_to_dev=config.scale_pos_to_dev,
        pos_from_dev=config.scale_pos_from_dev,
        vel_to_dev=config.scale_vel_to_dev,
        vel_from_dev=config.scale_vel_from_dev,
        eff_from_dev=config.scale_eff_from_dev,
        offset_pos_to_dev=config.offset_pos_to_dev,
        offset_pos_from_dev=config.offset_pos_from_dev,
    )
