"""The parameters of joint_trajectory_controller/JointTrajectoryController, of jazzy and rolling.

The law of the file: what is read of `gains.<joint>` and `constraints.<joint>` is known for the joints of the
controller and for no others.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, cast

from canopen_control.controllers.params import CommonParams
from canopen_control.controllers.standard_params import LoopGains
from canopen_control.controllers.trajectory.interfaces import (
    wrong_commands,
    wrong_joints,
    wrong_states,
    wrong_together,
)
from canopen_control.controllers.trajectory.tolerances import SegmentTolerances, StateTolerance
from canopen_control.urdf.joint_element import HardLimits
from canopen_control.yamlfile.convert import derived, setting

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.controllers.params import Params

__all__ = [
    "OLD_KEYS",
    "POINT_LIMITER",
    "JointConstraints",
    "JointGains",
    "LimitParams",
    "TrajectoryParams",
    "read_params",
]

POINT_LIMITER: Final = "joint_limits/JointTrajectoryPointSaturationLimiter"


@dataclass(frozen=True)
class JointGains(LoopGains):
    """The gains of the loop over one joint, where velocity or effort alone is commanded; `i_clamp` is deprecated."""

    ff_velocity_scale: float = 0.0
    i_clamp: float = math.inf

    @property
    def integral_limits(self) -> tuple[float, float]:
        """The most and the least of the integral; `i_clamp` stands for those that are not given."""
        high, low, both = self.i_clamp_max, self.i_clamp_min, abs(self.i_clamp)
        return high if math.isfinite(high) else both, low if math.isfinite(low) else -both


@dataclass(frozen=True)
class JointConstraints:
    """How far a joint may be off on the way and at the end, and how it may brake: rad, rad/s2 (m); 0 is none."""

    trajectory: float = 0.0
    goal: float = 0.0
    max_deceleration_on_cancel: float = setting(0.0, low=0.0)


@dataclass(frozen=True)
class LimitParams:
    """The limits of a joint for the point limiter: rad, rad/s, rad/s2 (m); nan is the description's or none."""

    has_position_limits: bool = True
    min_position: float = setting(math.nan, nan=True)
    max_position: float = setting(math.nan, nan=True)
    has_velocity_limits: bool = True
    max_velocity: float = setting(math.nan, low=0.0, nan=True)
    has_acceleration_limits: bool = True
    max_acceleration: float = setting(math.nan, low=0.0, nan=True)
    has_deceleration_limits: bool = True
    max_deceleration: float = setting(math.nan, low=0.0, nan=True)

    def hard(self, lower: float, upper: float, velocity: float) -> HardLimits:
        """Return the limits that hold, with what the description says of positions and velocities."""
        return HardLimits(
            _limit(self.has_position_limits, self.min_position, lower, -math.inf),
            _limit(self.has_position_limits, self.max_position, upper),
            _limit(self.has_velocity_limits, self.max_velocity, velocity),
            max_acceleration=_limit(self.has_acceleration_limits, self.max_acceleration),
            max_deceleration=_limit(self.has_deceleration_limits, self.max_deceleration),
        )


def _limit(given: bool, value: float, described: float = math.inf, none: float = math.inf) -> float:
    if not given:
        return none
    return described if math.isnan(value) else value


