"""The way back: a group whose stop was caused by a node that is here again is enabled again, where bus.yml says so.

The law of this file: only joints that were enabled when the stop came, only after a lost node whose `recovery` is
`enable`, and only when every joint of the group can go: nodes ready, parameters read, no fault, standing still. A
user's word in between (a stop, a disable, a quick stop) ends the matter.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.errors import DriveError
from canopen_control.hardware.wishes import Wish
from canopen_control.master.events import Event, Level

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.hardware.joint import JointDrive

__all__ = ["Recovery"]


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
        for joint in joints:
            joint.resume = False
            try:
                joint.enable()
            except DriveError as error:
                self._report(Event(now, "not_enabled", joint.node.name, str(error), Level.ERROR))


def _can_go(joint: JointDrive) -> bool:
    return (
        joint.wish is Wish.OFF
        and joint.node.ready
        and joint.parameters.loaded
        and joint.state is not None
        and not joint.machine.fault
        and joint.machine.reached
        and joint.standing
    )
