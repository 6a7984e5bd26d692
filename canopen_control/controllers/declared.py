"""The parameters that a controller declares, as ROS 2 lists and describes them: made of the class that it reads.

Name, type, default, bounds and choices are those of the dataclass, see `yamlfile.convert`; its meaning stands in the
table of help texts. `settable` of the class lists what may be set while the controller is configured; all else is
read-only, as most of it is upstream.
"""

from __future__ import annotations

import enum
import types
import typing
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from canopen_control.errors import ControlError, nearest
from canopen_control.rpc.messages.parameters import SCALARS, ParameterReading, told
from canopen_control.yamlfile.convert import fields_of, key_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.rpc.messages.parameters import ParameterValue, Told


# What each parameter of the controllers means: what ROS describes it by, and the words of the generated reference.
#
# By the class that declares it, see `declared`. Type, default, bounds and choices come from the class. A test holds
# that every parameter has its words, and that no words are left over.


_TIMEOUT: Final = "s after which a command ends; absent: 2 for velocities and efforts, none for positions; 0: never"

TEXTS: Final[Mapping[str, Mapping[str, str]]] = {
    "ManagerParams": {
        "update_rate": "Hz of the controllers, at most that of the cycle",
        "use_sim_time": "for simulated robots; elsewhere it is told to have no effect",
        "enforce_command_limits": "whether commands are kept within the limits of the description",
        "handle_exceptions": "has no effect: an exception of a controller never ends the cycle",
        "lock_memory": "has no effect: `run --realtime` locks it",
        "thread_priority": "has no effect here: `run --realtime` sets that of the cycle",
        "cpu_affinity": "has no effect: `run --cpu` sets it",
        "robot_description": "what the file gives; the description is that of the robot's folder",
        "hardware_components_initial_state.unconfigured": "hardware that is left unconfigured at the start",
        "hardware_components_initial_state.inactive": "hardware that is configured at the start and not activated",
    },
    "CommonParams": {
        "type": "the type of the controller; it may stand in the controller manager's block instead",
        "update_rate": "Hz; 0: the controller manager's",
        "use_sim_time": "for simulated robots, which publish /clock; elsewhere it is told to have no effect: "
        "stamps that follow a `/clock` are the bridge's `use_sim_time`",
        "is_async": "has no effect: all controllers run in the cycle",
        "thread_priority": "has no effect: `run --realtime` sets the priority of the cycle",
    },
    "ForwardParams": {
        "joints": "the joints, in the order of a command's values",
        "interface_name": "the command interface: position, velocity or effort",
        "command_timeout": _TIMEOUT,
    },
    "GroupParams": {"joints": "the joints, in the order of a command's values", "command_timeout": _TIMEOUT},
    "MultiParams": {
        "joint": "the joint",
        "interface_names": "its command interfaces, in the order of a command's values",
        "command_timeout": _TIMEOUT,
    },
    "SingleParams": {"joint": "the joint", "command_timeout": _TIMEOUT},
    "BaseParams": {
        "odom_frame_id": "parent frame of odometry",
        "base_frame_id": "child frame of odometry",
        "pose_covariance_diagonal": "of the odometry's pose",
        "twist_covariance_diagonal": "of the odometry's twist",
        "enable_odom_tf": "publishes odom to base as a transform",
    },
    "PrefixedParams": {
        "tf_frame_prefix_enable": "whether frame names have a prefix",
        "tf_frame_prefix": "that prefix; empty: the namespace",
    },
    "DiffDriveParams": {
        "left_wheel_names": "joints of the left wheels, a name or a list",
        "right_wheel_names": "joints of the right wheels, as many",
        "wheel_separation": "m between the wheels of both sides; absent: the description's",
        "wheel_radius": "m; absent: the description's",
        "wheel_separation_multiplier": "calibration, a factor",
        "left_wheel_radius_multiplier": "calibration, a factor",
        "right_wheel_radius_multiplier": "calibration, a factor",
        "wheel_radius_multiplier": "both sides at once (noetic)",
        "open_loop": "odometry from the commands instead of the wheels",
        "position_feedback": "odometry from positions, else from velocities of the wheels",
        "cmd_vel_timeout": "s after which a twist ends; 0: never",
        "publish_limited_velocity": "publishes what the limits left of a twist, on `cmd_vel_out`",
        "velocity_rolling_window_size": "samples over which the odometry's velocity is averaged",
        "publish_rate": "Hz of odometry and transform",
    },
    "SwitchedLimits": {
        "has_velocity_limits": "false: the velocity limits do not count",
        "has_acceleration_limits": "false: the acceleration limits do not count",
        "has_jerk_limits": "false: the jerk limits do not count",
    },
    "AxisLimits": {
        "max_velocity": "m/s, rad/s forward (left)",
        "min_velocity": "backward (right), a negative number; absent: minus `max_velocity`",
        "max_acceleration": "m/s^2, rad/s^2 while gaining speed forward",
        "max_deceleration": "while losing it, a negative number; absent: minus `max_acceleration`",
        "max_acceleration_reverse": "while gaining speed backward, a negative number",
        "max_deceleration_reverse": "while losing it",
        "max_jerk": "m/s^3, rad/s^3",
        "min_jerk": "a negative number; absent: minus `max_jerk`",
    },
    "SteeringParams": {
        "reference_timeout": "s after which a twist ends; 0: it counts for one update",
        "traction_joints_names": "joints that drive, from right to left",
        "steering_joints_names": "joints that steer, from right to left",
        "traction_joints_state_names": "joints where traction is measured; empty: the same",
        "steering_joints_state_names": "joints where steering is measured; empty: the same",
        "open_loop": "odometry and the speeds of the wheels by the wanted curve instead of the measured one",
        "reduce_wheel_speed_until_steering_reached": "drives slowly while the steering is 30 degrees or more off",
        "position_feedback": "odometry from positions, else from velocities of the traction wheels",
        "velocity_rolling_window_size": "steps over which the odometry's velocity is averaged",
        "wheelbase": "m between the axles",
        "front_steering": "which wheels names by front and rear mean (deprecated, as are those names)",
    },
    "BicycleParams": {"traction_wheel_radius": "m, of the wheel that drives"},
    "TricycleParams": {
        "traction_wheels_radius": "m, of the wheels that drive",
        "traction_track_width": "m between the wheels that drive",
    },
    "AckermannParams": {"steering_track_width": "m between the wheels that steer; 0: as those that drive"},
    "MecanumParams": {
        "reference_timeout": "s after which a twist ends; 0: it counts for one update",
        "front_left_wheel_command_joint_name": "joint of this wheel",
        "front_right_wheel_command_joint_name": "joint of this wheel",
        "rear_right_wheel_command_joint_name": "joint of this wheel",
        "rear_left_wheel_command_joint_name": "joint of this wheel",
        "front_left_wheel_state_joint_name": "joint where it is measured; empty: the same",
        "front_right_wheel_state_joint_name": "joint where it is measured; empty: the same",
        "rear_right_wheel_state_joint_name": "joint where it is measured; empty: the same",
        "rear_left_wheel_state_joint_name": "joint where it is measured; empty: the same",
        "kinematics.base_frame_offset.x": "m from the middle of the wheels to the frame of the base",
        "kinematics.base_frame_offset.y": "the same to the left",
        "kinematics.base_frame_offset.theta": "rad by which that frame is turned",
        "kinematics.wheels_radius": "m",
        "kinematics.sum_of_robot_center_projection_on_X_Y_axis": "m from the middle to a wheel along x and y, added",
    },
    "OmniParams": {
        "diagonal_covariance.pose": "of the odometry's pose",
        "diagonal_covariance.twist": "of the odometry's twist",
        "wheel_names": "joints of the wheels, three or more, around the base against the clock",
        "wheel_offset": "rad from straight ahead to the first wheel, seen from the middle",
        "robot_radius": "m from the middle to a wheel",
        "wheel_radius": "m",
        "open_loop": "odometry from the commands instead of the wheels",
        "position_feedback": "odometry from positions, else from velocities of the wheels",
        "cmd_vel_timeout": "s after which a twist ends; 0: it counts for one update",
    },
    "TrajectoryParams": {
        "joints": "the joints of a trajectory",
        "command_joints": "those that are commanded; empty: all; as many with other names: those of another hardware",
        "command_interfaces": "of position, velocity, acceleration and effort, as they go together",
        "state_interfaces": "of position, velocity and acceleration",
        "speed_scaling.initial_scaling_factor": "how fast the time of trajectories runs; positions alone",
        "speed_scaling.state_interface": "a state interface that says how fast it runs",
        "speed_scaling.command_interface": "a command interface that is told how fast it is to run",
        "allow_partial_joints_goal": "takes trajectories of some joints; the others stay",
        "open_loop_control": "begins from the last command instead of the state, and closes no loop (deprecated)",
        "interpolate_from_desired_state": "begins, and brakes, from the last command instead of the state",
        "allow_integration_in_goal_trajectories": "takes points without positions and integrates what they have",
        "set_last_command_interface_value_as_state_on_activation": "holds what stands commanded, where that is known",
        "action_monitor_rate": "Hz of the feedback of goals",
        "interpolation_method": "splines, or none: each point is commanded until it is reached",
        "allow_nonzero_velocity_at_trajectory_end": "takes trajectories that do not end at rest",
        "cmd_timeout": "s after the end of a trajectory without another one until the joints are held; above goal_time",
        "allow_trajectory_replacement": "blends a new trajectory in at its start, for the joints that it names",
        "positions_upsampling.enable": "velocities of a spline for trajectories of positions alone",
        "positions_upsampling.policy_frequency": "Hz of points that come without times",
        "constraints.stopped_velocity_tolerance": "rad/s at the end, where velocity or effort is commanded",
        "constraints.goal_time": "s after the end in which the goal must be reached; 0: no limit",
        "constraints.decelerate_on_cancel": "brakes with `max_deceleration_on_cancel` where a trajectory is given up",
        "unreachable_points": "what happens to a trajectory with a point that a joint cannot reach in time from the "
        "one before within its velocity limit: `warn` (taken, and told), `refuse`, `off`",
        "allowed_start_tolerance": "rad or m from a joint to the first point, beyond what it can go until then; 0: any",
        "continue_without_client": "a goal goes on when the action client that sent it is gone, as upstream's does",
        "joint_limiter_type": "keeps each commanded point within the limits (rolling); empty: nothing does",
    },
    "JointGains": {
        "p": "proportional gain of the loop over a velocity or effort",
        "i": "integral gain",
        "d": "derivative gain",
        "ff_velocity_scale": "factor of the trajectory's velocity that is added",
        "i_clamp": "limit of the integral on both sides (deprecated)",
        "i_clamp_max": "upper limit of the integral",
        "i_clamp_min": "lower limit of the integral",
        "u_clamp_max": "upper limit of the output",
        "u_clamp_min": "lower limit of the output",
        "antiwindup_strategy": "what the integral does at a limit of the output",
        "tracking_time_constant": "s of back_calculation; 0: from the gains",
        "error_deadband": "an error that is not integrated",
    },
    "LimitParams": {
        "has_position_limits": "false: positions are not limited",
        "min_position": "rad or m; nan: that of the description",
        "max_position": "rad or m; nan: that of the description",
        "has_velocity_limits": "false: velocities are not limited",
        "max_velocity": "rad/s or m/s; nan: that of the description",
        "has_acceleration_limits": "false: accelerations are not limited",
        "max_acceleration": "rad/s² or m/s²; nan: none",
        "has_deceleration_limits": "false: braking is limited as speeding up is",
        "max_deceleration": "rad/s² or m/s², of braking; nan: as `max_acceleration`",
    },
    "JointConstraints": {
        "trajectory": "rad or m off the path that abort; 0: any",
        "goal": "rad or m off the end within which it is reached; 0: any",
        "max_deceleration_on_cancel": "rad/s^2 with which it brakes",
    },
    "PidParams": {
        "dof_names": "the joints that are commanded",
        "reference_and_state_dof_names": "their names in references and states, where those differ",
        "command_interface": "velocity, acceleration or effort: what the loops command",
        "reference_and_state_interfaces": "what is controlled, and its derivative: [position, velocity]",
        "set_current_state_as_first_setpoint": "begins by keeping the joints where they are, else with targets of 0",
        "use_external_measured_states": "states come on `~/measured_state`, and not by the interfaces",
        "measured_state_timeout": "s; without a measured state for so long targets are 0, and references are forgotten",
        "enable_feedforward": "the reference leads by `feedforward_gain`, its derivative where that is given",
        "command_timeout": _TIMEOUT,
    },
    "DofGains": {
        "p": "proportional gain",
        "i": "integral gain",
        "d": "derivative gain",
        "u_clamp_max": "upper limit of the output",
        "u_clamp_min": "lower limit of the output",
        "antiwindup": "with the strategy legacy: the integral itself is limited (deprecated)",
        "i_clamp_max": "upper limit of the integral",
        "i_clamp_min": "lower limit of the integral",
        "antiwindup_strategy": "what the integral does at a limit of the output",
        "tracking_time_constant": "s of back_calculation; 0: from the gains",
        "error_deadband": "an error that is not integrated",
        "feedforward_gain": "factor of what leads",
        "angle_wraparound": "the error of a joint without end is the short way round",
        "save_i_term": "the integral outlives a deactivation",
        "activate_state_publisher": "has no effect: `~/controller_state` tells all of it",
    },
    "BroadcasterParams": {
        "joints": "with `interfaces`: only these joints",
        "interfaces": "with `joints`: only these interfaces",
        "extra_joints": "joints that nothing measures, published as 0.0",
        "map_interface_to_joint_state.position": "the interface that is published as position",
        "map_interface_to_joint_state.velocity": "the interface that is published as velocity",
        "map_interface_to_joint_state.effort": "the interface that is published as effort",
        "use_local_topics": "publishes below its own name",
        "use_urdf_to_filter": "only joints that the description moves, in alphabetical order",
        "frame_id": "frame of the headers",
        "publish_dynamic_joint_states": "publishes every state interface on `dynamic_joint_states` too",
    },
    "GpioParams": {
        "gpios": "names of <gpio> parts of the description",
        "command_interfaces": "`.GPIO.interfaces`: the command interfaces, its outputs; none: it only tells",
        "state_interfaces": "`.GPIO.interfaces`: the state interfaces that are told; none: every one of that gpio",
        "safe_values": "`.GPIO.INTERFACE`: where the output goes when commands end; absent: 0.0",
        "kept_outputs": "`GPIO/INTERFACE`: outputs that stay as they are when commands end",
        "command_timeout": "s after which a command ends; absent or 0: never (2 for interfaces named velocity, effort "
        "or acceleration)",
    },
    "DeviceParams": {"joint": "a joint that a node drives, or the name of a node that drives none"},
    "GripperParams": {
        "joint": "the joint of the gripper",
        "action_monitor_rate": "Hz of feedback to the action's client",
        "goal_tolerance": "rad or m within which the goal is reached",
        "max_effort": "Nm or N of a goal that gives none, or 0",
        "allow_stalling": "a gripper that moves no more has succeeded, and goes on gripping",
        "stall_velocity_threshold": "rad/s or m/s; what is no faster does not move",
        "stall_timeout": "s without motion after which it has stalled",
        "state_interfaces": "what is read of the joint; `effort` for the result's effort",
        "max_effort_interface": "the command interface that limits the effort, by its full name; empty: none",
        "max_velocity_interface": "the one that limits the velocity",
        "max_velocity": "rad/s or m/s of a goal that gives none, or 0, for that interface",
    },
    "SensorParams": {
        "sensor_name": "a <sensor> of the description, whose interfaces have the names of ros2_control",
        "frame_id": "frame of the headers",
    },
    "ImuParams": {
        "static_covariance_orientation": "nine numbers, row by row about x, y, z; all 0: not known",
        "static_covariance_angular_velocity": "the same of the angular velocity; -1 first: it is not measured",
        "static_covariance_linear_acceleration": "the same of the linear acceleration",
    },
    "RangeParams": {
        "radiation_type": "0 ultrasound, 1 infrared",
        "field_of_view": "rad, the arc for which the distance holds",
        "min_range": "m, the least distance that is measured",
        "max_range": "m, the largest",
        "variance": "m^2; 0: not known",
    },
    "ForceTorqueParams": {
        "interface_names": "`.force.x` to `.torque.z`: state interfaces by their full names, instead of `sensor_name`",
        "offset": "`.force.x` to `.torque.z`: N or Nm that are added",
        "multiplier": "`.force.x` to `.torque.z`: factor after that; absent: 1.0",
    },
    "PoseParams": {
        "frame_id": "frame in which the pose is told",
        "pose_name": "a <sensor> of the description with `position.x` to `orientation.w`",
        "interface_names": "`.position.x` to `.orientation.w`: state interfaces by their full names, instead of it",
    },
    "PoseTransform": {
        "enable": "whether the pose is a transform in `/tf` too",
        "child_frame_id": "the frame that is there; empty: `pose_name`",
        "publish_rate": "has no effect: there is a transform at every update",
    },
    "BatteryParams": {
        "batteries": "names of <sensor>, <gpio> or <joint> parts, each with `battery_voltage` at least",
        "interfaces": "`.BATTERY.battery_temperature` and so on, true: that state interface is read too "
        "(`battery_current`, `battery_charge`, `battery_percentage`, `battery_power_supply_status`, `..._health`, "
        "`battery_present`)",
        "sensor_name": "one battery alone, of which `voltage` is read (deprecated)",
        "design_capacity": "Ah, of that one",
        "power_supply_technology": "of that one",
    },
    "Battery": {
        "minimum_voltage": "V of an empty battery, for the percentage of one that tells none",
        "maximum_voltage": "V of a full one",
        "capacity": "Ah, when it was full last",
        "design_capacity": "Ah of a new battery",
        "power_supply_technology": "its chemistry, a number of sensor_msgs/BatteryState",
        "location": "where it is, such as a slot",
        "serial_number": "its serial number",
    },
    "StateParams": {
        "joints": "only these joints; empty: all",
        "interfaces": "only these interfaces; empty: all that the broadcaster is about",
        "stale_after": "s without news after which a joint is STALE",
    },
}
"""By the name of the class and the key of the parameter, as it stands in the YAML."""


