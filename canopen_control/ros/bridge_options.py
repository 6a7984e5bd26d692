"""Options of the ROS bridge, from the command line and from the parameters of the bridge's node.

A parameter (`--ros-args -p NAME:=VALUE`, `--params-file`) overrides an argument, and is read when the bridge starts. An
invalid value is reported in one sentence.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Final

from canopen_control.errors import ConfigError
from canopen_control.rpc.messages.robot import MAX_RATE

if TYPE_CHECKING:
    from canopen_control.ros.rcl import Node


CMD_VEL_TYPES: Final = ("auto", "Twist", "TwistStamped", "off")


@dataclass(frozen=True, slots=True)
class BridgeOptions:
    """Options of the bridge; each field is also a ROS parameter of the same name.

    `rate` is the rate of the state stream in Hz, 0 for the rates of the controllers; `frame_prefix` precedes the name
    of every frame. `cmd_vel_type` is one of `CMD_VEL_TYPES`, for the shared topic `cmd_vel_topic`. `topic_hardware`
    enables the topics for a controller manager elsewhere; `lifecycle` creates `/lifecycle_manager` even if bus.yml has
    no lifecycle drivers.
    """

    rate: float = 0.0
    tf: bool = True
    frame_prefix: str = ""
    cmd_vel_topic: str = "cmd_vel"
    cmd_vel_type: str = "auto"
    drives: bool = True
    lifecycle: bool = False
    topic_hardware: bool = False
    joint_commands_topic: str = "/robot_joint_commands"
    joint_states_topic: str = "/robot_joint_states"


def with_parameters(node: Node, options: BridgeOptions) -> BridgeOptions:
    """Return the options overridden by the node's parameters; raise ConfigError if a value is invalid."""
    values = {}
    for field in fields(BridgeOptions):
        default = getattr(options, field.name)
        if not node.has_parameter(field.name):
            try:
                node.declare_parameter(field.name, default)
            except Exception as error:
                raise ConfigError(f"parameter {field.name}: {error}") from error
        values[field.name] = node.get_parameter(field.name).value
    return _checked(replace(options, **values))


def _checked(options: BridgeOptions) -> BridgeOptions:
    if options.cmd_vel_type not in CMD_VEL_TYPES:
        raise ConfigError(f"parameter cmd_vel_type is {options.cmd_vel_type!r}; give one of {', '.join(CMD_VEL_TYPES)}")
    if not 0.0 <= options.rate <= MAX_RATE:
        raise ConfigError(f"parameter rate is {options.rate:g} Hz; give a rate from 0 to {MAX_RATE:g} Hz")
    return options
