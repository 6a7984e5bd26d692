"""Joints that stop together after an error of one, and change power in one SYNC cycle.

An axis of a group is let into OPERATION_ENABLED when every axis that is being enabled stands
before it, and disabled when every axis that is being stopped stands still. All joints of a robot are one group unless
the description says otherwise (`<param name="stop_group">`); a group of one is the policy "single". The joints that a
controller of a base holds are in one group whatever the description says, and move as a whole or not at all.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from canopen_control.hardware.axis_statechart import AxisPhase, PhaseTrigger

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from canopen_control.hardware.axis_statechart import AxisStatechart


class GroupMember(Protocol):
    """Interface of a joint as its stop group uses it."""

    joint: str
    power: AxisStatechart
    group: StopGroup[Any]
    stop_group: StopGroup[Any]
    base: BaseJoints[Any] | None

    @property
    def wanted(self) -> bool:
        """Whether the joint is to follow commands."""

    @property
    def can_enable(self) -> bool:
        """Whether the joint waits only for its group to be enabled."""

    def has_settled(self, now: int) -> bool:
        """Whether a stop may end in disabling the drive."""

    def stop(self, now: int) -> None:
        """Ramp to zero, then disable."""


J = TypeVar("J", bound=GroupMember)


class BaseJoints(Generic[J]):
    """Joints claimed by one base controller; `name` is that of the controller."""

    __slots__ = ("joints", "name")

    def __init__(self, name: str, joints: Sequence[J]) -> None:
        self.name, self.joints = name, joints


class StopGroup(Generic[J]):
    """Joints of one stop group; `busy` while one of them is being enabled or stopped."""

    def __init__(self, name: str = "") -> None:
        self.name = name
        self.joints: list[J] = []
        self.busy = False

    def stop(self, now: int) -> list[J]:
        """Ramp every joint to zero, then disable; return the joints that were to move."""
        moving = [joint for joint in self.joints if joint.wanted]
        for joint in self.joints:
            joint.stop(now)
        return moving

    def coordinate(self, now: int) -> None:
        """Fire group transitions in the chart of each joint; call once per cycle while `busy`."""
        waiting = [joint for joint in self.joints if joint.power.state is AxisPhase.RISING]
        if waiting and all(joint.can_enable for joint in waiting):
            self._fire(PhaseTrigger.GROUP_MAY_RISE, now)
        rising = any(joint.power.rising for joint in self.joints)
        self._fire(PhaseTrigger.GROUP_RISES if rising else PhaseTrigger.GROUP_ENABLED, now)
        falling = [joint for joint in self.joints if joint.power.falling]
        if falling and all(joint.has_settled(now) for joint in falling):
            self._fire(PhaseTrigger.GROUP_RESTS, now)
        self.busy = rising or any(joint.power.falling for joint in falling)

    def _fire(self, trigger: PhaseTrigger, now: int) -> None:
        for joint in self.joints:
            joint.power.fire(trigger, now)


def regroup(joints: Iterable[J], bases: Mapping[str, Collection[str]], now: int) -> None:
    """Assign joints to the base controllers that claim them, and merge their stop groups.

    A base of which only a part is enabled, or on its way to be, is stopped.
    """
    joints = list(joints)
    bases_held = [
        BaseJoints(name, [joint for joint in joints if joint.joint in names]) for name, names in bases.items()
    ]
    sets: list[set[StopGroup[J]]] = []
    for base in bases_held:
        touched = {joint.stop_group for joint in base.joints}
        for overlapping in [members for members in sets if members & touched]:
            sets.remove(overlapping)
            touched |= overlapping
        sets.append(touched)
    merged: dict[StopGroup[J], StopGroup[J]] = {}
    for members in sets:
        if len(members) > 1:
            merged.update(dict.fromkeys(members, _merged(members, joints)))
    for joint in joints:
        joint.base = next((base for base in bases_held if joint in base.joints), None)
        _move(joint, merged.get(joint.stop_group, joint.stop_group))
    for base in bases_held:
        enabled = [joint for joint in base.joints if joint.wanted]
        if len(enabled) < len(base.joints):
            for joint in enabled:
                joint.stop(now)


def _merged(groups: set[StopGroup[J]], joints: Iterable[J]) -> StopGroup[J]:
    """Return the merged group of several, reusing an equal one."""
    members = [joint for joint in joints if joint.stop_group in groups]
    if members[0].group.joints == members:
        return members[0].group
    merged: StopGroup[J] = StopGroup(", ".join(sorted(group.name for group in groups)))
    merged.joints = members
    return merged


def _move(joint: J, group: StopGroup[J]) -> None:
    if joint.group is not group:
        joint.group = group
        group.busy = True