def text_of(cls: type[object], key: str) -> str:
    """Return what a parameter of a class means, "" where nobody says; a class that it derives from may say it."""
    found = (TEXTS.get(each.__name__, {}).get(key) for each in cls.__mro__)
    return next((text for text in found if text), "")


_HIDDEN: Final = frozenset({"type"})  # the manager's parameter of a controller
_NO_METADATA: Final[Mapping[str, Any]] = types.MappingProxyType({})


def declared_by(taken: object, settable: Iterable[str] = (), **effective: Told) -> tuple[ParameterReading, ...]:
    """Return the parameters of a dataclass that was read of them, sorted by name; `settable` are patterns of names.

    `effective` are values that others have than what was read: the `update_rate` that a controller has of the manager.
    """
    patterns = tuple(settable)
    rows = sorted(_rows(taken, ""), key=lambda row: row.name)
    return tuple(_reading(row, effective.get(row.name, row.value), patterns) for row in rows if row.name not in _HIDDEN)


def _reading(row: _Row, value: object, patterns: Iterable[str]) -> ParameterReading:
    name, metadata = row.name, row.metadata
    kind, (low, high) = _kind(row.wanted, value), metadata.get("range") or (None, None)
    plain = value.value if isinstance(value, enum.Enum) else value
    return ParameterReading(
        name=name,
        kind=kind,
        value=told([plain] if kind.endswith("_array") and isinstance(plain, str) else plain),
        read_only=not any(fnmatchcase(name, each) for each in patterns),
        low=low,
        high=high,
        choices=tuple(map(str, metadata.get("choices") or ())),
        text=text_of(row.owner, row.key),
    )


