"""Rules about the parameters of controllers: types that ROS 2 refuses, rates, timeouts, limits of 0, and the clock."""

from __future__ import annotations

import difflib
import math
from typing import TYPE_CHECKING, Final

from canopen_control.check.finding import CheckedRobot, Finding
from canopen_control.controllers.base import sample_type_of
from canopen_control.controllers.command_timeout import DEFAULT_TIMEOUT_S, UNLIMITED
from canopen_control.controllers.controllers_file import ManagerParams
from canopen_control.controllers.declared import declared_by
from canopen_control.controllers.limiters import IMMOBILE, SLOW_STOP
from canopen_control.controllers.mobile_base import ONE_UPDATE
from canopen_control.controllers.types import TYPES
from canopen_control.hardware.plugins import KNOWN, PluginKind
from canopen_control.od.issues import Severity
from canopen_control.rpc.messages.robot import STREAM_RATE
from canopen_control.yamlfile.convert import keys_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.yamlfile.node import Node


def _shared_names(robot: CheckedRobot) -> Iterator[Finding]:
    """Find misspelt parameter names in a block for all ROS nodes (`/**`)."""
    control = robot.control
    if control is None or len(robot.configured) < len(control.controllers):
        return
    keys = set(keys_of(ManagerParams)).union(*(controller.params.known for controller in control.controllers.values()))
    for name, key in control.shared.items():
        close = difflib.get_close_matches(name, keys, 1, 0.8)
        if name not in keys and close:
            text = f"no controller has a parameter {name!r}"
            yield Finding(key.path, key.line, Severity.WARNING, text, f"did you mean {close[0]!r}?")


def _controller_rates(robot: CheckedRobot) -> Iterator[Finding]:
    """Find controllers whose own update_rate is above that of the controller manager (ros2_control warns too)."""
    control = robot.control
    for name, config in () if control is None else control.controllers.items():
        key, node = config.params.flat.keys().get("update_rate"), config.params.flat.get("update_rate")
        rate = 0 if node is None or type(node.value) is not int else node.value
        if control is not None and key is not None and rate > control.update_rate:
            text = f"{name}: update_rate {rate} Hz is above that of the controller manager, {control.update_rate} Hz"
            fix = "remove it, or raise the manager's: a controller runs at most at that rate"
            yield Finding(key.path, key.line, Severity.WARNING, text, fix)


def _publish_rates(robot: CheckedRobot) -> Iterator[Finding]:
    """Find controllers that publish faster than the default rate of the ROS bridge and bags."""
    if robot.control is None:
        return
    sync = robot.bus.master.sync_period if robot.bus is not None else 0
    most = min(robot.control.update_rate, 1_000_000 / sync if sync else math.inf)
    for name, controller in robot.configured.items():
        updates = min(controller.update_rate or most, most)
        rate = 0.0 if sample_type_of(controller) is None else min(controller.publish_rate or updates, updates)
        if rate > STREAM_RATE:
            config = robot.config(name)
            line = config.params.line("publish_rate") or config.params.line("update_rate") or config.line
            text = f"{name} publishes at {rate:g} Hz, but ROS and bags request {STREAM_RATE:g} Hz by default"
            fix = f"run the bridge with --ros-args -p rate:={rate:.1f}, record with --rate {rate:g}"
            yield Finding(config.path, line, Severity.NOTE, text, fix)


def _timeouts(robot: CheckedRobot) -> Iterator[Finding]:
    """Find timeouts that are shorter than two periods of commands."""
    for name, controller in robot.configured.items():
        config = robot.config(name)
        for key in ("cmd_vel_timeout", "reference_timeout", "command_timeout"):
            timeout = getattr(getattr(controller, "params", None), key, None)
            setting = config.params.flat.get(key)
            if timeout is None and setting is not None and isinstance(setting.value, int | float):
                timeout = setting.value
            if timeout and 0.0 < timeout < 2 * COMMAND_PERIOD_S:
                text = f"{name}: {key} {timeout:g} s is below two command periods, so the robot stutters"
                fix = f"give {2 * COMMAND_PERIOD_S:g} s or more: teleop and `twist` send every {COMMAND_PERIOD_S:g} s"
                yield Finding(config.path, config.params.line(key) or config.line, Severity.WARNING, text, fix)


