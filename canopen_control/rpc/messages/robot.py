"""Socket of a running robot for all other processes: methods and pushed messages.

Answers may come in another order than the requests. An error's kind is a class of errors.py: UnknownName where there is
nothing of a name that was given. SI units; times are Unix seconds.

A client that reads too slowly is disconnected; the end of a client only ends its commands. If the server has no free
connection, an idle client without subscription and command is disconnected for a new one, with a message.
"""

from __future__ import annotations

from typing import Annotated, Final

import msgspec

from canopen_control.rpc.messages.declare import Api, Count, Done, Effect, Index, Request, Subindex
from canopen_control.rpc.messages.drive import WorldShape
from canopen_control.rpc.messages.gripper import GRIPPER_METHODS
from canopen_control.rpc.messages.layout import Layout
from canopen_control.rpc.messages.parameters import PARAMETER_METHODS
from canopen_control.rpc.messages.simulation import SIMULATION_METHODS
from canopen_control.rpc.messages.state import ControllerReading, RobotEvent, StateSample, Status
from canopen_control.rpc.messages.trajectory import (
    TRAJECTORY_METHODS,
)

# Requests about the nodes of a running robot and their objects: states, NMT, SDO, PDO, touch probes.


MAX_OBJECT: Final = 400_000  # bytes of an object that an answer can carry; as many are taken in pieces

NodeName = str | int  # or its node id
Seconds = Annotated[float, msgspec.Meta(gt=0, le=60)]


class NodeIdentity(msgspec.Struct, frozen=True):
    """Expected values of 0x1000 and 0x1018 at boot; 0 accepts any value."""

    device_type: int = 0
    vendor_id: int = 0
    product_code: int = 0
    revision_number: int = 0
    serial_number: int = 0
    eds_revision: int = 0


class NodePlace(msgspec.Struct, frozen=True, kw_only=True):
    """Place of a node: its bus, the path of its EDS, and its section of bus.yml.

    `axes` counts those of CiA 402 that its EDS has, `joints` are what it moves: none for a proxy.
    """

    name: str
    node_id: int
    bus: str = ""
    eds: str = ""
    identity: NodeIdentity = NodeIdentity()
    driver: str | None = None
    namespace: str = ""
    remappings: dict[str, str] = {}
    channel_names: list[str] | None = None
    joints: list[str] = []
    axes: int = 0


class BusPlace(msgspec.Struct, frozen=True):
    """A bus and the master's node id on it."""

    channel: str
    node_id: int | None = None


class NodeListing(msgspec.Struct, frozen=True):
    """All buses by name, and all nodes."""

    buses: dict[str, BusPlace] = {}
    nodes: list[NodePlace] = []


class GetNodes(Request[NodeListing], frozen=True):
    """Bus and EDS of each node."""


class NmtRequest(Request[Done], frozen=True, kw_only=True):
    """NMT `command`: start, stop, preop, reset-node, reset-comm; `node` may be "all".

    `boot` true: after a reset the node is booted again; else it waits for `start`. `source` is the name of the sender
    in the robot's events.
    """

    command: str
    node: NodeName
    boot: bool = False
    source: str | None = None


class SdoData(msgspec.Struct, frozen=True):
    """The bytes of an object."""

    data: bytes


class SdoRead(Request[SdoData], frozen=True, kw_only=True):
    """Upload an object; `timeout` in s per answer (null: the node's), `block` requests block transfer."""

    node: NodeName
    index: Index
    subindex: Subindex = 0
    block: bool = False
    timeout: Seconds | None = None


class SdoWrite(Request[Done], frozen=True, kw_only=True):
    """Download an object; writes that move an axis are refused while a stop is latched. Events name the client.

    `source` is by whose name, that of the client's program without one.
    """

    node: NodeName
    index: Index
    subindex: Subindex = 0
    data: bytes
    timeout: Seconds | None = None
    source: str | None = None


class SdoProgress(msgspec.Struct, frozen=True):
    """Progress of a transfer in bytes, done and total; 0 and null if unknown."""

    done: Count = 0
    total: Count | None = None


class GetSdoProgress(Request[SdoProgress], frozen=True, kw_only=True):
    """Progress of the present SDO transfer with a node, of any client."""

    node: NodeName


class SdoPiece(Request[Done], frozen=True, kw_only=True):
    """Part of the data for this connection's next `sdo_write`, because a request is limited to 64 KiB."""

    data: bytes


class PdoWrite(Request[Done], frozen=True, kw_only=True):
    """Send an object once in the RPDOs that map it, with the next cycle and SYNC; not for motion objects."""

    node: NodeName
    index: Index
    subindex: Subindex = 0
    data: bytes


class TouchProbe(msgspec.Struct, frozen=True, omit_defaults=True):
    """Touch probe objects of an axis (0x60B8 to 0x60BD) in device units; missing objects are omitted."""

    function: int | None = None
    status: int | None = None
    probe_1_positive: int | None = None
    probe_1_negative: int | None = None
    probe_2_positive: int | None = None
    probe_2_negative: int | None = None


