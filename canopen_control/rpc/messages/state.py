"""State of a robot: `status --json`, the state stream, events, controllers.

SI units, None where nothing is known (JSON has no nan), times in Unix seconds, and the same names as in bus.yml and the
description. On the wire keys may be added, never renamed.
"""

from __future__ import annotations

import math
from typing import Final, TypeAlias, TypeVar

import msgspec

from canopen_control.cia402.state import State
from canopen_control.rpc.messages.declare import Count, NodeId, UnixTime
from canopen_control.rpc.messages.fault import FaultEvent
from canopen_control.rpc.messages.samples import ControllerSample, Sample, Values

S = TypeVar("S", bound=Sample)
Planar: TypeAlias = tuple[float, float, float]
"""x and y in m, heading in rad."""


class SdoCounts(msgspec.Struct, frozen=True):
    """The SDO requests of a node since the robot started."""

    reads: Count = 0
    writes: Count = 0
    failed: Count = 0


class AxisReading(msgspec.Struct, frozen=True, rename={"state": "cia402_state"}):
    """State of an axis: `state` as in CiA 402, such as "SWITCHED_ON", `mode` such as "PV".

    `fault` is the one that its drive is in, as far as it is known, and `error` what is reported of it.
    """

    joint: str
    axis: int = 0
    state: str | None = None
    statusword: int | None = None
    mode: str | None = None
    error: str | None = None
    fault: FaultEvent | None = None

    @property
    def enabled(self) -> bool:
        """Whether the drive is enabled and follows commands."""
        return self.state == State.OPERATION_ENABLED.name


class NodeReading(msgspec.Struct, frozen=True, kw_only=True, rename={"age": "age_s"}):
    """State of a node: NMT state such as "OPERATIONAL", `age` of its last frame in s, errors.

    `taken_out`: an NMT command has taken it out of the robot, which leaves it alone until another one starts it.
    `void_outputs` were commanded when it was lost, and not since: they are as the device has them.
    `unsupervised` is why nothing stops it when the master is lost, as `allow_unsupervised` accepts; "" if it stops.
    `name` is empty in a recording from before protocol 2, which has it as the key alone. `fault` is that of its last
    EMCY, None after an error reset.
    """

    name: str = ""
    node_id: NodeId
    bus: str = ""
    nmt_state: str | None = None
    ready: bool = False
    age: float | None = None
    taken_out: bool = False
    error: str | None = None
    sdo: SdoCounts = SdoCounts()
    axes: tuple[AxisReading, ...] = ()
    void_outputs: tuple[str, ...] = ()
    unsupervised: str = ""
    fault: FaultEvent | None = None


class TrackingReading(msgspec.Struct, frozen=True):
    """Tracking of a joint: errors in rad or rad/s (m, m/s), corrected for the dead time of the bus.

    `interface` is what is compared, "position" or "velocity"; `error_max` and `error_rms` are of the last `window_s`,
    5 to 10 s. `repeated` counts positions that were sent again while the joint moved, `skipped` set-points that were
    never sent; both since it was enabled, as the other two.
    """

    interface: str = ""
    window_s: float = 0.0
    error_max: float = 0.0
    error_rms: float = 0.0
    error_max_since_enable: float = 0.0
    error_rms_since_enable: float = 0.0
    repeated: Count = 0
    skipped: Count = 0


class JointReading(msgspec.Struct, frozen=True):
    """State of a joint: `position` in rad, `velocity` in rad/s, `effort` in Nm (prismatic: m, m/s, N).

    `command` is what its controller writes now, in the unit of the interface that it claims; `others` are the values of
    its further state interfaces by their name. `name` is empty in a recording from before protocol 2. `tracking` is
    None for a joint without a drive, or that has not moved since it was enabled.
    """

    name: str = ""
    position: float | None = None
    velocity: float | None = None
    effort: float | None = None
    command: float | None = None
    others: Values = {}
    tracking: TrackingReading | None = None

    def value(self, interface: str) -> float | None:
        """Return the value of a state interface, None if it does not exist."""
        if interface == "position":
            return self.position
        if interface == "velocity":
            return self.velocity
        return self.effort if interface == "effort" else self.others.get(interface)

    @property
    def values(self) -> Values:
        """Values of all state interfaces by name."""
        return {"position": self.position, "velocity": self.velocity, "effort": self.effort, **self.others}


