"""The parameters of the forward command controllers, the joint state broadcaster, and of a loop of any controller.

Keys, defaults and meaning are those of ros2_controllers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from canopen_control.controllers.params import CommonParams
from canopen_control.controllers.pid import AntiWindup, Gains
from canopen_control.hardware.interfaces import EFFORT, POSITION, VELOCITY
from canopen_control.yamlfile.convert import setting

__all__ = ["RENAMES", "BroadcasterParams", "ForwardParams", "GroupParams", "LoopGains", "MultiParams", "SingleParams"]

_MAP: Final = "map_interface_to_joint_state."


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


@dataclass(frozen=True)
class BroadcasterParams(CommonParams):
    """Parameters of joint_state_broadcaster/JointStateBroadcaster."""

    joints: tuple[str, ...] = ()
    interfaces: tuple[str, ...] = ()
    extra_joints: tuple[str, ...] = ()
    position: str = setting(POSITION, key=_MAP + POSITION)
    velocity: str = setting(VELOCITY, key=_MAP + VELOCITY)
    effort: str = setting(EFFORT, key=_MAP + EFFORT)
    use_local_topics: bool = False
    use_urdf_to_filter: bool = True
    frame_id: str = "base_link"
    publish_dynamic_joint_states: bool = True


@dataclass(frozen=True)
class LoopGains:
    """The gains of a PID loop, by the names of control_toolbox; ValueError for what cannot be together.

    Such are limits that exclude each other, and a back calculation whose time constant neither is given nor follows
    from the gains: upstream then computes what is no number.
    """

    p: float = 0.0
    i: float = 0.0
    d: float = 0.0
    i_clamp_max: float = math.inf
    i_clamp_min: float = -math.inf
    u_clamp_max: float = math.inf
    u_clamp_min: float = -math.inf
    antiwindup_strategy: str = setting("legacy", choices=tuple(each.value for each in AntiWindup))
    tracking_time_constant: float = 0.0
    error_deadband: float = 0.0

    def __post_init__(self) -> None:
        for key, value in (("p", self.p), ("i", self.i), ("d", self.d)):
            if not math.isfinite(value):
                raise ValueError(f"{key} is {value}; give a finite number")
        given = self.pid()
        if given.anti_windup is AntiWindup.BACK_CALCULATION and given.i and not given.tracking_time_used > 0.0:
            raise ValueError(
                f"back_calculation has no time constant with p {self.p:g}, i {self.i:g}, d {self.d:g}; "
                f"give tracking_time_constant"
            )

    @property
    def integral_limits(self) -> tuple[float, float]:
        """The most and the least of the integral."""
        return self.i_clamp_max, self.i_clamp_min

    @property
    def clamps_integral(self) -> bool:
        """Whether the integral itself is kept within them, as ROS 1 did."""
        return False

    def pid(self) -> Gains:
        """Return what the loop is given."""
        return Gains(
            self.p,
            self.i,
            self.d,
            *self.integral_limits,
            self.u_clamp_max,
            self.u_clamp_min,
            AntiWindup(self.antiwindup_strategy),
            self.tracking_time_constant,
            self.error_deadband,
            self.clamps_integral,
        )


RENAMES: Final = {"publish_rate": "update_rate"}
"""ROS 1's joint_state_controller published at a rate of its own."""
