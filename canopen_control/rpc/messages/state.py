"""State of a robot: `status --json`, the state stream, events and controllers.

SI units; unknown values are None (JSON has no nan); times are Unix time in s; names are the same as in bus.yml and the
description. Keys of messages may be added, but are never renamed.
"""

from __future__ import annotations

import math
from typing import Any, Final, TypeAlias, TypeVar

import msgspec

from canopen_control.cia402.state import State
from canopen_control.errors import without_node
from canopen_control.rpc.messages.declare import Count, NodeId, UnixTime
from canopen_control.rpc.messages.fault import FaultEvent
from canopen_control.rpc.messages.samples import ControllerSample, Sample, Values

S = TypeVar("S", bound=Sample)
N = TypeVar("N", bound="Snapshot")
Planar: TypeAlias = tuple[float, float, float]
"""x and y in m, heading in rad."""


class SdoCounts(msgspec.Struct, frozen=True):
    """Numbers of SDO requests to a node since the robot started."""

    reads: Count = 0
    writes: Count = 0
    failed: Count = 0


class AxisReading(msgspec.Struct, frozen=True, rename={"state": "cia402_state"}):
    """State of an axis; `state` is a CiA 402 state such as "SWITCHED_ON", `mode` a mode such as "PV".

    `fault` is the present fault of the drive, as far as known; `error` is the reported error text.
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
        """Whether the drive is in OPERATION_ENABLED."""
        return self.state == State.OPERATION_ENABLED.name

    @property
    def in_fault(self) -> bool:
        """Whether the drive is in FAULT or FAULT_REACTION_ACTIVE."""
        return self.state in (State.FAULT.name, State.FAULT_REACTION_ACTIVE.name)


class NodeReading(msgspec.Struct, frozen=True, kw_only=True, rename={"age": "age_s"}):
    """State of a node: NMT state such as "OPERATIONAL", `age` of the last frame in s, and errors.

    `taken_out` is True after an NMT command has stopped or reset the node; the robot then ignores the node until a
    command starts it. `void_outputs` are outputs that lost their command when the node was lost, and have no new
    command. `unsupervised` is the reason why nothing stops the node when the master is lost, as permitted by
    `allow_unsupervised`; "" if the node stops. `name` is "" in recordings older than protocol 2, which have the name
    only as a key. `fault` is from the last EMCY message, None after an error reset.
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

    def reason(self, name: str = "") -> str:
        """Return the error text without the node at its start, for a text that names the node; "" without an error."""
        return without_node(self.error or "", self.node_id, name or self.name)


class TrackingReading(msgspec.Struct, frozen=True):
    """Tracking errors of a joint in rad or rad/s (m, m/s), corrected for the dead time of the bus.

    `interface` is the compared quantity, "position" or "velocity"; `error_max` and `error_rms` are for the last
    `window_s`, 5 to 10 s. `repeated` counts positions that were sent again while the joint moved, `skipped` set-points
    that were not sent, both since the joint was enabled.
    """

    interface: str = ""
    window_s: float = 0.0
    error_max: float = 0.0
    error_rms: float = 0.0
    error_max_since_enable: float = 0.0
    error_rms_since_enable: float = 0.0
    repeated: Count = 0
    skipped: Count = 0


UNITS: Final = {"position": ("rad", "m"), "velocity": ("rad/s", "m/s"), "effort": ("Nm", "N")}
"""Units of a revolute and of a prismatic joint, by interface."""


class JointReading(msgspec.Struct, frozen=True):
    """State of a joint: `position` in rad, `velocity` in rad/s, `effort` in Nm (prismatic: m, m/s, N).

    `command` is the current value of the claimed command interface; `others` are the values of further state
    interfaces by name. `name` is "" in recordings older than protocol 2. `tracking` is None for a joint without a
    drive, or one without compared set-points since it was enabled.
    """

    name: str = ""
    position: float | None = None
    velocity: float | None = None
    effort: float | None = None
    command: float | None = None
    others: Values = {}
    tracking: TrackingReading | None = None

    def value(self, interface: str) -> float | None:
        """Return the value of a state interface, or None if it is unknown or missing."""
        if interface == "position":
            return self.position
        if interface == "velocity":
            return self.velocity
        return self.effort if interface == "effort" else self.others.get(interface)

    @property
    def values(self) -> Values:
        """Values of all state interfaces, by name."""
        return {"position": self.position, "velocity": self.velocity, "effort": self.effort, **self.others}


class CycleTimes(msgspec.Struct, frozen=True):
    """Timing of the control cycle; `late_counts` is a histogram of start delays with the bin edges `late_edges_s`."""

    period_s: float = 0.0
    count: Count = 0
    missed: Count = 0
    late_max_s: float = 0.0
    work_s: float = 0.0
    work_max_s: float = 0.0
    late_counts: list[Count] = []