@dataclass(frozen=True)
class TrajectoryParams(CommonParams):
    """Parameters of the controller: s, Hz, rad/s, and `allowed_start_tolerance` in rad or m, 0 for none.

    `gains`, `constraints` and `joint_limits` are in the order of `joints`. With `continue_without_client` a goal goes
    on when the action client that has sent it is gone, as upstream's does. `unreachable_points` is what happens to a
    trajectory with a point that a joint cannot reach in time within its velocity limit.
    """

    joints: tuple[str, ...] = ()
    command_joints: tuple[str, ...] = ()
    command_interfaces: tuple[str, ...] = ()
    state_interfaces: tuple[str, ...] = ()
    initial_scaling_factor: float = setting(1.0, key="speed_scaling.initial_scaling_factor", low=0.0)
    scaling_state: str = setting("", key="speed_scaling.state_interface")
    scaling_command: str = setting("", key="speed_scaling.command_interface")
    allow_partial_joints_goal: bool = False
    open_loop_control: bool = False
    interpolate_from_desired_state: bool = False
    allow_integration_in_goal_trajectories: bool = False
    set_last_command_interface_value_as_state_on_activation: bool = True
    action_monitor_rate: float = setting(20.0, low=0.1)
    interpolation_method: str = setting("splines", choices=("splines", "none"))
    allow_nonzero_velocity_at_trajectory_end: bool = False
    cmd_timeout: float = 0.0
    allow_trajectory_replacement: bool = False
    upsampling: bool = setting(False, key="positions_upsampling.enable")
    policy_frequency: float = setting(0.0, key="positions_upsampling.policy_frequency", low=0.0)
    stopped_velocity_tolerance: float = setting(0.01, key="constraints.stopped_velocity_tolerance")
    goal_time: float = setting(0.0, key="constraints.goal_time", low=0.0)
    decelerate_on_cancel: bool = setting(False, key="constraints.decelerate_on_cancel")
    allowed_start_tolerance: float = setting(0.1, low=0.0)
    unreachable_points: str = setting("warn", choices=("warn", "refuse", "off"))
    continue_without_client: bool = False
    joint_limiter_type: str = setting("", choices=("", POINT_LIMITER))
    gains: tuple[JointGains, ...] = derived(())
    constraints: tuple[JointConstraints, ...] = derived(())
    joint_limits: tuple[LimitParams, ...] = derived(())

    @property
    def commanded(self) -> tuple[str, ...]:
        """The joints that are commanded."""
        return self.command_joints or self.joints

    @property
    def from_desired(self) -> bool:
        """Whether a trajectory begins from what was commanded last, and not from where the joints are."""
        return self.open_loop_control or self.interpolate_from_desired_state

    def tolerances(self) -> SegmentTolerances:
        """Return the tolerances of trajectories that say nothing of their own."""
        path = tuple(StateTolerance(each.trajectory) for each in self.constraints)
        goal = tuple(StateTolerance(each.goal, self.stopped_velocity_tolerance) for each in self.constraints)
        return SegmentTolerances(path, goal, self.goal_time)

    def mistakes(self) -> Iterator[tuple[str, str]]:
        """Yield what cannot be, by parameter."""
        if not self.joints:
            yield "joints", "no 'joints'; give it under ros__parameters: joints: [joint_1, joint_2]"
        for key, names in (("joints", self.joints), ("command_joints", self.command_joints)):
            if len(set(names)) != len(names):
                yield key, f"{key} names one twice: {', '.join(names)}; name each once"
        commands, states = wrong_commands(self.command_interfaces), wrong_states(self.state_interfaces)
        if commands is None and states is None:
            states = wrong_together(self.command_interfaces, self.state_interfaces)
        found = (
            ("command_interfaces", commands),
            ("state_interfaces", states),
            ("command_joints", wrong_joints(self.joints, self.commanded)),
        )
        for key, text in found:
            if text is not None:
                yield key, text


def read_params(params: Params, name: str) -> TrajectoryParams:
    """Return the parameters of controller `name`; raise RobotConfigError with what is wrong in them."""
    del name  # it stands in the place of each mistake
    node = params.flat.get("joints")
    joints = tuple(dict.fromkeys(each.text for each in node.elements())) if node is not None else ()
    old = OLD_KEYS | {key.format(joint): "" for joint in joints for key in _WITHOUT_EFFECT}
    found = params.read(_with_joints(joints), old, TrajectoryParams.mistakes)
    gains = tuple(getattr(found, f"gains_{index}") for index in range(len(joints)))
    constraints = tuple(getattr(found, f"constraints_{index}") for index in range(len(joints)))
    limits = tuple(getattr(found, f"joint_limits_{index}") for index in range(len(joints)))
    return dataclasses.replace(found, gains=gains, constraints=constraints, joint_limits=limits)


OLD_KEYS: Final[dict[str, str]] = dict.fromkeys(
    ("state_publish_rate", "stop_trajectory_duration", "start_with_holding"), ""
)
"""Keys of noetic, foxy and humble: the state is told at the rate of who asks, and the joints are held in any case."""
_UNLIMITED: Final = ("has_jerk_limits", "max_jerk", "has_effort_limits", "max_effort", "angle_wraparound")
_WITHOUT_EFFECT: Final = (
    *(f"gains.{{}}.{key}" for key in ("angle_wraparound", "normalize_error")),
    *(f"joint_limits.{{}}.{key}" for key in _UNLIMITED),
)
"""Of each joint: the description says which of them turn without end, and no point has jerks."""


def _with_joints(joints: tuple[str, ...]) -> type[TrajectoryParams]:
    """Return the class of the parameters with those of each joint, which have its name in their keys."""
    fields: list[tuple[str, Any, Any]] = []
    for index, joint in enumerate(joints):
        fields += [
            (f"gains_{index}", JointGains, setting(JointGains(), key=f"gains.{joint}", section=True)),
            (
                f"constraints_{index}",
                JointConstraints,
                setting(JointConstraints(), key=f"constraints.{joint}", section=True),
            ),
            (f"joint_limits_{index}", LimitParams, setting(LimitParams(), key=f"joint_limits.{joint}", section=True)),
        ]
    made = dataclasses.make_dataclass("TrajectoryParams", fields, bases=(TrajectoryParams,), frozen=True)
    return cast("type[TrajectoryParams]", made)