def _notices(robot: CheckedRobot) -> Iterator[Finding]:
    """Find parameters that a controller reports at its configuration: timeouts and limits."""
    for name, controller in robot.configured.items():
        config = robot.config(name)
        for notice in controller.notices:
            if notice.kind == ONE_UPDATE:
                line = config.params.line("reference_timeout") or config.params.line("cmd_vel_timeout") or config.line
                fix = "the robot stutters unless each update receives a twist; 0.5 s is usual"
                yield Finding(config.path, line, Severity.WARNING, notice.text, fix)
            if notice.kind == UNLIMITED:
                line = config.params.line("command_timeout") or config.params.line("cmd_vel_timeout") or config.line
                fix = f"give the time without a command after which the joints stop, such as {DEFAULT_TIMEOUT_S:g} s"
                yield Finding(config.path, line, Severity.WARNING, notice.text, fix)
            if notice.kind == IMMOBILE:
                text, _, fix = notice.text.partition("; ")
                key = text.removeprefix(f"{name}: ").partition(" ")[0].rstrip(",")
                line = config.params.line(key) or config.line
                yield Finding(config.path, line, Severity.WARNING, text, fix)
            if notice.kind == SLOW_STOP:
                text, _, fix = notice.text.partition("; ")
                key = fix.rpartition(" ")[2]  # without it the acceleration limit is that of a stop, too
                default = f"{key.partition('max_')[0]}max_acceleration"
                line = config.params.line(key) or config.params.line(default) or config.line
                yield Finding(config.path, line, Severity.WARNING, text, fix)


_OWN: Final = frozenset(
    {"command_timeout", "measured_state_timeout", "allowed_start_tolerance", "wheel_radius_multiplier"}
)
"""Numbers that ROS 2 does not declare, and therefore accepts in any type."""


def _types(robot: CheckedRobot) -> Iterator[Finding]:
    """Find values of another type than the parameter's, which this package converts and rclcpp refuses.

    rclcpp raises InvalidParameterTypeException for an integer in a double parameter (measured), and for a text in a
    list; a block without ros__parameters is for ROS 1, which converts both.
    """
    for name, controller in robot.configured.items():
        config = robot.config(name)
        if config.ros1 or config.params.source is None or controller.type not in TYPES:
            continue
        nodes = dict(config.params.flat.items())
        for reading in declared_by(config.params.source):
            node = nodes.get(reading.name)
            right = None if node is None or reading.name in _OWN else _converted(reading.kind, node)
            if node is not None and right is not None:
                text = f"{name}: {reading.name}: ROS 2 refuses this value; the parameter is {_KINDS[reading.kind]}"
                yield Finding(node.path, node.line, Severity.WARNING, text, f"write {right}", column=node.column)


_KINDS: Final = {
    "double": "a number with a decimal point",
    "double_array": "a list of numbers with a decimal point",
    "string_array": "a list",
}


def _converted(kind: str, node: Node) -> str | None:
    """Return the value of a parameter of this kind as ROS 2 accepts it; None if it accepts the value as written."""
    if kind == "double" and type(node.value) is int:
        return f"{node.value}.0"
    if kind == "double_array" and any(type(element.value) is int for element in node.elements()):
        numbers = (f"{each.value}.0" if type(each.value) is int else each.text for each in node.elements())
        return f"[{', '.join(numbers)}]"
    return f"[{node.text}]" if kind == "string_array" and node.kind == "scalar" else None


def _sim_time(robot: CheckedRobot) -> Iterator[Finding]:
    """Find `use_sim_time: true` of a robot of which no part is simulated."""
    control, description = robot.control, robot.description
    if control is None or description is None or not description.hardware:
        return
    kinds = {KNOWN.get(tag.plugin) for tag in description.hardware}
    if not (robot.mock or robot.real) and not kinds.isdisjoint({None, PluginKind.SIMULATION}):
        return
    places = [control.manager_keys.get("use_sim_time")] if control.manager.use_sim_time else []
    for config in control.controllers.values():
        value = config.params.flat.get("use_sim_time")
        places += [config.params.flat.keys()["use_sim_time"]] if value is not None and value.value is True else []
    for path, line in dict.fromkeys((place.path, place.line) for place in places if place is not None):
        text = "use_sim_time has no effect: no part of this robot is simulated, so its stamps are this computer's time"
        yield Finding(path, line, Severity.WARNING, text, _REAL_TIME)


_REAL_TIME: Final = "remove it, and start the other nodes without use_sim_time"
COMMAND_PERIOD_S: Final = 0.1
"""Period in s at which teleop and this package's command line send commands."""
PARAMETER_RULES: Final[tuple[Callable[[CheckedRobot], Iterator[Finding]], ...]] = (
    _shared_names,
    _controller_rates,
    _publish_rates,
    _timeouts,
    _notices,
    _types,
    _sim_time,
)