class ReadTouchProbe(Request[TouchProbe], frozen=True, kw_only=True):
    """Captured positions of a node's touch probes."""

    node: NodeName


NODE_METHODS: Final = (
    ("nodes", Effect.READS, GetNodes),
    ("nmt", Effect.MOVES, NmtRequest),
    ("sdo_read", Effect.READS, SdoRead),
    ("sdo_write", Effect.MOVES, SdoWrite),
    ("sdo_data", Effect.CHANGES, SdoPiece),
    ("sdo_progress", Effect.READS, GetSdoProgress),
    ("pdo_write", Effect.CHANGES, PdoWrite),
    ("touch_probe", Effect.READS, ReadTouchProbe),
)


MAX_RATE: Final = 1000.0  # Hz, of the state stream
STREAM_RATE: Final = 100.0  # Hz, the maximum that ROS and bags request by default

Rate = Annotated[float, msgspec.Meta(gt=0, le=MAX_RATE)]


class RobotHello(msgspec.Struct, frozen=True):
    """Greeting of a robot; `pid` is its process."""

    robot: str
    version: str = ""
    protocol: int = 0
    pid: int = 0


class MappedValue(msgspec.Struct, frozen=True, array_like=True):
    """Object received in a TPDO."""

    index: int
    subindex: int
    data: bytes


class ProcessData(msgspec.Struct, frozen=True):
    """Contents of TPDOs by node: first all objects, then the changes of each cycle."""

    time: float
    nodes: dict[str, list[MappedValue]]


class RequestSeen(msgspec.Struct, frozen=True):
    """Accepted request of a client, with its parameters; read-only requests are omitted."""

    time: float
    method: str
    params: msgspec.Raw


RobotPush = StateSample | RobotEvent | ProcessData | RequestSeen
ROBOT: Final[Api[RobotHello, RobotPush]] = Api(
    "robot", RobotHello, {"state": StateSample, "event": RobotEvent, "pdos": ProcessData, "asked": RequestSeen}
)


# -- what it does


@ROBOT.method("status", Effect.READS)
class GetStatus(Request[Status], frozen=True):
    """Status, as `status --json` prints it."""


@ROBOT.method("subscribe", Effect.READS)
class Subscribe(Request[Done], frozen=True, kw_only=True):
    """Subscribe to state samples at `state_rate` in Hz (null: none), events, TPDO contents and requests."""

    state_rate: Rate | None = None
    events: bool = False
    pdos: bool = False
    requests: bool = False


@ROBOT.method("tell", Effect.CHANGES)
class PublishEvent(Request[Done], frozen=True, kw_only=True):
    """Publish an event to all subscribers; `kind` is one word, `level` "info" or "warning"."""

    kind: str
    text: str
    level: str = "info"


# -- motion


@ROBOT.method("command", Effect.MOVES)
class CommandController(Request[Done], frozen=True, kw_only=True):
    """Command a controller; a `dead_man` command ends when this connection closes.

    Refused as NotEnabled while a drive of the controller is off, as NotYetEnabled while it comes up. `interface` is
    what the sender takes the values for; refused where they are something else now, as a target in another mode.
    """

    controller: str
    values: list[float]
    source: str | None = None
    dead_man: bool = False
    interface: str | None = None


@ROBOT.method("command_by_name", Effect.MOVES)
class CommandByName(Request[Done], frozen=True, kw_only=True):
    """Command some of a controller's interfaces by name, such as "io/lamp"; the others are unchanged.

    A GPIO command controller takes them. They end with `dead_man` as a command does.
    """

    controller: str
    values: dict[str, float]
    source: str | None = None
    dead_man: bool = False


@ROBOT.method("twist", Effect.MOVES)
class TwistController(Request[Done], frozen=True, kw_only=True):
    """Command a base: forward and, if holonomic, `lateral` to the left in m/s, `angular` in rad/s.

    `stamp` is when it was made.
    """

    controller: str
    linear: float
    angular: float
    lateral: float = 0.0
    source: str | None = None
    dead_man: bool = False
    stamp: float | None = None


ROBOT.declare(TRAJECTORY_METHODS)
ROBOT.declare(GRIPPER_METHODS)


@ROBOT.method("stop", Effect.STOPS)
class Stop(Request[Done], frozen=True, kw_only=True):
    """Ramp to zero and disable; answered when no drive moves.

    `latch` true: nothing moves before `release`, for any client.
    """

    latch: bool = False
    source: str | None = None


@ROBOT.method("release", Effect.CHANGES)
class Release(Request[Done], frozen=True, kw_only=True):
    """Release a latched stop; the drives stay disabled."""

    source: str | None = None


@ROBOT.method("shutdown", Effect.STOPS)
class Shutdown(Request[Done], frozen=True):
    """Stop, then end the robot."""


