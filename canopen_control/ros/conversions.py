"""Conversions from API messages to fields of ROS messages, without importing ROS.

Rules (REP 103, REP 107, ros2_control): both sides use SI units; unknown values of the API (None) become nan; all arrays
of a joint state have the same length; a stamp is the time of the sample, not of its transmission.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.rpc.messages.samples import OdometrySample, PoseSample
from canopen_control.urdf.geometry import Pose, from_yaw
from canopen_control.urdf.joint_element import Transform

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.rpc.messages.samples import JointStatesSample, Sample, Values
    from canopen_control.rpc.messages.state import ControllerReading, JointReading, StateSample


class JointArrays(NamedTuple):
    """Names, positions, velocities and efforts of a JointState message, all of the same length."""

    names: list[str]
    position: list[float]
    velocity: list[float]
    effort: list[float]


def stamp_of(unix_s: float) -> tuple[int, int]:
    """Split a Unix time in s into whole seconds and nanoseconds."""
    seconds = math.floor(unix_s)
    return seconds, min(round((unix_s - seconds) * 1e9), 999_999_999)


def joint_arrays(joints: Mapping[str, JointReading], names: Sequence[str] = ()) -> JointArrays:
    """Return the states of the known joints in `names`, or of all joints sorted by name; unknown values are nan."""
    values = {name: joint.values for name, joint in joints.items()}
    return arrays_of(values, [name for name in names if name in values] if names else sorted(values))


def arrays_of(values: Mapping[str, Values], names: Sequence[str]) -> JointArrays:
    """Return the position, velocity and effort of each joint in `names`; `values` has them by joint and interface."""
    columns = [
        [unknown_as_nan(values[name].get(kind)) for name in names] for kind in ("position", "velocity", "effort")
    ]
    return JointArrays(list(names), *columns)


def positions_of(sample: JointStatesSample) -> dict[str, float]:
    """Return the known joint positions of a sample by joint name."""
    positions = {name: sample.joints[name].get("position") for name in sample.names}
    return {name: position for name, position in positions.items() if position is not None}


def seconds_of(seconds: int, nanoseconds: int) -> float | None:
    """Return a ROS time stamp in s, or None if it is zero."""
    return seconds + nanoseconds / 1e9 if seconds or nanoseconds else None


def diagonal(values: Sequence[float]) -> list[float]:
    """Return a 6x6 covariance matrix with the diagonal `values`, row by row; all zeros if `values` is empty."""
    covariance = [0.0] * 36
    for row, value in enumerate(values[:6]):
        covariance[7 * row] = float(value)
    return covariance


def odometry_pose(sample: OdometrySample) -> Transform:
    """Return the odometry pose of a base, as a transform from the odometry frame to the base frame."""
    pose = Pose((sample.x, sample.y, 0.0), from_yaw(sample.heading))
    return Transform(sample.frame_id, sample.child_frame_id, pose)


def transform_of(sample: Sample) -> Transform | None:
    """Return the transform of an odometry or pose sample; None if disabled or unknown, or for any other sample."""
    if isinstance(sample, OdometrySample):
        return odometry_pose(sample) if sample.enable_odom_tf and math.isfinite(sample.x) else None
    if not isinstance(sample, PoseSample) or sample.child_frame_id is None:
        return None
    numbers = [number for number in (*sample.position, *sample.orientation) if number is not None]
    if len(numbers) < len(sample.position) + len(sample.orientation):
        return None
    x, y, z, *around, w = numbers
    return Transform(sample.frame_id, sample.child_frame_id, Pose((x, y, z), (w, around[0], around[1], around[2])))


def located_frames(state: StateSample) -> frozenset[str]:
    """Return the child frames of odometry and pose transforms, for which no joint transform may be published."""
    samples = (*state.samples_of(OdometrySample).values(), *state.samples_of(PoseSample).values())
    return frozenset(transform.child for transform in map(transform_of, samples) if transform is not None)


def command_refusal(values: Sequence[float], controller: ControllerReading) -> str | None:
    """Return why the robot would refuse a command with these values, or None if it is valid."""
    if not all(map(math.isfinite, values)):
        return f"{controller.name}: a value is not finite: {_shown(values)}; the command was dropped"
    if controller.width and len(values) != controller.width:
        return f"{controller.name} expects {controller.width} values, got {len(values)}; the command was dropped"
    if not controller.active:
        return f"{controller.name} is {controller.state}; activate it before commanding it"
    return None


def _shown(values: Sequence[float], most: int = 8) -> str:
    more = ", ..." if len(values) > most else ""
    return f"[{', '.join(f'{value:g}' for value in values[:most])}{more}]"


def unknown_as_nan(value: float | None) -> float:
    """Return the value, or nan for None (unknown)."""
    return math.nan if value is None else value