class RobotEvent(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Event of a robot; `time` is Unix time in s, `level` is "info", "warning" or "error".

    `node` is the name of the affected node, None for the robot itself; `controller` is the name of the controller.
    `kind` is one word for programs, `text` a sentence for users, which includes `count` and `since` if it summarises
    several events. `details` is the reported fault, for programs.
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
        """Time of the first of the summarised events, or of the event itself."""
        return self.time if self.since is None else self.since


class TruePose(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """True pose of a simulated base at `time`, in m and rad in the world frame of the simulation.

    `heading` is not wrapped; `z`, `roll` and `pitch` are as in BasePose of the drives. `odom` is the pose of the
    odometry frame in the world frame, chosen so that both poses agreed when they were first known, or when odometry was
    set. `error` is the true pose minus the odometry pose, in the odometry frame; None while no base controller is
    active.
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
        """True pose in the odometry frame, or None if that frame is unknown."""
        if self.odom is None:
            return None
        x, y, turn = self.odom
        cosine, sine = math.cos(turn), math.sin(turn)
        along, across = self.x - x, self.y - y
        return cosine * along + sine * across, cosine * across - sine * along, self.heading - turn

    @property
    def rpy(self) -> Planar | None:
        """Roll, pitch and yaw in the odometry frame, in rad, or None if that frame is unknown."""
        return None if self.odom is None else (self.roll, self.pitch, self.heading - self.odom[2])

    @property
    def words(self) -> str:
        """True pose as text, with the odometry error if known."""
        place = f"true pose {self.x:.3f}, {self.y:.3f} m, {math.degrees(self.heading):.1f} deg"
        if self.error is None:
            return place
        x, y, turn = self.error
        return f"{place}; odometry is off by {1e3 * math.hypot(x, y):.1f} mm and {abs(math.degrees(turn)):.2f} deg"

    def with_odometry_error(self, odometry: Planar) -> TruePose:
        """Return a copy with the error of `odometry`, an odometry pose at the same time."""
        pose = self.in_odometry
        if pose is None:
            return self
        turn = math.remainder(pose[2] - odometry[2], math.tau)
        return msgspec.structs.replace(self, error=(pose[0] - odometry[0], pose[1] - odometry[1], turn))


class Snapshot(msgspec.Struct, frozen=True, kw_only=True):
    """Common fields of status and state samples; `controllers` maps controller names to their states.

    `hint` is the reason why the robot cannot move, with the remedy; `latched_by` is the client
    that latched a stop; `true_pose` exists if a simulation moves the base.
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
        """Names of the active controllers."""
        return [name for name, state in self.controllers.items() if state == "active"]

    def grown(self, kind: type[N], **more: Any) -> N:  # noqa: ANN401 - fields of any type
        """Return a snapshot of the derived type `kind`, with the common fields of this one and the fields `more`."""
        return kind(**{name: getattr(self, name) for name in Snapshot.__struct_fields__}, **more)


class TimedSnapshot(Snapshot, frozen=True, kw_only=True):
    """Snapshot at `time`, with only those fields that recordings of every version have."""

    time: UnixTime


class StateSample(TimedSnapshot, frozen=True, kw_only=True):
    """Sample of the state stream; the `load` of a bus is from 0 to 1, `sim_time` is the simulated time in s.

    `sim_epoch` is the Unix time at which the simulation would have begun if it had never been paused: times of
    `samples` minus `sim_epoch` are simulated time. `samples` are the last publications of the active controllers, by
    controller name.
    """

    time: UnixTime = 0.0
    load: Values = {}
    sim_time: float | None = None
    sim_epoch: float | None = None
    samples: dict[str, ControllerSample] = {}

    def samples_of(self, kind: type[S]) -> dict[str, S]:
        """Return the samples of one kind, by controller name."""
        return {name: sample for name, sample in self.samples.items() if isinstance(sample, kind)}


class BusTraffic(msgspec.Struct, frozen=True):
    """Traffic of a bus as numbers of frames; `load` is from 0 to 1.

    `unknown` counts frames that no node uses. `sync` describes the SYNC producer, the rate, and whether SYNC is sent
    before or after the RPDOs.
    """

    channel: str = ""
    rx: int = 0
    tx: int = 0
    lost: int = 0
    unknown: int = 0
    load: float | None = None
    sync: str = ""


class BootStep(msgspec.Struct, frozen=True):
    """Step of a node's last boot, with its duration in s and its error."""

    node: str
    step: str
    seconds: float
    error: str | None = None


class Status(Snapshot, frozen=True, kw_only=True):
    """Status of a robot as printed by `status --json`; `build` is "compiled" or "pure Python"."""

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
    """State of a controller: "unloaded", "unconfigured", "inactive" or "active".

    `claims` are the claimed command interfaces. `topic` is the topic of commands, None without commands; `twist_axes`
    are the twist components that a base uses, () for other controllers; `update_rate` is in Hz. `tells` is the kind of
    samples, None without samples, and `publish_rate` the sample rate in Hz. `publishes` are the topics of joint states,
    with `frame_id` in the headers. Another controller can command the `reference_interfaces` and read the
    `exported_state_interfaces`. `offers` are services and actions in addition to commands, by the constants above.
    `node_options` are arguments of the ROS node of the controller: `-r`, `FROM:=TO`.
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
        """Whether commands are named output values, which move no joint."""
        return self.topic == "gpio_commands"

    @property
    def is_base(self) -> bool:
        """Whether the controller is commanded by twists."""
        return bool(self.twist_axes) or self.topic == "cmd_vel"

    @property
    def odometry_topic(self) -> str:
        """Last part of a base's odometry topic, which depends on the twist topic."""
        return "odometry" if self.topic == "reference" else "odom"

    @property
    def drives_sideways(self) -> bool:
        """Whether the lateral component of a twist has an effect."""
        return "linear.y" in self.twist_axes

    @property
    def width(self) -> int:
        """Number of values in a command; 0 if unknown."""
        return len(self.required_command_interfaces or self.claims)

    def published(self, kind: str) -> str | None:
        """Return the joint state topic whose last part is `kind`, or None."""
        return next((publish for publish in self.publishes if publish.rsplit("/", 1)[-1] == kind), None)

    def became(self, state: str) -> ControllerReading:
        """Return a copy of this reading with another state."""
        return msgspec.structs.replace(self, state=state)
