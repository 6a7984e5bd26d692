"""Record of the last disturbance of each node, for invariants that skip disturbed nodes.

A disturbance is a fault, a stall, a lost or foreign frame, or the absence of the robot. Invariants that compare reports
with the truth skip disturbed nodes: a drive that lost a frame does not have its target, and a drive with a broken
encoder reports wrong positions. Times are in ns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from canopen_control.simulation.robot_under_test import RobotUnderTest, SimulatedDrive
    from canopen_control.simulation.scenario_events import ScenarioEvent
    from canopen_control.simulation.wire_view import ObservedNode


_CALM_NS: Final = 1_000_000_000
_OF_ALL: Final = ("frame", "kill", "lose", "double", "disturb", "bus_off", "cut", "stall")
_OF_ONE: Final = ("fault", "heal", "plant", "power")
_WRAPS: Final = "position_wrap"  # fault that sets the count near the end of its 32 bits, where it then wraps


class DisturbedNodes:
    """Times of the last disturbance of each node.

    `hidden_at` is the last time at which any node could not receive or answer, because of a bus, foreign frames, or the
    robot; `deaf_at` is the same without foreign frames. `moved(node_id)` is the last time at which a shaft may have
    moved without a command of its drive.
    """

    def __init__(self, robot: RobotUnderTest) -> None:
        self._robot = robot
        self._last = dict.fromkeys(robot.drives, 0)
        self._moved = dict.fromkeys(robot.drives, 0)
        self._put = dict.fromkeys(robot.drives, 0)
        self.hidden_at = self.deaf_at = 0

    def moved(self, node_id: int) -> int:
        """Return the last time at which the count changed other than by a motion of the drive, or 0 for never."""
        return self._moved[node_id]

    def put(self, node_id: int) -> int:
        """Return the last time at which a fault set the count near its 32-bit limit, or 0 for never."""
        return self._put[node_id]

    def last(self, node_id: int) -> int:
        """Return the time of the last disturbance of the node, its bus or the robot, or 0 for never."""
        return self._last[node_id]

    def is_calm(self, view: ObservedNode, now: int) -> bool:
        """Whether a node has run undisturbed for a second, since its boot and the start of the robot."""
        return max(self._last[view.node_id], view.booted_at, self._robot.started_ns) < now - _CALM_NS

    def troubled(self, now: int, act: ScenarioEvent) -> None:
        """Record the start of an event if it is a fault or sets values of the plant."""
        if act.kind in _OF_ALL:
            self._disturb_all(now)
            if act.kind != "frame":
                self.deaf_at = now
        elif act.kind in _OF_ONE:
            self._last[int(act.target)] = now
            (self._put if act.name == _WRAPS else self._moved)[int(act.target)] = now

    def sampled(self, now: int) -> None:
        """Record all disturbances that exist at `now`."""
        robot = self._robot
        if not robot.up or now < robot.host.stalled_until:
            self._disturb_all(now)
            self.deaf_at = now
            return
        for node_id, drive in robot.drives.items():
            if drive.wire.has_wire_faults:  # including disconnected drives
                self.hidden_at = self.deaf_at = now
            if self.hidden_at == now or _is_disturbed(drive, now):
                self._last[node_id] = now
            if drive.device is None or drive.device.filter is not None:
                self._moved[node_id] = now

    def _disturb_all(self, now: int) -> None:
        self._last = dict.fromkeys(self._last, now)
        self.hidden_at = now


def _is_disturbed(drive: SimulatedDrive, now: int) -> bool:
    """Whether a drive has no supply, an active fault, or a stalled process."""
    device, actor = drive.device, drive.actor
    return device is None or actor is None or now < actor.stalled_until or device.filter is not None
