"""Which topics a controller has: by the kind of its commands and of its samples, by what it publishes, by its type.

A new kind of command or sample gets a line here and an `Endpoint` in a file of its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.ros.actions import FollowJointTrajectory, GripperAction, ParallelGripperAction
from canopen_control.ros.base_topics import (
    BaseOdometry,
    MecanumState,
    OdometrySetting,
    SteeringState,
    TfOdometry,
    TwistCommands,
)
from canopen_control.ros.command_topics import (
    FeedForwardSwitch,
    ForwardCommands,
    GpioCommands,
    PidMeasuredStates,
    PidReferences,
    PidState,
)
from canopen_control.ros.drive_topics import DeviceNode, ProxyNode
from canopen_control.ros.interfaces import MissingInterface
from canopen_control.ros.joint_states import JointStates
from canopen_control.ros.state_topics import (
    BatteryTopics,
    DynamicJointStates,
    GpioStates,
    ImuTopic,
    PoseTopic,
    RangeTopic,
    WrenchTopic,
)
from canopen_control.ros.trajectory_topics import SpeedScalingTopic, TrajectoryQuery, TrajectoryState, TrajectoryTopic

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.ros.endpoint import Endpoint, Ros
    from canopen_control.rpc.messages.state import ControllerReading

    Factory = Callable[[Ros, ControllerReading], Endpoint]


#: by where its commands come (`topic` of the API)
BY_TOPIC: Final[dict[str | None, tuple[Factory, ...]]] = {
    "commands": (ForwardCommands,),
    "reference": (PidReferences,),
    "gpio_commands": (GpioCommands,),
}
#: of a base, wherever its twists come
OF_BASES: Final[tuple[Factory, ...]] = (TwistCommands, OdometrySetting)
#: by the last word of each topic that it tells (`publishes` of the API)
BY_PUBLISHED: Final[dict[str, Factory]] = {
    "joint_states": JointStates,
    "dynamic_joint_states": DynamicJointStates,
}
#: by the kind of its samples (`tells` of the API)
BY_SAMPLE: Final[dict[str | None, tuple[Factory, ...]]] = {
    "odometry": (BaseOdometry,),
    "steering": (BaseOdometry, TfOdometry, SteeringState),
    "mecanum": (BaseOdometry, TfOdometry, MecanumState),
    "gpio": (GpioStates,),
    "trajectory": (FollowJointTrajectory, TrajectoryTopic, TrajectoryState, TrajectoryQuery, SpeedScalingTopic),
    "pid": (PidState, PidMeasuredStates, FeedForwardSwitch),
    "imu": (ImuTopic,),
    "range": (RangeTopic,),
    "wrench": (WrenchTopic,),
    "pose": (PoseTopic,),
    "batteries": (BatteryTopics,),
}
#: by its type: which action, or whose node
BY_TYPE: Final[dict[str, tuple[Factory, ...]]] = {
    "position_controllers/GripperActionController": (GripperAction,),
    "effort_controllers/GripperActionController": (GripperAction,),
    "parallel_gripper_action_controller/GripperActionController": (ParallelGripperAction,),
    "canopen_ros2_controllers/CanopenProxyController": (ProxyNode,),
    "canopen_ros2_controllers/Cia402DeviceController": (DeviceNode,),
}


def endpoints_for(ros: Ros, controller: ControllerReading) -> list[Endpoint]:
    """Make the topics of one controller."""
    published = [make for kind, make in BY_PUBLISHED.items() if controller.published(kind) is not None]
    commands = OF_BASES if controller.is_base else BY_TOPIC.get(controller.topic, ())
    own = (*commands, *BY_SAMPLE.get(controller.tells, ()))
    factories = (*own, *published, *BY_TYPE.get(controller.type, ()))
    return [endpoint for make in factories for endpoint in _made(make, ros, controller)]


def _made(make: Factory, ros: Ros, controller: ControllerReading) -> Iterator[Endpoint]:
    """Yield an endpoint, none where this ROS does not have its interface: the controller's others are there."""
    try:
        yield make(ros, controller)
    except MissingInterface as error:
        ros.leave_out(error.name)
