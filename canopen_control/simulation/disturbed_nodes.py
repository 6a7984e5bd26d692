"""When each node was disturbed last: by a fault, a stall, a loss on its bus, a stranger's frame, or without a robot.

Rules that hold what is told against what is judge nobody who is disturbed: a drive that has lost a frame does not know
its target, and one whose encoder is broken tells no truth. Times in ns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from canopen_control.simulation.robot_under_test import RobotUnderTest, SimulatedDrive
    from canopen_control.simulation.scenario_events import ScenarioEvent


_OF_ALL: Final = ("frame", "kill", "lose", "double", "disturb", "bus_off", "cut", "stall")
_OF_ONE: Final = ("fault", "heal", "plant", "power")
_WRAPS: Final = "position_wrap"  # puts a count before the end of its 32 bits, over which it goes on


class DisturbedNodes:
    """Knows `last(node_id)`; `troubled` hears each act that breaks something, `sampled` is called as time passes.

    `hidden_at` is when somebody could last not hear or answer who is well: a bus, a stranger on it, or the robot;
    `deaf_at` likewise, strangers apart. `moved(node_id)` is when something may last have moved a shaft past its drive.
    """

    def __init__(self, robot: RobotUnderTest) -> None:
        self._robot = robot
        self._last = dict.fromkeys(robot.drives, 0)
        self._moved = dict.fromkeys(robot.drives, 0)
        self._put = dict.fromkeys(robot.drives, 0)
        self.hidden_at = self.deaf_at = 0

    def moved(self, node_id: int) -> int:
        """Return when a count may last have become another one without a motion, 0: never."""
        return self._moved[node_id]

    def put(self, node_id: int) -> int:
        """Return when a count was last put before the end of its 32 bits, which is a jump itself, 0: never."""
        return self._put[node_id]

    def last(self, node_id: int) -> int:
        """Return when the node, its bus or the robot was disturbed last, 0: never."""
        return self._last[node_id]

    def troubled(self, now: int, act: ScenarioEvent) -> None:
        """Take an act that begins; other acts than troubles disturb nobody."""
        if act.kind in _OF_ALL:
            self._disturb_all(now)
            if act.kind != "frame":
                self.deaf_at = now
        elif act.kind in _OF_ONE:
            self._last[int(act.target)] = now
            (self._put if act.name == _WRAPS else self._moved)[int(act.target)] = now

    def sampled(self, now: int) -> None:
        """Take what is disturbed now."""
        robot = self._robot
        if not robot.up or now < robot.host.stalled_until:
            self._disturb_all(now)
            self.deaf_at = now
            return
        for node_id, drive in robot.drives.items():
            if drive.wire.tampered:  # whoever is cut off, too
                self.hidden_at = self.deaf_at = now
            if self.hidden_at == now or _is_disturbed(drive, now):
                self._last[node_id] = now
            if drive.device is None or drive.device.filter is not None:
                self._moved[node_id] = now

    def _disturb_all(self, now: int) -> None:
        self._last = dict.fromkeys(self._last, now)
        self.hidden_at = now


def _is_disturbed(drive: SimulatedDrive, now: int) -> bool:
    """Whether a drive has no supply, a fault is on in it, or it gets no processor."""
    device, actor = drive.device, drive.actor
    return device is None or actor is None or now < actor.stalled_until or device.filter is not None
