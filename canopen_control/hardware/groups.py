"""Joints that stop together: trouble at one of them is trouble of all, and they change power in one SYNC cycle.

The law of this file: an axis of a group is let into OPERATION_ENABLED when every axis that is being enabled stands
before it, and disabled when every axis that is being stopped stands still. All joints of a robot are one group unless
the description says otherwise (`<param name="stop_group">`); a group of one is the policy "single".
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_control.hardware.joint import JointDrive

__all__ = ["StopGroup"]


class StopGroup:
    """The joints of one group; `busy` says that some are on their way up or down.

    `open` says that none is on its way up; only then targets are followed, so that no wheel turns alone.
    """

    def __init__(self, name: str = "") -> None:
        self.name = name
        self.joints: list[JointDrive] = []
        self.busy = False
        self.open = True

    def stop(self, now: int) -> list[JointDrive]:
        """Ramp every joint to zero, then disable; return those that were to move."""
        moving = [joint for joint in self.joints if joint.wanted]
        for joint in self.joints:
            joint.stop(now)
        return moving

    def coordinate(self, now: int) -> None:
        """Let through together what has come as far as it may alone; call it once per cycle while `busy`."""
        rising = [joint for joint in self.joints if joint.rising]
        held = [joint for joint in rising if joint.machine.held]
        if held and all(joint.may_rise for joint in held):
            for joint in held:
                joint.machine.hold(False)
        self.open = not rising
        falling = [joint for joint in self.joints if joint.falling]
        if falling and all(joint.has_come_to_rest(now) for joint in falling):
            for joint in falling:
                joint.switch_off()
        self.busy = bool(rising or falling)
