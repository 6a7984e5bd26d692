"""Whether a trajectory is taken: upstream's rules, then what the joints and the objects behind them can bear.

The law of the file: it is judged outside of the cycle, by what its points came to as they arrived (`survey`), so that
its length costs the moment of the answer nothing.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.trajectory.point import whole_turns
from canopen_control.controllers.trajectory.point_limiter import PointLimiter
from canopen_control.controllers.trajectory.validation import (
    JointLimits,
    Refused,
    Rules,
    beyond,
    broken_rule,
    far_start,
    lost_start,
    survey_of,
    unreachable,
)
from canopen_control.hardware.interfaces import POSITION

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.controllers.trajectory.joint_group import JointGroup
    from canopen_control.controllers.trajectory.params import TrajectoryParams
    from canopen_control.controllers.trajectory.point import JointTrajectory
    from canopen_control.controllers.trajectory.survey import Survey
    from canopen_control.urdf.joint_element import Joint

__all__ = ["Acceptance"]

_NEXT: Final = 20_000_000
"""By then a trajectory has been taken up, in ns: two cycles at 100 Hz."""


class Acceptance:
    """Judges trajectories for a group of joints; `limits` are those of the description and of the interfaces."""

    def __init__(self, params: TrajectoryParams, group: JointGroup, description: Mapping[str, Joint]) -> None:
        self.limits = {each: _limits_of(_joint_of(each, description)) for each in params.joints}
        self._params, self._group = params, group

    @property
    def continuous(self) -> list[bool]:
        """Which joints turn without end."""
        return [self.limits[each].continuous for each in self._params.joints]

    def take_params(self, params: TrajectoryParams) -> None:
        """Judge by other parameters."""
        self._params = params

    def cannot_brake(self) -> str | None:
        """Say why `decelerate_on_cancel` has no effect, None if it has, or is not wanted."""
        given = self._params
        if not given.decelerate_on_cancel:
            return None
        lacks = None
        if not self._group.knows_velocity:
            lacks = "state_interfaces have no velocity; add it"
        for joint, constraints in zip(given.joints, given.constraints, strict=True):
            if not constraints.max_deceleration_on_cancel:
                lacks = lacks or f"{joint} has no constraints.{joint}.max_deceleration_on_cancel; give it"
            if self.limits[joint].velocity == math.inf:
                lacks = lacks or f"the description has no velocity limit of {joint}; give it"
        return (
            None if lacks is None else f"decelerate_on_cancel has no effect, what is cancelled is held at once: {lacks}"
        )

    def point_limiter(self) -> PointLimiter | None:
        """Return what keeps each point within the limits, None where none is wanted."""
        if not self._params.joint_limiter_type:
            return None
        pairs = zip(self.limits.values(), self._params.joint_limits, strict=True)
        return PointLimiter([given.hard(known.lower, known.upper, known.velocity) for known, given in pairs])

    def take_limits(self) -> None:
        """Take the limits that the hardware interfaces know beside the description's.

        A joint whose positions are bounded by its interface does not turn without end, whatever its type.
        """
        for index, command in enumerate(self._group.commands.get(POSITION, ())):
            joint = self._params.joints[self._group.places[index]]
            known = self.limits[joint]
            lower, upper = max(known.lower, command.minimum), min(known.upper, command.maximum)
            endless = known.continuous and math.isinf(command.minimum) and math.isinf(command.maximum)
            self.limits[joint] = JointLimits(lower, upper, known.velocity, endless)

    def mistake(self, message: JointTrajectory, now: int, begin: Sequence[float]) -> Refused | None:
        """Say why a trajectory is refused, None if it is taken.

        `now` in ns; `begin` are the positions of the joints from which it would lead on.
        """
        given, survey = self._params, survey_of(message)
        rules = Rules(
            given.joints,
            given.allow_partial_joints_goal,
            given.allow_nonzero_velocity_at_trajectory_end,
            given.allow_integration_in_goal_trajectories,
            self._group.has_effort,
        )
        if (refused := broken_rule(message, survey, rules, now)) is not None:
            return refused
        here = dict(zip(given.joints, begin, strict=True))
        unbearable = (
            beyond(message, survey, self.limits)
            or lost_start(message, now + _NEXT)
            or far_start(message, here, self.limits, given.allowed_start_tolerance)
            or (self._unreachable(message) if given.unreachable_points == "refuse" else None)
            or self._misfit(message, survey, here)
        )
        return None if unbearable is None else Refused(None, unbearable)

    def doubt(self, message: JointTrajectory) -> str | None:
        """Say what of a trajectory that is taken the joints cannot do, where that is to be told, else None."""
        return self._unreachable(message) if self._params.unreachable_points == "warn" else None

    def _unreachable(self, message: JointTrajectory) -> str | None:
        """Say which point a joint cannot reach in time; a limiter of points is there for those."""
        return None if self._params.joint_limiter_type else unreachable(message, survey_of(message), self.limits)

    def _misfit(self, message: JointTrajectory, survey: Survey, here: Mapping[str, float]) -> str | None:
        """Say which position the object behind a command cannot hold, None if it holds all.

        A joint that turns without end goes there on the turn on which it is.
        """
        joints, group = self._params.joints, self._group
        for index, command in enumerate(group.commands.get(POSITION, ())):
            joint = joints[group.places[index]]
            if joint not in message.joint_names or not survey.positions.ranges:
                continue
            place = message.joint_names.index(joint)
            first = message.points[0].positions if self.limits[joint].continuous else ()
            turns = whole_turns(here[joint], first[place]) if place < len(first) else 0.0
            for value in (survey.positions.lowest[place], survey.positions.highest[place]):
                if (fits := command.misfit(value + turns)) is not None:
                    return f"it leads {joint} to {value:g}, and {fits}; plan within that"
        return None


def _joint_of(name: str, description: Mapping[str, Joint]) -> Joint | None:
    """Return a joint of the description, also by the name that a controller exports it under: "loops/joint_1"."""
    return description.get(name) or description.get(name.rpartition("/")[2])


def _limits_of(joint: Joint | None) -> JointLimits:
    if joint is None:
        return JointLimits()
    limits = joint.limits
    return JointLimits(limits.lower, limits.upper, limits.speed, joint.type == "continuous")
