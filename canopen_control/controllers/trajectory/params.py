"""Parameters of joint_trajectory_controller/JointTrajectoryController, with the names of jazzy and rolling.

Parameters below `gains.<joint>`, `constraints.<joint>` and `joint_limits.<joint>` are known only for the joints of the
controller.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.limiters import immobile_text
from canopen_control.controllers.params import CommonParams, LoopGains, refuse, repeated
from canopen_control.urdf.joint_element import ACCELERATION, EFFORT, POSITION, VELOCITY, HardLimits
from canopen_control.yamlfile.convert import derived, setting

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.controllers.trajectory.point import Point


# Combinations of command and state interfaces that a joint trajectory controller allows.
#
# Rules (ros2_controllers jazzy): the validators of its parameters, and its checks at configuration.


COMMANDS: Final = (POSITION, VELOCITY, ACCELERATION, EFFORT)
STATES: Final = (POSITION, VELOCITY, ACCELERATION)


def wrong_commands(names: Sequence[str]) -> str | None:
    """Return the error in a list of command interfaces, or None if it is valid."""
    if (wrong := _wrong_list("command_interfaces", names, COMMANDS)) is not None:
        return wrong
    if VELOCITY in names and len(names) > 1 and POSITION not in names:
        return "command_interfaces: velocity is allowed alone or with position; add position"
    if ACCELERATION in names and VELOCITY not in names and POSITION not in names:
        return "command_interfaces: acceleration needs position or velocity; add one"
    if EFFORT in names and set(names) not in ({EFFORT}, {POSITION, EFFORT}):
        return "command_interfaces: effort is allowed alone or with position; remove the others"
    return None


def wrong_states(names: Sequence[str]) -> str | None:
    """Return the error in a list of state interfaces, or None if it is valid."""
    if (wrong := _wrong_list("state_interfaces", names, STATES)) is not None:
        return wrong
    if VELOCITY in names and POSITION not in names:
        return "state_interfaces: velocity needs position; add position"
    if ACCELERATION in names and not {POSITION, VELOCITY}.issubset(names):
        return "state_interfaces: acceleration needs position and velocity; add both"
    return None


def wrong_together(commands: Collection[str], states: Collection[str]) -> str | None:
    """Return an error if these commands need loops whose state interfaces are missing, else None."""
    looped = set(commands) in ({VELOCITY}, {EFFORT}, {POSITION, EFFORT})
    if looped and not {POSITION, VELOCITY}.issubset(states):
        return (
            f"state_interfaces: commanding {' and '.join(commands)} needs position and velocity; "
            f"give state_interfaces: [position, velocity]"
        )
    return None


def wrong_joints(joints: Sequence[str], command_joints: Sequence[str]) -> str | None:
    """Return the error in the list of commanded joints, or None if it is valid.

    A list of the same length as `joints` may contain any names, such as those of other hardware; a shorter list may
    only contain names of `joints`.
    """
    if len(command_joints) > len(joints):
        return f"command_joints: {len(command_joints)} are more than the {len(joints)} joints; remove some"
    unknown = [joint for joint in command_joints if joint not in joints]
    if unknown and len(command_joints) != len(joints):
        return f"command_joints: {', '.join(unknown)}: not among joints ({', '.join(joints)}); use names from joints"
    return None


def _wrong_list(key: str, names: Sequence[str], allowed: Sequence[str]) -> str | None:
    if not names:
        return f"{key} is empty; give one or more of {', '.join(allowed)}"
    if twice := next(repeated(key, names), None):
        return twice
    unknown = [name for name in names if name not in allowed]
    if unknown:
        return f"{key}: {', '.join(unknown)} is not among {', '.join(allowed)}"
    return None


# Tolerances of a joint's deviation from its trajectory, during the motion and at the end, and their values in a goal.
#
# Rules (ros2_controllers jazzy): a value above 0 in a goal is a tolerance, 0 selects the tolerance of the parameters,
# -1 means no tolerance. If a value or a joint of a goal is invalid, all tolerances are those of the parameters; the
# goal is accepted.


_FLOAT_EPSILON: Final = 2.0**-23


@dataclass(frozen=True)
class StateTolerance:
    """Maximum errors of a joint in rad, rad/s and rad/s2 (m if prismatic); 0 or less disables a check."""

    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


@dataclass(frozen=True)
class JointTolerance(StateTolerance):
    """Tolerances of one joint in an action goal (control_msgs/JointTolerance)."""

    name: str = ""


@dataclass(frozen=True)
class GoalTolerances:
    """Tolerances of an action goal; `goal_time` is in s."""

    path: tuple[JointTolerance, ...] = ()
    goal: tuple[JointTolerance, ...] = ()
    goal_time: float = 0.0


@dataclass(frozen=True)
class SegmentTolerances:
    """Tolerances of all joints during the motion (`path`) and at the end of a trajectory (`goal`).

    The goal fails if it is not reached within `goal_time` s after the end; 0 means no time limit.
    """

    path: tuple[StateTolerance, ...]
    goal: tuple[StateTolerance, ...]
    goal_time: float = 0.0


def within(tolerance: StateTolerance, error: Point, joint: int) -> bool:
    """Whether the errors of a joint are within its tolerances; unknown errors (nan) are accepted."""
    if tolerance.position > 0.0 and abs(error.positions[joint]) > tolerance.position:
        return False
    speeds = error.velocities
    if tolerance.velocity > 0.0 and joint < len(speeds) and abs(speeds[joint]) > tolerance.velocity:
        return False
    changes = error.accelerations
    return not (tolerance.acceleration > 0.0 and joint < len(changes) and abs(changes[joint]) > tolerance.acceleration)


def resolve(
    goal: GoalTolerances, joints: Sequence[str], default: SegmentTolerances
) -> tuple[SegmentTolerances, str | None]:
    """Return a goal's tolerances, completed by the default, and None; if invalid, the default and the reason."""
    try:
        time = _resolved(goal.goal_time, default.goal_time, "goal_time_tolerance")
        path = _of_joints(goal.path, joints, default.path, "path_tolerance")
        end = _of_joints(goal.goal, joints, default.goal, "goal_tolerance")
    except ValueError as error:
        return default, f"{error}; the tolerances of the parameters are used"
    return SegmentTolerances(path, end, time), None


