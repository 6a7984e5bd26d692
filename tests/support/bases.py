"""The golden vectors of bases on wheels, and how what they say is compared."""

from __future__ import annotations

from typing import Any

from support.control import Hardware, add, manager, vectors
from support.trajectories import close

TRICYCLE = "tricycle_steering_controller/TricycleSteeringController"
BICYCLE = "bicycle_steering_controller/BicycleSteeringController"
ACKERMANN = "ackermann_steering_controller/AckermannSteeringController"
MECANUM = "mecanum_drive_controller/MecanumDriveController"
OMNI = "omni_wheel_drive_controller/OmniWheelDriveController"

STEERED = {"wheelbase": 1.2, "reference_timeout": 0.5}
TWO_WHEELS = {"traction_joints_names": ["r", "l"], "traction_wheels_radius": 0.1, "traction_track_width": 0.8}
PARAMS: dict[str, dict[str, Any]] = {
    BICYCLE: {**STEERED, "traction_joints_names": ["w"], "steering_joints_names": ["s"], "traction_wheel_radius": 0.1},
    TRICYCLE: {**STEERED, **TWO_WHEELS, "steering_joints_names": ["s"]},
    ACKERMANN: {**STEERED, **TWO_WHEELS, "steering_joints_names": ["sr", "sl"]},
    MECANUM: {
        "reference_timeout": 0.5,
        "kinematics.wheels_radius": 0.05,
        "kinematics.sum_of_robot_center_projection_on_X_Y_axis": 0.4,
        **{
            f"{wheel}_wheel_command_joint_name": wheel
            for wheel in ("front_left", "front_right", "rear_right", "rear_left")
        },
    },
    OMNI: {"wheel_names": ["a", "b", "c"], "wheel_offset": 0.3, "robot_radius": 0.2, "wheel_radius": 0.05},
}
"""Parameters that suffice, by type."""


def base(kind: str, **params: Any) -> tuple[Hardware, Any, Any]:
    """Return hardware, manager and a configured base of a type, at standstill; `a__b` in a name is `a.b`."""
    inputs = PARAMS[kind]
    steered = inputs.get("steering_joints_names", [])
    named = inputs.get("traction_joints_names") or inputs.get("wheel_names")
    wheels = named or [name for key, name in inputs.items() if key.endswith("_joint_name")]
    hardware = Hardware(
        *(f"{wheel}/velocity" for wheel in wheels),
        *(f"{joint}/position" for joint in steered),
        states=tuple(f"{joint}/{kind}" for joint in (*wheels, *steered) for kind in ("position", "velocity")),
        name="base",
    )
    for interface in hardware.state_interfaces:
        interface.value = 0.0
    control = manager(hardware)
    return hardware, control, add(control, "base", kind, **{**inputs, **params})


def cases(group: str) -> list[Any]:
    """Return the cases of a group of the bases' vectors."""
    return vectors(group, "bases.json")


def differences(found: dict[str, Any], wanted: dict[str, Any], tolerance: float) -> dict[str, Any]:
    """Return what is not as the vectors have it: (found, wanted) by name; flags are equal or not."""
    return {
        key: (found[key], value)
        for key, value in wanted.items()
        if key in found and not (found[key] is value or _close(found[key], value, tolerance))
    }


def _close(found: Any, wanted: Any, tolerance: float) -> bool:
    if isinstance(wanted, bool):
        return bool(found is wanted)
    return close(_listed(found), _listed(wanted), tolerance)


def _listed(value: Any) -> list[float]:
    return list(value) if isinstance(value, (list, tuple)) else [value]
