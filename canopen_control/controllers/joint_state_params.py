"""The parameters of the joint state broadcaster; keys, defaults and meaning are those of ros2_controllers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from canopen_control.controllers.common_params import CommonParams
from canopen_control.hardware.interfaces import EFFORT, POSITION, VELOCITY
from canopen_control.yamlfile.convert import setting

__all__ = ["RENAMES", "BroadcasterParams"]

_MAP: Final = "map_interface_to_joint_state."


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


RENAMES: Final = {"publish_rate": "update_rate"}
"""ROS 1's joint_state_controller published at a rate of its own."""
