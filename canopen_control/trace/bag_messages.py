"""Messages of ROS 2 Jazzy for a bag, and those of control_msgs, which rosbags does not know, by their definitions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import ConfigError
from canopen_control.ros.conversions import stamp_of, unknown_as_nan
from canopen_control.ros.interfaces.definition import DEFINITIONS
from canopen_control.rpc.messages.samples import MecanumSample, PidSample, SteeringSample, TrajectorySample

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.rpc.messages.samples import Sample, TrajectoryPoint

__all__ = ["BagMessages"]

_ADDED: Final = tuple(
    f"control_msgs/msg/{each}"
    for each in (
        "JointTrajectoryControllerState",
        "SingleDOFState",
        "MultiDOFStateStamped",
        "SteeringControllerStatus",
        "MecanumDriveControllerState",
        "InterfaceValue",
        "DynamicInterfaceGroupValues",
        "BatteryStateArray",
    )
)


class BagMessages:
    """The messages of Jazzy as rosbags makes them; one short method for each that is nested in several.

    `states` makes the `controller_state` of what a controller tells, by the kind of that; what broadcasters tell is in
    `bag_sensors`.
    """

    def __init__(self) -> None:
        try:
            from numpy import array
            from rosbags.typesys import Stores, get_types_from_msg, get_typestore
        except ImportError as error:
            text = "a bag is written by rosbags, which is not installed: pip install 'canopen-control[bag]'"
            raise ConfigError(text) from error
        self.store = get_typestore(Stores.ROS2_JAZZY)
        for name in _ADDED:
            self.store.register(get_types_from_msg("\n".join(DEFINITIONS[name]), name))
        self.array = array
        self.states: dict[type[Sample], Callable[[Any], object]] = {
            TrajectorySample: self._trajectory,
            PidSample: self._loops,
            SteeringSample: self._steering,
            MecanumSample: self._mecanum,
        }

    def make(self, kind: str, *values: Any) -> Any:  # noqa: ANN401 - rosbags makes the classes at run time
        """Return a message of `package/Name` with its fields in order."""
        return self.store.types[kind.replace("/", "/msg/")](*values)

    def time(self, unix_s: float) -> Any:  # noqa: ANN401 - as above
        """Return a stamp."""
        return self.make("builtin_interfaces/Time", *stamp_of(unix_s))

    def header(self, unix_s: float, frame: str) -> Any:  # noqa: ANN401 - as above
        """Return a header."""
        return self.make("std_msgs/Header", self.time(unix_s), frame)

    def vector(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:  # noqa: ANN401 - as above
        """Return a vector."""
        return self.make("geometry_msgs/Vector3", float(x), float(y), float(z))

    def twist(self, linear: float, angular: float, lateral: float = 0.0) -> Any:  # noqa: ANN401 - as above
        """Return a twist of a base: m/s and rad/s."""
        return self.make("geometry_msgs/Twist", self.vector(linear, lateral), self.vector(z=angular))

    def floats(self, values: Iterable[float]) -> Any:  # noqa: ANN401 - a numpy array
        """Return an array of numbers."""
        return self.array(list(values), dtype=float)

    # What controllers tell -----------------------------------------------------------------------------------------

    def _trajectory(self, sample: TrajectorySample) -> object:
        """Return where the joints of a trajectory were to be and where they were."""
        points = [self._point(each) for each in (sample.reference, sample.feedback, sample.error, sample.output)]
        nowhere = self.make("trajectory_msgs/MultiDOFJointTrajectoryPoint", [], [], [], self._duration(0.0))
        return self.make(
            "control_msgs/JointTrajectoryControllerState",
            self.header(sample.time, ""),
            list(sample.joints),
            *points,
            [],
            *[nowhere] * len(points),
            sample.speed_scaling_factor,
        )

    def _point(self, point: TrajectoryPoint) -> object:
        values = (point.positions, point.velocities, point.accelerations, point.effort)
        after = self._duration(point.time_from_start)
        return self.make("trajectory_msgs/JointTrajectoryPoint", *map(self.floats, values), after)

    def _duration(self, seconds: float) -> object:
        return self.make("builtin_interfaces/Duration", *stamp_of(seconds))

    def _loops(self, sample: PidSample) -> object:
        """Return what each degree of freedom of a PID controller was kept at."""
        dofs = [
            self.make(
                "control_msgs/SingleDOFState",
                each.name,
                *map(unknown_as_nan, (each.reference, each.feedback, each.feedback_dot, each.error, each.error_dot)),
                each.time_step,
                unknown_as_nan(each.output),
            )
            for each in sample.dofs
        ]
        return self.make("control_msgs/MultiDOFStateStamped", self.header(sample.time, ""), dofs)

    def _steering(self, sample: SteeringSample) -> object:
        """Return the wheels of a steered base, measured and commanded."""
        columns = (
            sample.traction_positions,
            sample.traction_velocities,
            sample.steering,
            sample.traction_commands,
            sample.steering_commands,
        )
        values = [self.floats(map(unknown_as_nan, each)) for each in columns]
        return self.make("control_msgs/SteeringControllerStatus", self.header(sample.time, sample.frame_id), *values)

    def _mecanum(self, sample: MecanumSample) -> object:
        """Return the wheels of a mecanum base, and the twist that is wanted."""
        unknown = (None,) * 4  # of a base that has not told them yet
        ahead, lateral, turning = map(unknown_as_nan, (*sample.reference, *unknown)[:3])
        return self.make(
            "control_msgs/MecanumDriveControllerState",
            self.header(sample.time, sample.frame_id),
            *map(unknown_as_nan, (*sample.wheels, *unknown)[:4]),
            self.twist(ahead, turning, lateral),
        )