def _of_joints(
    tolerances: Sequence[JointTolerance], joints: Sequence[str], default: Sequence[StateTolerance], label: str
) -> tuple[StateTolerance, ...]:
    result = list(default)
    for tolerance in tolerances:
        if tolerance.name not in joints:
            raise ValueError(f"{label} is for {tolerance.name!r}, which is not among {', '.join(joints)}")
        index, text = joints.index(tolerance.name), f"{label} of {tolerance.name}"
        preset = default[index]
        result[index] = StateTolerance(
            _resolved(tolerance.position, preset.position, f"{text}: position"),
            _resolved(tolerance.velocity, preset.velocity, f"{text}: velocity"),
            _resolved(tolerance.acceleration, preset.acceleration, f"{text}: acceleration"),
        )
    return tuple(result)


def _resolved(value: float, default: float, label: str) -> float:
    if value > 0.0:
        return value
    if abs(value + 1.0) < _FLOAT_EPSILON:
        return 0.0
    if value < 0.0:
        raise ValueError(
            f"{label} is {value:g}; give a value above 0, 0 for the value of the parameters, or -1 for no tolerance"
        )
    return default


POINT_LIMITER: Final = "joint_limits/JointTrajectoryPointSaturationLimiter"


@dataclass(frozen=True)
class JointGains(LoopGains):
    """Gains of a joint's PID loop, which is used only for velocity or effort commands.

    `i_clamp` is deprecated.
    """

    p: float = setting(0.0, help="proportional gain of the loop; only for velocity and effort commands")
    ff_velocity_scale: float = setting(
        0.0, help="factor with which the velocity of the trajectory is added to the command"
    )
    i_clamp: float = setting(math.inf, help="limit of the integral in both directions (deprecated)")

    @property
    def integral_limits(self) -> tuple[float, float]:
        """Upper and lower limit of the integral; the deprecated `i_clamp` is the default for both."""
        high, low, both = self.i_clamp_max, self.i_clamp_min, abs(self.i_clamp)
        return high if math.isfinite(high) else both, low if math.isfinite(low) else -both