def given_in(params: Params) -> tuple[ParameterReading, ...]:
    """Return what the files give of a controller that is not configured: which parameters it has, it has not said."""
    values = {key.text: value.value for key, value in params.flat.pairs()}
    return tuple(
        ParameterReading(name=name, kind=_kind_of(value), value=told(value), read_only=True)
        for name, value in sorted(values.items())
        if name not in _HIDDEN
    )


def checked(owner: str, known: Sequence[ParameterReading], wanted: Sequence[ParameterValue]) -> dict[str, Told]:
    """Return what is to be set, by name; ControlError, in the words of rclcpp, for what cannot be."""
    rows = {each.name: each for each in known}
    values: dict[str, Told] = {}
    for each in wanted:
        row = rows.get(each.name)
        if row is None:
            hint = near if "mean" in (near := nearest(each.name, rows)) else ""
            raise ControlError(f"{owner}: parameter '{each.name}' cannot be set because it was not declared{hint}")
        if row.read_only:
            raise ControlError(
                f"{owner}: parameter '{each.name}' cannot be set because it is read-only; "
                f"change it in ros2_controllers.yaml, and load the controller again"
            )
        if row.kind not in (each.kind, "not_set"):
            raise ControlError(
                f"{owner}: wrong parameter type, parameter '{each.name}' is of type {row.kind}, "
                f"setting it to {each.kind} is not allowed"
            )
        try:
            values[each.name] = each.plain
        except ValueError as error:
            raise ControlError(f"{owner}: parameter '{each.name}': {error}") from None
    return values


