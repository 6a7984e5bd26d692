"""One axis of a drive as process data: its inputs, outputs, scale and limits, whichever PDOs carry them.

The law of this file: an object is found once, by its index of axis 0, for the axis that is meant; what no PDO carries
is None here and travels by SDO or not at all. Limits are in device units and are those of the drive itself (0x607D,
0x607F, 0x6080, 0x60E0, 0x60E1), and the velocity limit of the description: a target is brought inside them before it is
sent, in every mode.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.drive import DriveMachine
from canopen_control.cia402.units import INT32_MAX, INT32_MIN, PositionUnwrapper, Scale
from canopen_control.errors import RobotConfigError

if TYPE_CHECKING:
    from canopen_control.master.cycle import Input, Output, ProcessImage
    from canopen_control.master.remote_node import RemoteNode

__all__ = ["Axis", "AxisLimits", "configured_machine", "configured_scale"]

TORQUE_MAX: Final = (1 << 15) - 1
HELD: Final = 1.01  # a target that is slowed down by less than this is rounded, not held back
_POSITIONS: Final = (objects.TARGET_POSITION, objects.INTERPOLATION_DATA)
_TARGETS: Final = (
    (objects.TARGET_POSITION, 0),
    (objects.TARGET_VELOCITY, 0),
    (objects.TARGET_TORQUE, 0),
    (objects.VL_TARGET_VELOCITY, 0),
    (objects.INTERPOLATION_DATA, 1),
)


class AxisLimits:
    """What the drive allows, in its own units; `deceleration` in units/s^2 is what a ramp of the master uses.

    `blocked` is the direction, 1 or -1, that an active limit (bit 11) closes, 0 for none. `described` is the velocity
    limit of the description, or a lower one of this run, in rad/s (m/s) of the axis, infinite where there is none;
    `words` is what it is called. What holds is the smaller of that and of the drive's `velocity`: `most` in velocity
    units, `pace` in position counts per s. `held` says that a target had to be slowed down since that was looked at
    last. `ramp_unbounded`: the drive's own ramp of PP is not known to be within `described`.
    """

    __slots__ = (
        "blocked",
        "deceleration",
        "described",
        "held",
        "high",
        "low",
        "most",
        "pace",
        "ramp_unbounded",
        "torque_negative",
        "torque_positive",
        "velocity",
        "words",
    )

    def __init__(self) -> None:
        self.low, self.high = INT32_MIN, INT32_MAX
        self.velocity = self.most = self.pace = float(INT32_MAX)
        self.described = math.inf
        self.words = "the velocity limit of the description"
        self.held = self.ramp_unbounded = False
        self.torque_positive = self.torque_negative = TORQUE_MAX
        self.deceleration = math.inf
        self.blocked = 0

    def take_velocity(self, velocity: float, scale: Scale) -> None:
        """Take the drive's largest velocity, in its units, and find what holds of it and of the description's."""
        self.velocity = velocity
        self.most = min(velocity, self.described * abs(scale.vel_to_dev))
        self.pace = self.most * abs(scale.pos_to_dev / scale.vel_to_dev)

    def lower(self, speed: float, words: str) -> None:
        """Bound what is `described` to a lower speed, in rad/s of the axis; it holds after the next `take_velocity`."""
        if speed < self.described:
            self.described, self.words = speed, words

    def of_velocity(self, raw: int) -> int:
        """Return a velocity that the drive will take."""
        return self.within(raw, self.most)

    def within(self, raw: int, most: float) -> int:
        """Return a velocity within `most`, both in the same units, that no active limit forbids."""
        if raw * self.blocked > 0:
            return 0
        if -most <= raw <= most:
            return raw
        self.held = self.held or abs(raw) > most * HELD
        return int(most) if raw > 0 else -int(most)

    def of_torque(self, raw: int) -> int:
        """Return a torque that the drive will take."""
        if raw * self.blocked > 0:
            return 0
        return max(-self.torque_negative, min(self.torque_positive, raw))

    def of_position(self, raw: int) -> int:
        """Return a position inside the software limits (0x607D)."""
        return max(self.low, min(self.high, raw))


class Axis:
    """The process data of axis `number` of `node`; raises RobotConfigError without controlword or statusword."""

    def __init__(self, joint: str, node: RemoteNode, image: ProcessImage, number: int) -> None:
        self.joint, self.node, self.number = joint, node, number
        self._image = image
        self.scale = configured_scale(node, number)
        self.unwrap = PositionUnwrapper()
        self.limits = AxisLimits()
        self.rpm_to_dev = 60.0 / math.tau  # mode VL: 0x6042 counts revolutions of the motor per minute
        self.turn = abs(self.scale.pos_to_dev) * math.tau  # position counts of one of the motor, else of the joint
        self.who = node.who if len(node.plan.axes) <= 1 else f"{node.who}, {joint}"
        """The node, as every message has it, and of one with several axes the joint."""
        self.misfit = math.nan  # the target that did not fit its object, nan while the last one did
        self.statusword = self._need_input(objects.STATUSWORD)
        self.controlword = self._need_output(objects.CONTROLWORD)
        self.display = self.input(objects.MODES_OF_OPERATION_DISPLAY)
        self.mode = self.output(objects.MODES_OF_OPERATION)
        self.position = self.input(objects.POSITION_ACTUAL)
        self.velocity = self.input(objects.VELOCITY_ACTUAL)
        self.effort = self.input(objects.TORQUE_ACTUAL)
        self.error_code = self.input(objects.ERROR_CODE)
        self.digital_inputs = self.input(objects.DIGITAL_INPUTS)
        self.digital_outputs = self.output(objects.DIGITAL_OUTPUTS, 1)
        self.velocity_offset = self.output(objects.VELOCITY_OFFSET)
        self.torque_offset = self.output(objects.TORQUE_OFFSET)

        self._targets = [(index, sub, out) for index, sub in _TARGETS if (out := self.output(index, sub)) is not None]
        offsets = self.velocity_offset, self.torque_offset
        for moving in (self.controlword, self.mode, *offsets, *(out for _, _, out in self._targets)):
            if moving is not None:
                moving.drive()

        feedback = (self.statusword, self.position, self.velocity)
        self._feedback = tuple({each.pdo: None for each in feedback if each is not None})

    @property
    def is_stale(self) -> bool:
        """Whether a TPDO that control depends on stays away."""
        return any(pdo.overdue for pdo in self._feedback)

    def hold(self, raw: int) -> None:
        """Let every target be standstill at the raw position."""
        for index, _, output in self._targets:
            output.set(raw if index in _POSITIONS else 0)

    def hold_others(self, used: Output) -> None:
        """Let the targets of modes that are not used follow the motion of the one that is, `used`."""
        raw = self.raw_position
        for index, _, output in self._targets:
            if output is not used:
                output.set(raw if index in _POSITIONS else 0)

    @property
    def raw_position(self) -> int:
        """The newest 0x6064; 0 where none is known."""
        position = self.position
        if position is None or position.pdo.stamp < 0:
            return 0
        return position.pdo.values[position.position]  # type: ignore[return-value]  # as `Input.value`, without a call

    def index(self, index: int) -> int:
        """Return the index of a profile object for this axis."""
        return objects.axis_index(index, self.number)

    def input(self, index: int, subindex: int = 0) -> Input | None:
        """Return the input of a profile object, None if no TPDO carries it."""
        return self._image.input(self.node.node_id, self.index(index), subindex)

    def output(self, index: int, subindex: int = 0) -> Output | None:
        """Return the output of a profile object, None if no RPDO carries it."""
        return self._image.output(self.node.node_id, self.index(index), subindex)

    def has(self, index: int, subindex: int = 0) -> bool:
        """Whether the EDS lists a profile object for this axis."""
        return (self.index(index), subindex) in self.node.od

    def _need_input(self, index: int) -> Input:
        if (found := self.input(index)) is None:
            raise self._unmapped(index, "TPDO")
        return found

    def _need_output(self, index: int) -> Output:
        if (found := self.output(index)) is None:
            raise self._unmapped(index, "RPDO")
        return found

    def _unmapped(self, index: int, kind: str) -> RobotConfigError:
        name = objects.object_name(self.index(index))
        return RobotConfigError(
            f"joint {self.joint}: no {kind} of {self.node.who} carries "
            f"0x{self.index(index):04X} {name}; map it in bus.yml"
        )


def configured_machine(node: RemoteNode) -> DriveMachine:
    """Return the state machine of an axis, with the times that bus.yml gives."""
    motion = node.config.motion
    return DriveMachine(
        node.name,
        transition_timeout_ns=motion.transition_timeout_ms * 1_000_000,
        transition_timeouts={number: ms * 1_000_000 for number, ms in motion.transition_timeouts_ms.items()},
        ignore_remote=motion.ignore_remote,
    )


def configured_scale(node: RemoteNode, axis: int) -> Scale:
    """Return the scale that bus.yml gives."""
    return Scale(**node.config.units.of_axis(axis))