@dataclass(frozen=True)
class JointConstraints:
    """Tolerances of a joint in rad or m, and its braking deceleration in rad/s2 or m/s2; 0 disables a value."""

    trajectory: float = setting(
        0.0, help="largest deviation from the path in rad or m, beyond which the goal is aborted; 0: not checked"
    )
    goal: float = setting(
        0.0, help="largest deviation from the end in rad or m at which the goal is reached; 0: not checked"
    )
    max_deceleration_on_cancel: float = setting(
        0.0, low=0.0, help="deceleration in rad/s² or m/s² with which a cancelled trajectory brakes"
    )


@dataclass(frozen=True)
class LimitParams:
    """Limits of a joint for commanded trajectory points, in rad, rad/s and rad/s2 (m if prismatic).

    A nan position or velocity limit is that of the URDF, if any; a nan acceleration is unlimited, and a nan
    deceleration is limited like an acceleration.
    """

    has_position_limits: bool = setting(True, help="whether to limit positions")
    min_position: float = setting(math.nan, nan=True, help="lower limit in rad or m; nan: the limit of the description")
    max_position: float = setting(math.nan, nan=True, help="upper limit in rad or m; nan: the limit of the description")
    has_velocity_limits: bool = setting(True, help="whether to limit velocities")
    max_velocity: float = setting(
        math.nan, low=0.0, nan=True, help="limit in rad/s or m/s; nan: the limit of the description"
    )
    has_acceleration_limits: bool = setting(True, help="whether to limit accelerations")
    max_acceleration: float = setting(math.nan, low=0.0, nan=True, help="limit in rad/s² or m/s²; nan: unlimited")
    has_deceleration_limits: bool = setting(
        True, help="whether deceleration has its own limit; false: the acceleration limit applies"
    )
    max_deceleration: float = setting(
        math.nan, low=0.0, nan=True, help="limit in rad/s² or m/s² while braking; nan: `max_acceleration`"
    )

    @property
    def immobile(self) -> str:
        """Name of a limit of 0 that permits no motion, or ""."""
        if self.has_velocity_limits and self.max_velocity == 0.0:
            return "max_velocity"
        if self.has_acceleration_limits and self.max_acceleration == 0.0:
            return "max_acceleration"
        return "max_position" if self.has_position_limits and self.min_position == 0.0 == self.max_position else ""

    def hard(self, lower: float, upper: float, velocity: float) -> HardLimits:
        """Return the effective limits; the limits of the URDF (the arguments) replace nan values."""
        return HardLimits(
            _limit(self.has_position_limits, self.min_position, lower, -math.inf),
            _limit(self.has_position_limits, self.max_position, upper),
            _limit(self.has_velocity_limits, self.max_velocity, velocity),
            max_acceleration=_limit(self.has_acceleration_limits, self.max_acceleration),
            max_deceleration=_limit(self.has_deceleration_limits, self.max_deceleration),
        )


def _limit(enabled: bool, value: float, described: float = math.inf, none: float = math.inf) -> float:
    if not enabled:
        return none
    return described if math.isnan(value) else value