class CycleTimes(msgspec.Struct, frozen=True):
    """Timing of the cycle; `late_counts[i]` is the number of cycles at most `late_edges_s[i]` late."""

    period_s: float = 0.0
    count: Count = 0
    missed: Count = 0
    late_max_s: float = 0.0
    work_s: float = 0.0
    work_max_s: float = 0.0
    late_counts: list[Count] = []


class RobotEvent(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Event of the robot: `time` in Unix seconds, `level` "info", "warning" or "error".

    `node` is the name of the node concerned, None for the robot itself, `controller` that of the controller; `kind`
    is one word for programs, `text` a sentence for people, which includes `count` and `since` if it summarises
    several. `details` is the fault that it reports, for programs.
    """

    time: UnixTime
    kind: str
    node: str | None
    level: str
    text: str
    count: Count = 1
    since: UnixTime | None = None
    details: FaultEvent | None = None
    controller: str | None = None

    @property
    def first(self) -> float:
        """Time of its first occurrence."""
        return self.time if self.since is None else self.since


class TruePose(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """True pose of a simulated base at `time`: m and rad in the frame of its world.

    `heading` is not wrapped, `z`, `roll` and `pitch` are as the drives' BasePose has them. `odom` is where the frame of
    odometry is in the world: there the two agreed when both were known first, or odometry was set. `error` is the true
    pose less odometry, seen in odometry's frame; None while no base controller is active.
    """

    time: UnixTime
    x: float
    y: float
    heading: float
    z: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0
    odom: Planar | None = None
    error: Planar | None = None

    @property
    def in_odometry(self) -> Planar | None:
        """True pose in the frame of odometry, None if unknown."""
        if self.odom is None:
            return None
        x, y, turn = self.odom
        cosine, sine = math.cos(turn), math.sin(turn)
        along, across = self.x - x, self.y - y
        return cosine * along + sine * across, cosine * across - sine * along, self.heading - turn

    @property
    def rpy(self) -> Planar | None:
        """Roll, pitch and yaw in the frame of odometry, in rad; None if unknown."""
        return None if self.odom is None else (self.roll, self.pitch, self.heading - self.odom[2])

    @property
    def words(self) -> str:
        """True pose of the base and error of its odometry, as text."""
        place = f"true pose {self.x:.3f}, {self.y:.3f} m, {math.degrees(self.heading):.1f} deg"
        if self.error is None:
            return place
        x, y, turn = self.error
        return f"{place}; odometry is off by {1e3 * math.hypot(x, y):.1f} mm and {abs(math.degrees(turn)):.2f} deg"

    def with_odometry_error(self, odometry: Planar) -> TruePose:
        """Return the true pose with the error of the odometry at that time."""
        pose = self.in_odometry
        if pose is None:
            return self
        turn = math.remainder(pose[2] - odometry[2], math.tau)
        return msgspec.structs.replace(self, error=(pose[0] - odometry[0], pose[1] - odometry[1], turn))


class Snapshot(msgspec.Struct, frozen=True, kw_only=True):
    """Common part of sample and status; `controllers` are their states by name.

    `hint` is the reason why the robot cannot move and the action to call, while it runs; `latched_by` is the client
    that latched a stop; `true_pose` exists if a simulation moves its base.
    """

    state: str = ""
    hint: str | None = None
    latched: bool = False
    latched_by: str | None = None
    cycle: CycleTimes = CycleTimes()
    nodes: dict[str, NodeReading] = {}
    joints: dict[str, JointReading] = {}
    controllers: dict[str, str] = {}
    true_pose: TruePose | None = None

    @property
    def active(self) -> list[str]:
        """The names of the active controllers."""
        return [name for name, state in self.controllers.items() if state == "active"]


class TimedSnapshot(Snapshot, frozen=True, kw_only=True):
    """Snapshot at `time` with the fields in recordings of every version."""

    time: UnixTime


class StateSample(TimedSnapshot, frozen=True, kw_only=True):
    """Sample of the state stream; `load` of each bus from 0 to 1, `sim_time` in s in a simulation.

    `sim_epoch` is when the simulation would have begun had its time never stood, by which times of `samples` are the
    simulation's. `samples` are what the active controllers have published last, by their names.
    """

    time: UnixTime = 0.0
    load: Values = {}
    sim_time: float | None = None
    sim_epoch: float | None = None
    samples: dict[str, ControllerSample] = {}

    def samples_of(self, kind: type[S]) -> dict[str, S]:
        """Return the samples of one kind by controller."""
        return {name: sample for name, sample in self.samples.items() if isinstance(sample, kind)}


class BusTraffic(msgspec.Struct, frozen=True):
    """Traffic of a bus: frames, `unknown` ones, and its load from 0 to 1.

    `sync` describes the SYNC producer, its rate, and whether SYNC comes before or after the RPDOs.
    """

    channel: str = ""
    rx: int = 0
    tx: int = 0
    lost: int = 0
    unknown: int = 0
    load: float | None = None
    sync: str = ""


class BootStep(msgspec.Struct, frozen=True):
    """One step of a node's last boot."""

    node: str
    step: str
    seconds: float
    error: str | None = None


class Status(Snapshot, frozen=True, kw_only=True):
    """Everything that `status --json` prints; `build` is "compiled" or "pure Python"."""

    robot: str = ""
    version: str = ""
    build: str = ""
    late_edges_s: list[float] = []
    buses: dict[str, BusTraffic] = {}
    boot: list[BootStep] = []
    failure: str | None = None
    commander: str | None = None
    events: list[RobotEvent] = []
    missing_programs: dict[str, str] = {}


GRIPPER_GOALS: Final = "gripper_goals"
PARALLEL_GRIPPER_GOALS: Final = "parallel_gripper_goals"
ODOMETRY_RESET: Final = "odometry_reset"
NODE_SERVICES: Final = "node_services"
DRIVE_SERVICES: Final = "drive_services"
WHEEL_CALIBRATION: Final = "wheel_calibration"


class ControllerReading(msgspec.Struct, frozen=True, kw_only=True, rename={"claims": "claimed_interfaces"}):
    """State of a controller: "unloaded", "unconfigured", "inactive" or "active"; `claims` are its interfaces.

    `topic` is the topic of its commands, None if it takes none, `twist_axes` the axes of a twist that a base uses,
    empty for other controllers, `update_rate` in Hz. `tells` is the kind of its samples, None if it has none,
    `publish_rate` their rate in Hz. `publishes` are its topics of joint states, with `frame_id` in their headers.
    `reference_interfaces` are the interfaces that another controller can command of it,
    `exported_state_interfaces` what it may read. `offers` are the words above for what it takes beside commands.
    `node_options` are arguments of its ROS node: `-r`, `FROM:=TO`.
    """

    name: str
    type: str
    state: str
    joints: tuple[str, ...] = ()
    interface: str | None = None
    claims: tuple[str, ...] = ()
    required_command_interfaces: tuple[str, ...] = ()
    required_state_interfaces: tuple[str, ...] = ()
    reference_interfaces: tuple[str, ...] = ()
    exported_state_interfaces: tuple[str, ...] = ()
    topic: str | None = None
    twist_axes: tuple[str, ...] = ()
    publishes: tuple[str, ...] = ()
    frame_id: str = ""
    tells: str | None = None
    offers: tuple[str, ...] = ()
    is_broadcaster: bool = False
    rejected: int = 0
    update_rate: int = 0
    publish_rate: float = 0.0
    node_options: tuple[str, ...] = ()

    @property
    def active(self) -> bool:
        """Whether the controller is active."""
        return self.state == "active"

    @property
    def takes_outputs(self) -> bool:
        """Whether its commands are output values by name, without moving a joint."""
        return self.topic == "gpio_commands"

    @property
    def is_base(self) -> bool:
        """Whether twists command the controller."""
        return bool(self.twist_axes) or self.topic == "cmd_vel"

    @property
    def odometry_topic(self) -> str:
        """Last part of the name of a base's odometry topic, which corresponds to its twist topic."""
        return "odometry" if self.topic == "reference" else "odom"

    @property
    def drives_sideways(self) -> bool:
        """Whether a twist to the left has an effect."""
        return "linear.y" in self.twist_axes

    @property
    def width(self) -> int:
        """Number of values of a command, 0 if unknown."""
        return len(self.required_command_interfaces or self.claims)

    def published(self, kind: str) -> str | None:
        """Return the topic with the last name `kind`, None if it does not exist."""
        return next((publish for publish in self.publishes if publish.rsplit("/", 1)[-1] == kind), None)

    def became(self, state: str) -> ControllerReading:
        """Return the same controller in another state."""
        return msgspec.structs.replace(self, state=state)
