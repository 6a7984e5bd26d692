"""The parameters of the forward command controllers, ROS 1's position, velocity and effort controllers among them."""

from __future__ import annotations

from dataclasses import dataclass

from canopen_control.controllers.common_params import CommonParams
from canopen_control.yamlfile.convert import setting

__all__ = ["ForwardParams", "GroupParams", "MultiParams", "SingleParams"]


@dataclass(frozen=True)
class GroupParams(CommonParams):
    """Parameters of the group controllers: `command_timeout` in s, see `command_life` for what absent and 0 mean."""

    joints: tuple[str, ...] = ()
    command_timeout: float | None = setting(None, low=0.0, high=1e9)


@dataclass(frozen=True)
class ForwardParams(GroupParams):
    """Parameters of forward_command_controller/ForwardCommandController."""

    interface_name: str = ""


@dataclass(frozen=True)
class SingleParams(CommonParams):
    """Parameters of ROS 1's controllers of one joint; the gains of `pid` are the drive's own business."""

    joint: str = ""
    command_timeout: float | None = setting(None, low=0.0, high=1e9)


@dataclass(frozen=True)
class MultiParams(CommonParams):
    """Parameters of forward_command_controller/MultiInterfaceForwardCommandController."""

    joint: str = ""
    interface_names: tuple[str, ...] = ()
    command_timeout: float | None = setting(None, low=0.0, high=1e9)
