"""State and command interfaces of a trajectory controller's joints, and their PID loops.

If only velocities or only efforts are commanded, they are the output of a PID loop for each joint.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from canopen_control.controllers.pid import Pid
from canopen_control.controllers.trajectory.point import Point, shortest_angular_distance
from canopen_control.urdf.joint_element import ACCELERATION, EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.trajectory.params import JointGains
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface


class JointGroup:
    """Joints of a trajectory controller with their interfaces by quantity.

    `actual` is the state that was read last, `error` the desired state minus `actual`.
    """

    def __init__(
        self, joints: Sequence[str], commanded: Sequence[str], commands: Sequence[str], states: Sequence[str]
    ) -> None:
        self.joints, self.commanded = tuple(joints), tuple(commanded)
        self.command_names = [f"{joint}/{command}" for joint in commanded for command in commands]
        self.state_names = [f"{joint}/{state}" for joint in joints for state in states]
        same = len(commanded) == len(joints)
        self.places = [index if same else joints.index(joint) for index, joint in enumerate(commanded)]
        self._kinds, self._read = tuple(commands), tuple(states)
        self.has_position, self.has_velocity = POSITION in commands, VELOCITY in commands
        self.has_acceleration, self.has_effort = ACCELERATION in commands, EFFORT in commands
        self._all = all(joint in commanded for joint in joints) or same
        count = len(joints)
        self.knows_velocity = VELOCITY in states
        self.knows_acceleration = self.knows_velocity and ACCELERATION in states
        self._velocity_counts = self.knows_velocity and (self.has_velocity or self.has_effort)
        self._acceleration_counts = self.knows_acceleration and self.has_acceleration
        self.actual, self.error = self.blank(), Point([0.0] * count, [0.0] * count, [0.0] * count)
        self.wrap = [False] * count
        self.commands: dict[str, list[CommandInterface]] = {}
        self._states: dict[str, list[StateInterface]] = {}
        self.set_interfaces([], [])

    def blank(self) -> Point:
        """Return a point of zeros, with all quantities that have state interfaces."""
        zeros = [0.0] * len(self.joints)
        return Point(zeros, zeros if self.knows_velocity else (), zeros if self.knows_acceleration else ())

    def set_interfaces(self, commands: Sequence[CommandInterface], states: Sequence[StateInterface]) -> None:
        """Store the interfaces, in the order of `command_names` and `state_names`."""
        self.commands = {kind: [one for one in commands if one.interface == kind] for kind in self._kinds}
        self._states = {kind: [one for one in states if one.interface == kind] for kind in self._read}
        self._positions = self._states.get(POSITION, [])
        self._velocities = self._states.get(VELOCITY, []) if self.knows_velocity else []
        self._accelerations = self._states.get(ACCELERATION, []) if self.knows_acceleration else []
        self._every = [one for kind in self._kinds for one in self.commands[kind]]
        self._efforts = self.commands.get(EFFORT, [])
        self._targets = self.commands.get(POSITION, [])

    def read(self) -> None:
        """Read the states into `actual`; the actual effort is the commanded effort."""
        actual = self.actual
        _copy(self._positions, actual.positions)
        _copy(self._velocities, actual.velocities)
        _copy(self._accelerations, actual.accelerations)
        if self._efforts and self._all:
            if len(actual.effort) != len(self._efforts):
                actual.effort[:] = [0.0] * len(self._efforts)
            for index in range(len(self._efforts)):
                actual.effort[index] = self._efforts[index].value

    def begin_with_commands(self) -> None:
        """Replace actual values with commanded values, for each quantity whose commands are all finite."""
        if not self._all:
            return
        for kind, values in (
            (POSITION, self.actual.positions),
            (VELOCITY, self.actual.velocities),
            (ACCELERATION, self.actual.accelerations),
            (EFFORT, self.actual.effort),
        ):
            commanded = [command.value for command in self.commands.get(kind, ())]
            if commanded and all(math.isfinite(value) for value in commanded):
                values[:] = commanded

    def waits_for(self) -> str | None:
        """Return a joint that is disabled or has an unknown position, or None."""
        for state in self._positions:
            value = state.value
            if value - value != 0.0:  # is not finite
                return state.joint
        for command in self._every:
            if not command.enabled:
                return command.joint
        return None

    def compare(self, desired: Point) -> None:
        """Write the errors between desired and actual state to `error`."""
        error, actual, wrap, joints = self.error, self.actual, self.wrap, len(self.joints)
        off, measured, targets = error.positions, actual.positions, desired.positions
        for i in range(min(joints, len(targets))):
            off[i] = shortest_angular_distance(measured[i], targets[i]) if wrap[i] else targets[i] - measured[i]
        if self._velocity_counts:
            for i in range(min(joints, len(desired.velocities))):
                error.velocities[i] = desired.velocities[i] - actual.velocities[i]
        if self._acceleration_counts:
            for i in range(min(joints, len(desired.accelerations))):
                error.accelerations[i] = desired.accelerations[i] - actual.accelerations[i]

    def write(self, kind: str, values: Sequence[float]) -> None:
        """Write the values of one quantity to the command interfaces, unless `values` is empty."""
        commands, places = self.commands[kind], self.places
        if not values:
            return
        for index in range(len(commands)):
            commands[index].value = values[places[index]]

    def release(self) -> None:
        """Clear the commands: positions are held by the hardware, other targets become 0.0."""
        for kind in self._kinds:
            for command in self.commands[kind]:
                command.value = math.nan if kind == POSITION else 0.0

    def targets(self) -> list[float]:
        """Return the commanded position of each joint; nan if not commanded."""
        positions = [math.nan] * len(self.joints)
        for index, target in enumerate(self._targets):
            positions[self.places[index]] = target.value
        return positions


class Loops:
    """PID loops of the commanded joints; `joints` are their indices in the trajectory."""

    def __init__(self, gains: Sequence[JointGains], joints: Sequence[int], *, with_effort: bool) -> None:
        self._joints, self._with_effort = list(joints), with_effort
        self._pids = [Pid(gains[joint].pid()) for joint in joints]
        self._forward = [gains[joint].ff_velocity_scale for joint in joints]

    def set_gains(self, gains: Sequence[JointGains]) -> None:
        """Replace the gains and feed-forward factors; the integrals are kept."""
        for index, joint in enumerate(self._joints):
            self._pids[index].set_gains(gains[joint].pid())
            self._forward[index] = gains[joint].ff_velocity_scale

    def reset(self) -> None:
        """Reset all loops, including their integrals."""
        for pid in self._pids:
            pid.reset()

    def compute(self, index: int, desired: Point, error: Point, period: float) -> float:
        """Return the sum of feed-forward and loop output for commanded joint `index`; `period` is in s."""
        joint = self._joints[index]
        forward = self._forward[index] * desired.velocities[joint] if joint < len(desired.velocities) else 0.0
        if self._with_effort and joint < len(desired.effort):
            forward += desired.effort[joint]
        return forward + self._pids[index].compute_with_rate(error.positions[joint], error.velocities[joint], period)


def _copy(states: Sequence[StateInterface], values: list[float]) -> None:
    for index in range(len(states)):
        values[index] = states[index].value
