"""Enables a group again whose stop was caused by a node that is here again, where bus.yml says so.

The law of this file: only joints that were enabled when the stop came, only after a lost node whose `recovery` is
`enable`, and only when every joint of the group can go: nodes ready, parameters read, no fault, standing still. A
user's word in between (a stop, a disable, a quick stop) ends the matter.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.errors import DriveError
from canopen_control.hardware.axis_power import STOPPED
from canopen_control.master.event_log import Event, Level

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.hardware.joint import JointDrive

__all__ = ["Recovery", "enable_together"]


def enable_together(joints: Sequence[JointDrive], now: int, report: Callable[[Event], None]) -> None:
    """Enable joints, and tell why one cannot be; those of its group then stay off as well, since none moves alone."""
    refused: list[JointDrive] = []
    for joint in joints:
        joint.resume = False
        try:
            joint.enable()
        except DriveError as error:
            refused.append(joint)
            report(Event(now, "not_enabled", joint.node.name, str(error), Level.ERROR))
    for cause in refused:
        others = [joint for joint in joints if joint.group is cause.group and joint.wanted]
        for joint in others:
            joint.stop(now)
        if others:
            names = ", ".join(joint.joint for joint in others)
            text = f"{names} stay disabled with {cause.joint} ({cause.node.name})"
            report(Event(now, "not_enabled", cause.node.name, text, Level.ERROR))


class Recovery:
    """Watches the joints that wait to be enabled again."""

    def __init__(self, joints: Sequence[JointDrive], report: Callable[[Event], None]) -> None:
        self._joints, self._report = joints, report

    def step(self, now: int) -> None:
        """Enable what waits and can go; a few times a second is enough."""
        waiting = [joint for joint in self._joints if joint.resume]
        for joint in waiting:
            if joint.resume and all(_can_go(other) for other in joint.group.joints if other.resume):
                self._resume([other for other in joint.group.joints if other.resume], now)

    def _resume(self, joints: Sequence[JointDrive], now: int) -> None:
        names = ", ".join(joint.joint for joint in joints)
        text = f"enabling {names} again, as bus.yml says (recovery: enable)"
        self._report(Event(now, "recovered", joints[0].node.name, text, Level.WARNING))
        enable_together(joints, now, self._report)


def _can_go(joint: JointDrive) -> bool:
    return (
        joint.power.state in STOPPED
        and joint.node.ready
        and joint.parameters.loaded
        and joint.state is not None
        and not joint.machine.fault
        and joint.machine.reached
        and joint.standing
    )