@dataclass(frozen=True)
class TrajectoryParams(CommonParams):
    """Parameters of joint_trajectory_controller/JointTrajectoryController, in units of s, Hz, rad and m.

    `gains`, `constraints` and `joint_limits` are in the order of `joints`. With `continue_without_client` a goal
    continues when its action client disconnects, as upstream does. `unreachable_points` determines what happens to a
    trajectory with a point that a joint cannot reach in time within its velocity limit. An `allowed_start_tolerance` of
    0 disables its check.
    """

    joints: tuple[str, ...] = setting((), help="joints of the trajectories")
    command_joints: tuple[str, ...] = setting(
        (), help="joints that receive the commands, as many as `joints`; empty: `joints`"
    )
    command_interfaces: tuple[str, ...] = setting(
        (), help="command interfaces: position, velocity, acceleration or effort, or a valid combination of them"
    )
    state_interfaces: tuple[str, ...] = setting(
        (), help="state interfaces: position, optionally with velocity, or with velocity and acceleration"
    )
    initial_scaling_factor: float = setting(
        1.0,
        key="speed_scaling.initial_scaling_factor",
        low=0.0,
        help="speed factor of trajectories after activation; other than 1.0 only with position commands",
    )
    scaling_state: str = setting(
        "", key="speed_scaling.state_interface", help="state interface from which the speed factor is read"
    )
    scaling_command: str = setting(
        "", key="speed_scaling.command_interface", help="command interface to which the speed factor is written"
    )
    allow_partial_joints_goal: bool = setting(
        False, help="whether to accept trajectories for some of the joints; the other joints hold their position"
    )
    open_loop_control: bool = setting(
        False,
        help="whether to start trajectories at the last command instead of the state, without feedback (deprecated)",
    )
    interpolate_from_desired_state: bool = setting(
        False, help="whether to start trajectories, and to brake, at the last command instead of the state"
    )
    allow_integration_in_goal_trajectories: bool = setting(
        False, help="whether to accept points without positions, and integrate their velocities or accelerations"
    )
    set_last_command_interface_value_as_state_on_activation: bool = setting(
        True,
        help="whether to hold the last commands after activation, where they are known, instead of the actual state",
    )
    action_monitor_rate: float = setting(20.0, low=0.1, help="rate in Hz of the feedback of goals")
    interpolation_method: str = setting(
        "splines",
        choices=("splines", "none"),
        help="splines: interpolate between points; none: command each point until its time is reached",
    )
    allow_nonzero_velocity_at_trajectory_end: bool = setting(
        False, help="whether to accept trajectories whose last point has a velocity"
    )
    cmd_timeout: float = setting(
        0.0,
        help="time in s after the end of a trajectory until the joints hold, if no new trajectory arrives; must "
        "exceed `goal_time`",
    )
    allow_trajectory_replacement: bool = setting(
        False, help="whether a new trajectory replaces the running one at its start time, and only for its own joints"
    )
    upsampling: bool = setting(
        False,
        key="positions_upsampling.enable",
        help="whether to add the velocities of a spline to trajectories that contain only positions",
    )
    policy_frequency: float = setting(
        0.0,
        key="positions_upsampling.policy_frequency",
        low=0.0,
        help="points per second, for trajectories whose points have no times",
    )
    stopped_velocity_tolerance: float = setting(
        0.01,
        key="constraints.stopped_velocity_tolerance",
        help="largest velocity in rad/s or m/s at the end, if velocity or effort is commanded",
    )
    goal_time: float = setting(
        0.0,
        key="constraints.goal_time",
        low=0.0,
        help="time in s after the end within which the goal must be reached; 0: no limit",
    )
    decelerate_on_cancel: bool = setting(
        False,
        key="constraints.decelerate_on_cancel",
        help="whether to brake with `max_deceleration_on_cancel` when a trajectory is cancelled",
    )
    allowed_start_tolerance: float = setting(
        0.1,
        low=0.0,
        help="largest distance in rad or m from a joint to its first point, beyond what the joint can travel in "
        "time; 0: not checked",
    )
    unreachable_points: str = setting(
        "warn",
        choices=("warn", "refuse", "off"),
        help="how to treat a trajectory with a point that a joint cannot reach in time within its velocity limit: "
        "`warn` (accept with a warning), `refuse`, `off`",
    )
    continue_without_client: bool = setting(
        False, help="whether a goal continues when its action client disconnects, as upstream does"
    )
    joint_limiter_type: str = setting(
        "",
        choices=("", POINT_LIMITER),
        help="limiter that keeps commanded points within `joint_limits` (rolling); empty: none",
    )
    gains: tuple[JointGains, ...] = derived(())
    constraints: tuple[JointConstraints, ...] = derived(())
    joint_limits: tuple[LimitParams, ...] = derived(())

    @property
    def commanded(self) -> tuple[str, ...]:
        """Commanded joints; by default all joints."""
        return self.command_joints or self.joints

    @property
    def from_desired(self) -> bool:
        """Whether a trajectory starts from the last command instead of the actual state."""
        return self.open_loop_control or self.interpolate_from_desired_state

    def tolerances(self) -> SegmentTolerances:
        path = tuple(StateTolerance(constraint.trajectory) for constraint in self.constraints)
        goal = tuple(
            StateTolerance(constraint.goal, self.stopped_velocity_tolerance) for constraint in self.constraints
        )
        return SegmentTolerances(path, goal, self.goal_time)

    @property
    def has_loops(self) -> bool:
        """Whether PID loops compute the commands."""
        return self.command_interfaces == (EFFORT,) or (
            self.command_interfaces == (VELOCITY,) and not self.open_loop_control
        )

    def unstoppable(self) -> Iterator[str]:
        """Yield the error text of each limit with which a moving joint could not brake."""
        for joint, limits in zip(self.joints, self.joint_limits, strict=True):
            if self.joint_limiter_type and limits.has_deceleration_limits and limits.max_deceleration == 0.0:
                key = f"joint_limits.{joint}.max_deceleration"
                yield f"{key} is 0, so a moving joint would never brake; give a value above 0, or remove it"

    def immobile(self) -> Iterator[str]:
        """Yield the text of the event IMMOBILE for parameters of 0 with which a joint does not move."""
        if self.initial_scaling_factor == 0.0:
            effect = "trajectories wait for a factor on ~/speed_scaling_input"
            yield immobile_text("speed_scaling.initial_scaling_factor", effect)
        for joint, limits in zip(self.joints, self.joint_limits, strict=True):
            if self.joint_limiter_type and (key := limits.immobile):
                yield immobile_text(f"joint_limits.{joint}.{key}", f"{joint} does not move")
        for joint, gains in zip(self.joints, self.gains, strict=True) if self.has_loops else ():
            if not any((gains.p, gains.i, gains.d, gains.ff_velocity_scale)):
                keys = f"gains.{joint}.p, i, d and ff_velocity_scale"
                yield f"{keys} are 0, so {joint} does not move; give gains, or ff_velocity_scale: 1.0"

    def mistakes(self) -> Iterator[tuple[str, str]]:
        """Yield contradictions as pairs of parameter and error text."""
        if not self.joints:
            yield "joints", "no 'joints'; give it under ros__parameters: joints: [joint_1, joint_2]"
        for key, names in (("joints", self.joints), ("command_joints", self.command_joints)):
            yield from ((key, text) for text in repeated(key, names))
        commands, states = wrong_commands(self.command_interfaces), wrong_states(self.state_interfaces)
        if commands is None and states is None:
            states = wrong_together(self.command_interfaces, self.state_interfaces)
        wrong = (
            ("command_interfaces", commands),
            ("state_interfaces", states),
            ("command_joints", wrong_joints(self.joints, self.commanded)),
        )
        for key, text in wrong:
            if text is not None:
                yield key, text


