"""Generator of a robot's folder: files are written to a temporary folder, checked as by `check`, and moved.

The temporary folder is next to the robot's, so that a full disk leaves nothing: the complete files are only renamed. An
existing folder is changed only on request, and then only the generated files are replaced. Errors that the check
finds, and reasons why a drive cannot be moved, are reported and written into bus.yml as comments.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Final
from xml.sax.saxutils import quoteattr

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.cia402.objects import INTERPOLATION_TIME_PERIOD
from canopen_control.controllers.broadcasters import QUANTITIES
from canopen_control.errors import RobotConfigError
from canopen_control.host.files import telling
from canopen_control.master.budget import HIGH
from canopen_control.od.issues import Severity
from canopen_control.profiles import Profile
from canopen_control.runtime.robot_files import BUS, CONTROLLERS, find_robot
from canopen_control.scaffold.bus_text import bus_text, remark
from canopen_control.scaffold.drive_choice import POSITION, VELOCITY
from canopen_control.scaffold.new_robot import FASTEST_MEASURED

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from canopen_control.check.checker import CheckReport
    from canopen_control.scaffold.new_robot import NewJoint, NewNode, NewRobot


# URDF of a new robot: links and joints for display, and the <ros2_control> tag that assigns drives to joints.
#
# A base has wheels on the ground; joints without a base are discs in a row, each turning about y. All joints are
# continuous; a joint with end stops becomes `revolute` once its limits are known.


RADIUS: Final = 0.05  # m, of a wheel
SEPARATION: Final = 0.3  # m, between left and right
WHEELBASE: Final = 0.3  # m, between front and rear
_WIDTH: Final = 0.02
_FASTEST: Final = {VELOCITY: 30.0, POSITION: 1.0}  # rad/s


def description_text(robot: NewRobot) -> str:
    """Return the text of the URDF of a new robot."""
    lines = [
        '<?xml version="1.0"?>',
        f"<!-- {robot.name}: links and joints, in m and rad; at the end, <ros2_control> names the drive of each joint.",
        "     All measures are examples; replace them by those of your robot. -->",
        f"<robot name={quoteattr(robot.name)}>",
        *(_chassis() if robot.base.type_name else ['  <link name="base_link"/>', ""]),
    ]
    for number, joint in enumerate(robot.joints):
        axis = "0 0 1" if robot.base.steers(len(robot.joints), number) else "0 1 0"
        lines += _joint(joint.name, _place(robot, number), axis, _FASTEST[joint.axis.interface])
    for number, node in enumerate(node for node in robot.nodes if node.measured):
        lines += _joint(node.measured, (0.0, -0.1 * (number + 1), RADIUS), "0 1 0", FASTEST_MEASURED)
    lines += [
        f'  <ros2_control name={quoteattr(robot.name)} type="system">',
        "    <hardware>",
        "      <!-- nodes in bus.yml, virtual or real -->",
        "      <plugin>canopen_ros2_control/RobotSystem</plugin>",
        "    </hardware>",
    ]
    for node in robot.nodes:
        for joint in node.joints:
            lines += _control(joint)
        lines += _measured(node) if node.measured else _signals(node)
    return "\n".join([*lines, "  </ros2_control>", "</robot>"]) + "\n"


def _chassis() -> list[str]:
    return [
        "  <!-- on the ground; moved by odometry -->",
        '  <link name="base_footprint"/>',
        '  <joint name="base_joint" type="fixed">',
        '    <parent link="base_footprint"/>',
        '    <child link="base_link"/>',
        f'    <origin xyz="0 0 {RADIUS}"/>',
        "  </joint>",
        '  <link name="base_link">',
        "    <visual>",
        '      <origin xyz="0 0 0.03"/>',
        f'      <geometry><box size="{WHEELBASE + 0.1:g} {SEPARATION - 0.04:g} 0.05"/></geometry>',
        "    </visual>",
        "  </link>",
        "",
    ]


def _joint(joint: str, place: tuple[float, float, float], axis: str, fastest: float) -> list[str]:
    link, size = f"{joint.removesuffix('_joint')}_link", f'radius="{RADIUS}" length="{_WIDTH}"'
    x, y, z = place
    return [
        f'  <joint name="{joint}" type="continuous">',
        '    <parent link="base_link"/>',
        f'    <child link="{link}"/>',
        f'    <origin xyz="{x:g} {y:g} {z:g}"/>',
        f'    <axis xyz="{axis}"/>',
        f'    <limit effort="10" velocity="{fastest:g}"/>  <!-- Nm, rad/s -->',
        "  </joint>",
        f'  <link name="{link}">',
        "    <visual>",
        '      <origin rpy="1.5707963 0 0"/>',
        f"      <geometry><cylinder {size}/></geometry>",
        "    </visual>",
        "    <visual>  <!-- a mark that shows the rotation -->",
        f'      <origin xyz="{RADIUS / 2:g} {_WIDTH / 2:g} 0"/>',
        f'      <geometry><box size="{RADIUS * 0.8:g} 0.004 0.008"/></geometry>',
        "    </visual>",
        "  </link>",
        "",
    ]


def _place(robot: NewRobot, number: int) -> tuple[float, float, float]:
    """Return the position of a joint on base_link: in a row, or left and right alternately from the front.

    A steered wheel is in front of the single pair.
    """
    if not robot.base.type_name:
        return 0.0, 0.1 * number, RADIUS
    if robot.base.steers(len(robot.joints), number):
        return WHEELBASE, 0.0, 0.0
    pairs = len(robot.joints) // 2
    side = SEPARATION / 2 if number % 2 == 0 else -SEPARATION / 2
    return (0.0 if pairs == 1 else WHEELBASE / 2 if number < 2 else -WHEELBASE / 2), side, 0.0


def _measured(node: NewNode) -> list[str]:
    """Return the URDF lines of a joint measured by an encoder, without a command interface."""
    return [
        f'    <joint name="{node.measured}">',
        f'      <param name="device_name">{node.name}</param>  <!-- encoder in bus.yml -->',
        '      <state_interface name="position"/>',
        '      <state_interface name="velocity"/>',
        "    </joint>",
    ]


def _signals(node: NewNode) -> list[str]:
    """Return the URDF lines for the signals of a device other than a drive; [] without signals."""
    if not node.signals:
        return []
    tag = "gpio" if node.profile is Profile.IO or node.outputs else "sensor"
    return [
        f'    <{tag} name="{node.name}">  <!-- node with this name in bus.yml -->',
        *(f'      <command_interface name="{output.name}"/>' for output in node.outputs),
        *(f'      <state_interface name="{signal.name}"/>{_unit(signal.unit)}' for signal in node.signals),
        f"    </{tag}>",
    ]


def _unit(unit: str) -> str:
    return f"  <!-- {unit} -->" if unit else ""


def _control(joint: NewJoint) -> list[str]:
    axis = joint.axis
    more = [f'      <param name="axis">{axis.number}</param>  <!-- of the device -->'] if axis.number else []
    return [
        f'    <joint name="{joint.name}">',
        f'      <param name="device_name">{joint.node}</param>  <!-- node in bus.yml -->',
        *more,
        f'      <command_interface name="{axis.interface}"/>',
        *(f'      <state_interface name="{name}"/>' for name in axis.feedback),
        "    </joint>",
    ]


# Controllers of devices other than drives in a new ros2_controllers.yaml.
#
# A device with outputs gets a GPIO command controller, which also publishes the inputs. A battery gets a battery state
# broadcaster, any other device a broadcaster of all signals. The joint state broadcaster publishes an encoder's joint.


def device_controller(node: NewNode) -> tuple[str, str, list[str]]:
    """Return the name, the type and the parameter lines of the controller for a device with signals."""
    if node.outputs:
        return f"{node.name}_outputs", "gpio_controllers/GpioCommandController", _outputs(node)
    if node.profile is Profile.BATTERY and any(signal.name == QUANTITIES[0] for signal in node.signals):
        return f"{node.name}_broadcaster", "battery_state_broadcaster/BatteryStateBroadcaster", _battery(node)
    return f"{node.name}_broadcaster", "canopen_control/GpioBroadcaster", _inputs(node)


def _outputs(node: NewNode) -> list[str]:
    names = ", ".join(signal.name for signal in node.outputs)
    return [
        remark(f"gpios: [{node.name}]", "the <gpio> of the description"),
        "command_interfaces:",
        remark(f"  {node.name}: {{interfaces: [{names}]}}", "commanded outputs; inputs are published too"),
        remark("command_timeout: 0.0", "s without a command until outputs have their safe values; 0: never"),
    ]


def _battery(node: NewNode) -> list[str]:
    measured = [signal.name for signal in node.signals if signal.name in QUANTITIES[1:]]
    lines = [remark(f"batteries: [{node.name}]", "the <sensor> of the description")]
    if measured:
        lines += ["interfaces:", f"  {node.name}: {{{', '.join(f'{name}: true' for name in measured)}}}"]
    return lines


def _inputs(node: NewNode) -> list[str]:
    return [remark(f"joints: [{node.name}]", "all signals of the device, at every update")]


# ros2_controllers.yaml of a new robot, with comments.
#
# `run` and `demo` activate the first controller other than a broadcaster: the controller of the base, otherwise of the
# velocity joints, otherwise of the position joints.


BASE_CONTROLLER: Final = "base_controller"
_TYPES: Final = {
    VELOCITY: "velocity_controllers/JointGroupVelocityController",
    POSITION: "position_controllers/JointGroupPositionController",
}
_UNITS: Final = {VELOCITY: "rad/s", POSITION: "rad"}


def controllers_text(robot: NewRobot) -> str:
    """Return the text of ros2_controllers.yaml of a new robot."""
    joints = {
        interface: [joint.name for joint in robot.joints if joint.axis.interface == interface] for interface in _TYPES
    }
    groups = {interface: names for interface, names in joints.items() if names}
    rate = round(1_000_000 / robot.sync_us)
    lines = [
        f"# The controllers of {robot.name}. Active at the start: those without joints, and the first with joints;",
        f"# select another with canopen-control run {robot.name} --controller NAME.",
        "",
        "controller_manager:",
        "  ros__parameters:",
        remark(f"    update_rate: {rate}", "Hz: the SYNC period of bus.yml"),
    ]
    if POSITION in groups:
        lines.append(remark("    enforce_command_limits: true", "positions change at most as fast as the URDF allows"))
    if _feedback(robot.joints) or any(node.measured for node in robot.nodes):
        lines += ["", "    joint_state_broadcaster:", "      type: joint_state_broadcaster/JointStateBroadcaster"]
    if robot.base.type_name:
        lines += ["", f"    {BASE_CONTROLLER}:", f"      type: {robot.base.type_name}"]
    for interface in groups:
        lines += ["", f"    {interface}_controller:", f"      type: {_TYPES[interface]}"]
    devices = [device_controller(node) for node in robot.nodes if node.signals and not node.measured]
    for name, type_name, _ in devices:
        lines += ["", f"    {name}:", f"      type: {type_name}"]
    if robot.base.type_name:
        lines += ["", f"{BASE_CONTROLLER}:", "  ros__parameters:"]
        lines += [f"    {line}" if line else "" for line in _PARAMETERS[robot.base.name](robot)]
    for interface, names in groups.items():
        lines += ["", f"{interface}_controller:", "  ros__parameters:"]
        lines.append(
            remark(f"    joints: [{', '.join(names)}]", f"one value for each in a command, in {_UNITS[interface]}")
        )
        if interface == VELOCITY:
            lines.append(remark("    command_timeout: 1.0", "s without a command until the motors stop"))
    for name, _, parameters in devices:
        lines += ["", f"{name}:", "  ros__parameters:", *(f"    {line}" for line in parameters)]
    return "\n".join(lines) + "\n"


def _feedback(joints: Sequence[NewJoint]) -> set[str]:
    """Return the union of the state interfaces of joints."""
    return {name for joint in joints for name in joint.axis.feedback}


def _diff(robot: NewRobot) -> list[str]:
    joints = [joint.name for joint in robot.joints]
    feedback = _feedback(robot.joints)
    return [
        f"left_wheel_names: [{', '.join(joints[0::2])}]",
        f"right_wheel_names: [{', '.join(joints[1::2])}]",
        "",
        remark(f"wheel_separation: {SEPARATION}", "m, between the centres of the wheels; measure it"),
        remark(f"wheel_radius: {RADIUS}", "m; measure it"),
        "",
        *_odometry(feedback, "cmd_vel_timeout"),
        "",
        remark("linear.x.max_velocity: 0.5", "m/s"),
        "linear.x.min_velocity: -0.5",
        remark("linear.x.max_acceleration: 0.5", "m/s^2"),
        "linear.x.max_deceleration: -0.5",
        remark("angular.z.max_velocity: 1.0", "rad/s"),
        "angular.z.min_velocity: -1.0",
        remark("angular.z.max_acceleration: 1.0", "rad/s^2"),
        "angular.z.max_deceleration: -1.0",
    ]


def _odometry(feedback: set[str], timeout: str) -> list[str]:
    """Return the parameters for the odometry source (positions, velocities or commands) and the timeout."""
    source = POSITION if POSITION in feedback else VELOCITY if VELOCITY in feedback else "the commands"
    return [
        "odom_frame_id: odom",
        remark("base_frame_id: base_footprint", "the root of the URDF"),
        "enable_odom_tf: true",
        remark(f"open_loop: {'false' if feedback else 'true'}", f"odometry of {source}"),
        f"position_feedback: {'true' if POSITION in feedback else 'false'}",
        remark(f"{timeout}: 0.5", "s without a command until the base stops"),
    ]


def _tricycle(robot: NewRobot) -> list[str]:
    left, right, steering = (joint.name for joint in robot.joints)
    traction = _feedback(robot.joints[:2])
    return [
        remark(f"traction_joints_names: [{right}, {left}]", "right, then left"),
        f"steering_joints_names: [{steering}]",
        "",
        remark(f"wheelbase: {WHEELBASE}", "m, from the driven axle to the steered wheel; measure it"),
        remark(f"traction_track_width: {SEPARATION}", "m, between the driven wheels; measure it"),
        remark(f"traction_wheels_radius: {RADIUS}", "m; measure it"),
        "",
        *_odometry(traction, "reference_timeout"),
        remark("reduce_wheel_speed_until_steering_reached: true", "drive slowly until the steering angle is reached"),
    ]


def _mecanum(robot: NewRobot) -> list[str]:
    places = ("front_left", "front_right", "rear_left", "rear_right")
    feedback = _feedback(robot.joints)
    return [
        *(f"{place}_wheel_command_joint_name: {joint.name}" for place, joint in zip(places, robot.joints, strict=True)),
        "",
        remark(f"kinematics.wheels_radius: {RADIUS}", "m; measure it"),
        remark(
            f"kinematics.sum_of_robot_center_projection_on_X_Y_axis: {(WHEELBASE + SEPARATION) / 2:g}",
            "m, half the wheelbase plus half the track width; measure it",
        ),
        "",
        *(line for line in _odometry(feedback, "reference_timeout") if not line.startswith(_NOT_MECANUM)),
        "",
        remark("linear.x.max_velocity: 0.5", "m/s"),
        remark("linear.x.max_acceleration: 0.5", "m/s^2"),
        "linear.y.max_velocity: 0.5",
        "linear.y.max_acceleration: 0.5",
        remark("angular.z.max_velocity: 1.0", "rad/s"),
        remark("angular.z.max_acceleration: 1.0", "rad/s^2"),
    ]


_NOT_MECANUM: Final = ("open_loop", "position_feedback")
_PARAMETERS: Final[dict[str, Callable[[NewRobot], list[str]]]] = {
    "diff": _diff,
    "tricycle": _tricycle,
    "mecanum": _mecanum,
}
"""Functions that return the controller parameters of a base, by base name."""


_PERIODS_US: Final = (20_000, 50_000, 100_000, 200_000)
"""SYNC periods in us; the shortest one that the bus load permits is used."""
_FASTEST_US: Final = 5_000  # shortest accepted period in a DCF
_LARGEST_POWER: Final = 10


@dataclass(frozen=True, slots=True)
class Written:
    """Result of `write_robot`: the robot, its files, and the warnings and errors of `check`."""

    robot: NewRobot
    folder: Path
    files: tuple[str, ...]
    warnings: tuple[str, ...]
    problems: tuple[str, ...] = ()


def write_robot(robot: NewRobot, parent: Path, *, force: bool = False) -> Written:
    """Write the folder of a robot into `parent`.

    Raise ConfigError if the folder exists and `force` is False, or if it cannot be written; raise DiskFull if the disk
    is full.
    """
    folder = parent / robot.name
    refuse_existing(folder, force=force)
    robot = _with_distinct_files(robot)
    with telling(folder, "nothing was written"), _folder_beside(folder) as temporary_root:
        temporary = temporary_root / robot.name
        robot, warnings = _make_checked(robot, temporary)
        names = tuple(sorted(path.name for path in temporary.iterdir()))
        if folder.exists():
            for name in names:
                os.replace(temporary / name, folder / name)
        else:
            temporary.rename(folder)
    return Written(robot, folder, names, warnings, robot.problems)


@contextlib.contextmanager
def _folder_beside(folder: Path) -> Iterator[Path]:
    """Context of a temporary folder in the parent of `folder`; parents created for it are removed if they are empty."""
    created = [place for place in folder.parents if not place.exists()]
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as temporary:
            yield Path(temporary)
    finally:
        for place in created:
            with contextlib.suppress(OSError):
                place.rmdir()


def refuse_existing(folder: Path, *, force: bool) -> None:
    """Raise RobotConfigError if `folder` is a file or a link, or if it is not empty and `force` is False."""
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise RobotConfigError(f"{folder} exists and is not a folder; choose another name")
    if not force and folder.exists() and any(folder.iterdir()):
        raise RobotConfigError(f"{folder} exists already; choose another name, or overwrite its files with --force")


def _with_distinct_files(robot: NewRobot) -> NewRobot:
    """Return the robot with distinct names for its EDS copies, which are all in one folder."""
    names: dict[Path, str] = {}
    for node in robot.nodes:
        path, name = node.device.eds, node.device.eds.name
        number = 2
        while path not in names and name in names.values():
            name, number = f"{path.stem}_{number}{path.suffix}", number + 1
        names.setdefault(path, name)
    return replace(robot, eds_names=names)


def _make_checked(robot: NewRobot, folder: Path) -> tuple[NewRobot, tuple[str, ...]]:
    """Create the files with the first SYNC period that the bus load permits; return the robot and the warnings."""
    errors, warnings, robot = list[str](), tuple[str, ...](), replace(robot, problems=())
    for period in dict.fromkeys([*_dcf_periods(robot), *_PERIODS_US]):
        robot = replace(robot, sync_us=period)
        _make(robot, folder)
        errors, warnings, loaded = _check(folder)
        if not loaded:
            break
    problems = [f"{robot.eds_name(node)}: {node.unusable}" for node in robot.nodes if node.unusable] + errors
    if problems:
        robot = replace(robot, problems=tuple(dict.fromkeys(problems)))
        _make(robot, folder)
    return robot, warnings


def _dcf_periods(robot: NewRobot) -> Iterator[int]:
    """Yield the interpolation periods (0x60C2) in DCF files in us, which should be the SYNC period."""
    for node in robot.drives:
        value, exponent = (node.device.od.get(INTERPOLATION_TIME_PERIOD, subindex) for subindex in (1, 2))
        text = None if value is None else value.parameter_value
        power = -3 if exponent is None else exponent.value
        if isinstance(text, int) and isinstance(power, int) and abs(power) < _LARGEST_POWER:
            period = Fraction(text) * Fraction(10) ** power * 1_000_000
            if _FASTEST_US <= period <= _PERIODS_US[-1] and (1_000_000 / period).denominator == 1:  # a rate in whole Hz
                yield int(period)


def _make(robot: NewRobot, folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    texts = {BUS: bus_text(robot)}
    if not robot.is_bus_alone:
        texts[CONTROLLERS] = controllers_text(robot)
        texts[f"{robot.name}.urdf"] = description_text(robot)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    for path, name in robot.eds_names.items():
        try:
            data = path.read_bytes()
        except OSError as error:
            raise RobotConfigError(f"{path} cannot be copied: {error.strerror}") from error
        (folder / name).write_bytes(data)


def _check(folder: Path) -> tuple[list[str], tuple[str, ...], bool]:
    """Check the files in a folder; return errors, warnings, and whether the bus load is too high."""
    report: CheckReport = check_robot(find_robot(str(folder)), CheckOptions())
    texts = {
        severity: [finding.text for finding in report.findings if finding.severity is severity]
        for severity in (Severity.ERROR, Severity.WARNING)
    }
    loaded = any(not budget.fits or budget.load > HIGH for budget in report.budgets.values())
    return texts[Severity.ERROR], tuple(texts[Severity.WARNING]), loaded