class _Row(NamedTuple):
    """One parameter: its whole name, annotation and value; `owner` declares it, by `key` of that class."""

    name: str
    wanted: Any
    value: Any
    metadata: Mapping[str, Any]
    owner: type[object]
    key: str


def _rows(taken: Any, prefix: str) -> Iterator[_Row]:  # noqa: ANN401 - a dataclass
    owner = type(taken)
    for entry, wanted in fields_of(owner):
        value, metadata, key = getattr(taken, entry.name), entry.metadata or _NO_METADATA, key_of(entry)
        if metadata.get("here") or metadata.get("derived"):
            continue
        if metadata.get("part"):
            yield from _rows(value, prefix)
        elif metadata.get("section") and isinstance(value, dict):  # whose names the file gives
            inner = typing.get_args(wanted)[-1]
            yield from (_Row(f"{prefix}{key}.{each}", inner, one, metadata, owner, key) for each, one in value.items())
        elif metadata.get("section"):
            yield from _rows(value, f"{prefix}{key}.")
        else:
            yield _Row(f"{prefix}{key}", wanted, value, metadata, owner, key)


def _kind(wanted: Any, value: object) -> str:  # noqa: ANN401 - a type, of which there is no common one
    """Return the type of a parameter: that of its annotation, where that leaves one, else that of its value."""
    origin, inner = typing.get_origin(wanted), typing.get_args(wanted)
    if origin in (typing.Union, types.UnionType):
        kinds = [_kind(each, value) for each in inner if each is not type(None)]
        return next((each for each in kinds if each.endswith("_array")), kinds[0])
    if origin in (tuple, list) and inner:
        return f"{SCALARS.get(inner[0], 'string')}_array"
    if origin is typing.Literal or (isinstance(wanted, type) and issubclass(wanted, enum.Enum)):
        return "string"
    return SCALARS.get(wanted) or _kind_of(value)


def _kind_of(value: object) -> str:
    if isinstance(value, list | tuple):
        kinds = {_kind_of(each) for each in value}
        first = "double" if kinds == {"integer", "double"} else min(kinds, default="string")
        return f"{first}_array" if first in SCALARS.values() else "string_array"
    return SCALARS.get(type(value), "not_set")