def read_params(params: Params, name: str) -> TrajectoryParams:
    """Return the parameters of a trajectory controller; raise RobotConfigError with all errors in them."""
    del name  # that of `params`
    joints = params.names("joints")
    old = OLD_KEYS | {key.format(joint): "" for joint in joints for key in _WITHOUT_EFFECT}
    settings = params.read_each(TrajectoryParams, joints, _OF_JOINTS, old, TrajectoryParams.mistakes)
    refuse(params, settings.unstoppable())
    return settings


OLD_KEYS: Final[dict[str, str]] = dict.fromkeys(
    ("state_publish_rate", "stop_trajectory_duration", "start_with_holding"), ""
)
"""Parameters of noetic, foxy and humble that have no effect.

The state is published at the rate that a client requests, and the joints are always held at the end.
"""
_UNLIMITED: Final = ("has_jerk_limits", "max_jerk", "has_effort_limits", "max_effort", "angle_wraparound")
_WITHOUT_EFFECT: Final = (
    *(f"gains.{{}}.{key}" for key in ("angle_wraparound", "normalize_error")),
    *(f"joint_limits.{{}}.{key}" for key in _UNLIMITED),
)
"""Parameters of each joint that have no effect.

The description says which joints are continuous, and points have no jerk.
"""
_OF_JOINTS: Final = {
    "gains": ("gains.{}", JointGains),
    "constraints": ("constraints.{}", JointConstraints),
    "joint_limits": ("joint_limits.{}", LimitParams),
}
"""Sections of each joint, by field: key and class."""