@ROBOT.method("set_odometry", Effect.CHANGES)
class SetOdometry(Request[Done], frozen=True, kw_only=True):
    """Set the odometry of a base controller, in m and rad."""

    controller: str
    x: float
    y: float
    heading: float


@ROBOT.method("set_feed_forward", Effect.CHANGES)
class SetFeedForward(Request[Done], frozen=True, kw_only=True):
    """Whether the references of a PID controller lead (`~/set_feedforward_control`)."""

    controller: str
    enabled: bool


@ROBOT.method("set_measured_states", Effect.MOVES)
class SetMeasuredStates(Request[Done], frozen=True, kw_only=True):
    """Set the measured states of a PID controller's degrees of freedom, then derivatives (`~/measured_state`)."""

    controller: str
    values: list[float]


class AxisDone(msgspec.Struct, frozen=True, omit_defaults=True):
    """Result of an axis request: `text` if it affected further axes of a base controller."""

    text: str = ""


@ROBOT.method("axis", Effect.MOVES)
class AxisRequest(Request[AxisDone], frozen=True, kw_only=True):
    """`action`: enable, disable, halt, quick-stop, fault-reset, home (`method`), mode (`mode`: a name such as CSP).

    `node` may be "all"; `joint` selects one axis of a node with several. The events name `source`, or else the client,
    as the sender.
    """

    action: str
    node: NodeName
    joint: str | None = None
    method: int | None = None
    mode: str | None = None
    source: str | None = None


# -- controllers and hardware components


@ROBOT.method("controllers", Effect.READS)
class ListControllers(Request[tuple[ControllerReading, ...]], frozen=True, kw_only=True):
    """List the controllers; with `all` also the unloaded ones of ros2_controllers.yaml."""

    all: bool = False


@ROBOT.method("controller_types", Effect.READS)
class ListControllerTypes(Request[list[str]], frozen=True):
    """List the valid `type` names of controllers."""


@ROBOT.method("load", Effect.CHANGES)
class LoadController(Request[Done], frozen=True, kw_only=True):
    """Load a controller of ros2_controllers.yaml and configure it; not configured with `configure` false, as in ROS."""

    controller: str
    configure: bool = True


@ROBOT.method("configure", Effect.CHANGES)
class ConfigureController(Request[Done], frozen=True, kw_only=True):
    """Configure a loaded controller."""

    controller: str


@ROBOT.method("cleanup", Effect.CHANGES)
class CleanupController(Request[Done], frozen=True, kw_only=True):
    """Undo `configure`; a controller keeps no state between two loads."""

    controller: str


@ROBOT.method("unload", Effect.CHANGES)
class UnloadController(Request[Done], frozen=True, kw_only=True):
    """Unload an inactive controller."""

    controller: str


@ROBOT.method("switch", Effect.CHANGES)
class SwitchControllers(Request[Done], frozen=True, kw_only=True):
    """Activate and deactivate controllers in one step; with `strict` false as far as possible."""

    activate: tuple[str, ...] = ()
    deactivate: tuple[str, ...] = ()
    strict: bool = True


ROBOT.declare(PARAMETER_METHODS)
ROBOT.declare(SIMULATION_METHODS)


class InterfaceReading(msgspec.Struct, frozen=True):
    """Interface of a component, named "joint/interface"."""

    name: str
    available: bool
    claimed: bool = False


class HardwareReading(msgspec.Struct, frozen=True, kw_only=True):
    """Hardware component as in `list_hardware_components`; `rate` in Hz."""

    name: str
    type: str
    plugin: str
    state: str
    rate: int
    command_interfaces: list[InterfaceReading]
    state_interfaces: list[InterfaceReading]


@ROBOT.method("hardware", Effect.READS)
class ListHardware(Request[list[HardwareReading]], frozen=True):
    """The hardware components."""


class ComponentState(msgspec.Struct, frozen=True):
    """The state of a hardware component."""

    state: str


@ROBOT.method("set_hardware_state", Effect.CHANGES)
class SetHardwareState(Request[ComponentState], frozen=True, kw_only=True):
    """Set a component to "unconfigured", "inactive" or "active" without any motion."""

    component: str
    state: str


# -- nodes and their objects

ROBOT.declare(NODE_METHODS)


@ROBOT.method("layout", Effect.READS)
class GetLayout(Request[Layout], frozen=True):
    """PDO mappings of each bus."""


class Description(msgspec.Struct, frozen=True, omit_defaults=True):
    """Return the robot's description; `path` is its source file.

    `world` is the world around a simulated robot in a recording; for a running robot it is read from its drives.
    """

    urdf: str
    path: str = ""
    world: tuple[WorldShape, ...] = ()


@ROBOT.method("description", Effect.READS)
class GetDescription(Request[Description], frozen=True):
    """The robot's description, after xacro."""
