"""Controller types, by their names in ros2_controllers.yaml.

The class of a type is imported when the first controller of this type is loaded. Types that are not in the table come
from the entry point group `canopen_control.controllers` of any installed package.
"""

from __future__ import annotations

import importlib
from typing import Final

from canopen_control.controllers.base import Controller
from canopen_control.errors import ControlError, nearest

GROUP: Final = "canopen_control.controllers"

_ROOT: Final = "canopen_control.controllers"
TYPES: Final = {
    "forward_command_controller/ForwardCommandController": f"{_ROOT}.forward_command:ForwardCommandController",
    "forward_command_controller/MultiInterfaceForwardCommandController": (
        f"{_ROOT}.forward_command:MultiInterfaceForwardCommandController"
    ),
    "velocity_controllers/JointGroupVelocityController": f"{_ROOT}.forward_command:JointGroupVelocityController",
    "position_controllers/JointGroupPositionController": f"{_ROOT}.forward_command:JointGroupPositionController",
    "effort_controllers/JointGroupEffortController": f"{_ROOT}.forward_command:JointGroupEffortController",
    "velocity_controllers/JointVelocityController": f"{_ROOT}.forward_command:JointVelocityController",
    "position_controllers/JointPositionController": f"{_ROOT}.forward_command:JointPositionController",
    "effort_controllers/JointEffortController": f"{_ROOT}.forward_command:JointEffortController",
    "diff_drive_controller/DiffDriveController": f"{_ROOT}.diff_drive:DiffDriveController",
    "bicycle_steering_controller/BicycleSteeringController": f"{_ROOT}.steering:BicycleSteeringController",
    "tricycle_steering_controller/TricycleSteeringController": f"{_ROOT}.steering:TricycleSteeringController",
    "tricycle_controller/TricycleController": f"{_ROOT}.tricycle:TricycleController",
    "ackermann_steering_controller/AckermannSteeringController": f"{_ROOT}.steering:AckermannSteeringController",
    "mecanum_drive_controller/MecanumDriveController": f"{_ROOT}.holonomic:MecanumDriveController",
    "omni_wheel_drive_controller/OmniWheelDriveController": f"{_ROOT}.holonomic:OmniWheelDriveController",
    "joint_trajectory_controller/JointTrajectoryController": f"{_ROOT}.trajectory.controller:JointTrajectoryController",
    "pid_controller/PidController": f"{_ROOT}.pid_controller:PidController",
    "gpio_controllers/GpioCommandController": f"{_ROOT}.gpio_command:GpioCommandController",
    "joint_state_broadcaster/JointStateBroadcaster": f"{_ROOT}.joint_state:JointStateBroadcaster",
    "joint_state_controller/JointStateController": f"{_ROOT}.joint_state:JointStateBroadcaster",
    "canopen_ros2_controllers/CanopenProxyController": f"{_ROOT}.gpio_command:CanopenProxyController",
    "canopen_ros2_controllers/Cia402DeviceController": f"{_ROOT}.gpio_command:Cia402DeviceController",
    "position_controllers/GripperActionController": f"{_ROOT}.gripper:PositionGripperActionController",
    "effort_controllers/GripperActionController": f"{_ROOT}.gripper:EffortGripperActionController",
    "parallel_gripper_action_controller/GripperActionController": f"{_ROOT}.gripper:ParallelGripperActionController",
    "imu_sensor_broadcaster/IMUSensorBroadcaster": f"{_ROOT}.broadcasters:IMUSensorBroadcaster",
    "range_sensor_broadcaster/RangeSensorBroadcaster": f"{_ROOT}.broadcasters:RangeSensorBroadcaster",
    "force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster": (
        f"{_ROOT}.broadcasters:ForceTorqueSensorBroadcaster"
    ),
    "pose_broadcaster/PoseBroadcaster": f"{_ROOT}.broadcasters:PoseBroadcaster",
    "battery_state_broadcaster/BatteryStateBroadcaster": f"{_ROOT}.broadcasters:BatteryStateBroadcaster",
    "canopen_control/TargetController": f"{_ROOT}.forward_command:TargetController",
    "canopen_control/GpioBroadcaster": f"{_ROOT}.broadcasters:GpioBroadcaster",
    "canopen_control/DiagnosticsBroadcaster": f"{_ROOT}.broadcasters:DiagnosticsBroadcaster",
}
"""Classes of the controller types as `module:class`; types of one joint and joint_state_controller are from ROS 1."""


def is_broadcaster(type_name: str) -> bool:
    """Whether controllers of this type are broadcasters; False for unknown types."""
    return bool(getattr(class_of(type_name), "is_broadcaster", False))


def moves_joints(type_name: str) -> bool:
    """Whether controllers of this type move joints; True for unknown types."""
    controller_class = class_of(type_name)
    return not is_broadcaster(type_name) and bool(getattr(controller_class, "moves_joints", True))


def roller_wheels(type_name: str) -> tuple[str, ...]:
    """Return the parameters of a type that name joints of mecanum wheels; empty for unknown types."""
    return tuple(getattr(class_of(type_name), "roller_wheels", ()))


def make_controller(name: str, type_name: str) -> Controller:
    """Create a controller; raise ControlError if the type is unknown or cannot be loaded."""
    target = TYPES.get(type_name) or _entry_point(type_name)
    if target is None:
        raise ControlError(f"controller {name}: unknown type {type_name!r}{nearest(type_name, TYPES)}")
    module, _, class_name = target.partition(":")
    try:
        controller = getattr(importlib.import_module(module), class_name)(name, type_name)
    except (ImportError, AttributeError, TypeError) as error:
        raise ControlError(f"controller {name}: its type {type_name!r} cannot be loaded: {error}") from error
    if not isinstance(controller, Controller):
        raise ControlError(f"controller {name}: {target} is not canopen_control.controllers.base.Controller")
    return controller


def class_of(type_name: str) -> type[Controller] | None:
    """Return the class of a type; None if the type is unknown or its module cannot be imported."""
    target = TYPES.get(type_name) or _entry_point(type_name)
    if target is None:
        return None
    module, _, class_name = target.partition(":")
    try:
        return getattr(importlib.import_module(module), class_name, None)
    except ImportError:
        return None


def _entry_point(type_name: str) -> str | None:
    from importlib.metadata import entry_points  # needed only for types of other packages, and slow to import

    entries = entry_points(group=GROUP, name=type_name)
    return next((entry.value for entry in entries), None)
