"""Socket of a running robot for all other processes: methods and pushed messages.

Answers may arrive in another order than the requests. The kind of an error is a class in errors.py, such as UnknownName
for an unknown name in the request. SI units; times are Unix time in s.

A client that reads too slowly is disconnected; when a client ends, only its commands end. If the server has no free
connection, an idle client without subscription and command is disconnected in favour of a new client, with a message.
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

# Requests for the nodes of a running robot and their objects: NMT, SDO, PDO and touch probes.


MAX_OBJECT: Final = 400_000  # maximum size in bytes of an object in an answer, and in `sdo_data`

NodeName = str | int  # name or node-ID
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
    """Node in the files of a robot: its bus, the path of its EDS, and its settings from bus.yml.

    `axes` is the number of CiA 402 axes in the EDS; `joints` are the joints that the node moves, none for a proxy.
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
    """Channel of a bus, and the node-ID of its master."""

    channel: str
    node_id: int | None = None


class NodeListing(msgspec.Struct, frozen=True):
    """All buses by name, and all nodes of a robot."""

    buses: dict[str, BusPlace] = {}
    nodes: list[NodePlace] = []


class GetNodes(Request[NodeListing], frozen=True):
    """Return all buses, and all nodes with their bus and EDS."""


class NmtRequest(Request[Done], frozen=True, kw_only=True):
    """Send the NMT `command` start, stop, preop, reset-node or reset-comm to a node or "all".

    With `boot` true the node is booted again after a reset; otherwise the node waits for `start`. `source` is the name
    of the sender in the robot's events.
    """

    command: str
    node: NodeName
    boot: bool = False
    source: str | None = None


class SdoData(msgspec.Struct, frozen=True):
    """Data of an uploaded object."""

    data: bytes


class SdoRead(Request[SdoData], frozen=True, kw_only=True):
    """Upload an object; `timeout` is in s per answer (null: the timeout of the node), `block` uses block transfer.

    `session` is a name that the client chooses, by which `sdo_cancel` selects the transfer.
    """

    node: NodeName
    index: Index
    subindex: Subindex = 0
    block: bool = False
    timeout: Seconds | None = None
    session: str | None = None


class SdoWrite(Request[Done], frozen=True, kw_only=True):
    """Download an object; downloads that move an axis are refused while a stop is latched.

    An event of the robot names the sender, which is `source`, or the client's program if `source` is null. `session`
    is as in `sdo_read`.
    """

    node: NodeName
    index: Index
    subindex: Subindex = 0
    data: bytes
    timeout: Seconds | None = None
    source: str | None = None
    session: str | None = None


class SdoProgress(msgspec.Struct, frozen=True):
    """Progress of an SDO transfer in transferred and total bytes; 0 and null if unknown."""

    done: Count = 0
    total: Count | None = None


class GetSdoProgress(Request[SdoProgress], frozen=True, kw_only=True):
    """Return the progress of the current SDO transfer with a node, even of another client."""

    node: NodeName


class CancelSdo(Request[Done], frozen=True, kw_only=True):
    """Cancel the transfers of a session with a node, which then abort; a transfer of one frame is completed."""

    node: NodeName
    session: str


class SdoPiece(Request[Done], frozen=True, kw_only=True):
    """Send a part of the data of this connection's next `sdo_write`, because a request is limited to 64 KiB."""

    data: bytes


class PdoWrite(Request[Done], frozen=True, kw_only=True):
    """Send an object once in the RPDO that maps it; refused for objects that move an axis."""

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
    """Return the touch probe objects of a node's first axis: function, status and captured positions."""

    node: NodeName


NODE_METHODS: Final = (
    ("nodes", Effect.READS, GetNodes),
    ("nmt", Effect.MOVES, NmtRequest),
    ("sdo_read", Effect.READS, SdoRead),
    ("sdo_write", Effect.MOVES, SdoWrite),
    ("sdo_data", Effect.CHANGES, SdoPiece),
    ("sdo_progress", Effect.READS, GetSdoProgress),
    ("sdo_cancel", Effect.CHANGES, CancelSdo),
    ("pdo_write", Effect.CHANGES, PdoWrite),
    ("touch_probe", Effect.READS, ReadTouchProbe),
)


MAX_RATE: Final = 1000.0  # Hz, maximum rate of the state stream
STREAM_RATE: Final = 100.0  # Hz, the maximum that ROS and bags request by default

Rate = Annotated[float, msgspec.Meta(gt=0, le=MAX_RATE)]


class RobotHello(msgspec.Struct, frozen=True):
    """Greeting of a robot; `pid` is the process id of the robot."""

    robot: str
    version: str = ""
    protocol: int = 0
    pid: int = 0


class MappedValue(msgspec.Struct, frozen=True, array_like=True):
    """Mapped object with the bytes received in a TPDO."""

    index: int
    subindex: int
    data: bytes


class ProcessData(msgspec.Struct, frozen=True):
    """Contents of received TPDOs by node name; the first message has all objects, later ones the changes."""

    time: float
    nodes: dict[str, list[MappedValue]]


class RequestSeen(msgspec.Struct, frozen=True):
    """Accepted client request with its parameters; read-only requests are not reported."""

    time: float
    method: str
    params: msgspec.Raw


RobotPush = StateSample | RobotEvent | ProcessData | RequestSeen
ROBOT: Final[Api[RobotHello, RobotPush]] = Api(
    "robot", RobotHello, {"state": StateSample, "event": RobotEvent, "pdos": ProcessData, "asked": RequestSeen}
)


# -- status and events


@ROBOT.method("status", Effect.READS)
class GetStatus(Request[Status], frozen=True):
    """Return the status of the robot, as printed by `status --json`."""


@ROBOT.method("subscribe", Effect.READS)
class Subscribe(Request[Done], frozen=True, kw_only=True):
    """Subscribe to state samples (`state_rate` in Hz, null: none), events, TPDO contents and clients' requests."""

    state_rate: Rate | None = None
    events: bool = False
    pdos: bool = False
    requests: bool = False


@ROBOT.method("tell", Effect.CHANGES)
class PublishEvent(Request[Done], frozen=True, kw_only=True):
    """Publish an event to all subscribers; `kind` is one word, `level` is "info" or "warning"."""

    kind: str
    text: str
    level: str = "info"


# -- motion


class CommandDone(msgspec.Struct, frozen=True, omit_defaults=True):
    """Result of a command; `idle` lists the joints that do not follow the command, each with the reason and the remedy.

    A command is accepted if at least one joint follows.
    """

    idle: dict[str, str] = {}


@ROBOT.method("command", Effect.MOVES)
class CommandController(Request[CommandDone], frozen=True, kw_only=True):
    """Send command values to a controller; a `dead_man` command ends when this connection is closed.

    Refused with NotEnabled while a drive of the controller is disabled, and with NotYetEnabled while it is being
    enabled. `interface` is the quantity of the values; the command is refused if the controller's quantity differs,
    such as for a target in another mode.
    """

    controller: str
    values: list[float]
    source: str | None = None
    dead_man: bool = False
    interface: str | None = None


@ROBOT.method("command_by_name", Effect.MOVES)
class CommandByName(Request[CommandDone], frozen=True, kw_only=True):
    """Command some interfaces of a controller by name, such as "io/lamp"; the others are unchanged.

    Only GPIO command controllers accept this request. A `dead_man` command ends when this connection is closed.
    """

    controller: str
    values: dict[str, float]
    source: str | None = None
    dead_man: bool = False


@ROBOT.method("twist", Effect.MOVES)
class TwistController(Request[CommandDone], frozen=True, kw_only=True):
    """Command a base with a twist: `linear` forward and `lateral` to the left in m/s, `angular` in rad/s.

    `lateral` must be 0 for a base that cannot drive sideways. `stamp` is the Unix time of the twist in s, null for now.
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
    """Ramp all joints down to a standstill and disable the drives; answered when everything has stopped.

    With `latch` true the stop is latched: nothing moves before `release`, for any client.
    """

    latch: bool = False
    source: str | None = None


@ROBOT.method("release", Effect.CHANGES)
class Release(Request[Done], frozen=True, kw_only=True):
    """Release a latched stop; the drives stay disabled."""

    source: str | None = None


@ROBOT.method("shutdown", Effect.STOPS)
class Shutdown(Request[Done], frozen=True):
    """Stop all joints, then end the robot."""


@ROBOT.method("set_odometry", Effect.CHANGES)
class SetOdometry(Request[Done], frozen=True, kw_only=True):
    """Set the pose of a base controller's odometry, in m and rad."""

    controller: str
    x: float
    y: float
    heading: float


@ROBOT.method("set_feed_forward", Effect.CHANGES)
class SetFeedForward(Request[Done], frozen=True, kw_only=True):
    """Enable or disable the feed-forward of a PID controller's references (`~/set_feedforward_control`)."""

    controller: str
    enabled: bool


@ROBOT.method("set_measured_states", Effect.MOVES)
class SetMeasuredStates(Request[Done], frozen=True, kw_only=True):
    """Set the measured states of a PID controller, and then their derivatives (`~/measured_state`)."""

    controller: str
    values: list[float]


class AxisDone(msgspec.Struct, frozen=True, omit_defaults=True):
    """Result of an axis request; `text` names the other axes of a base that were also affected, or is ""."""

    text: str = ""


_LONGEST_ACTION_S: Final = 3600.0


@ROBOT.method("axis", Effect.MOVES)
class AxisRequest(Request[AxisDone], frozen=True, kw_only=True):
    """Execute `action`: enable, disable, halt, quick-stop, fault-reset, home (`method`) or mode (`mode`, such as CSP).

    `node` may be "all"; `joint` selects one axis of a multi-axis node. `source` is the name of the sender in events,
    by default the name of the client's program.
    """

    action: str
    node: NodeName
    joint: str | None = None
    method: int | None = None
    mode: str | None = None
    source: str | None = None

    def timeout_s(self, usual: float) -> float:
        """Return a client's timeout in s: `usual`, or an hour for actions that the robot ends by limits of bus.yml.

        These limits are homing_timeout_seconds and transition_timeouts_ms.
        """
        return _LONGEST_ACTION_S if self.action in ("enable", "home") else usual


# -- controllers and hardware components


@ROBOT.method("controllers", Effect.READS)
class ListControllers(Request[tuple[ControllerReading, ...]], frozen=True, kw_only=True):
    """List the loaded controllers; `all` adds the unloaded controllers in ros2_controllers.yaml."""

    all: bool = False


@ROBOT.method("controller_types", Effect.READS)
class ListControllerTypes(Request[list[str]], frozen=True):
    """List the valid controller types."""


@ROBOT.method("load", Effect.CHANGES)
class LoadController(Request[Done], frozen=True, kw_only=True):
    """Load a controller from ros2_controllers.yaml and configure it, unless `configure` is false."""

    controller: str
    configure: bool = True


@ROBOT.method("configure", Effect.CHANGES)
class ConfigureController(Request[Done], frozen=True, kw_only=True):
    """Configure a loaded controller."""

    controller: str


@ROBOT.method("cleanup", Effect.CHANGES)
class CleanupController(Request[Done], frozen=True, kw_only=True):
    """Clean up an inactive controller, which also unloads it."""

    controller: str


@ROBOT.method("unload", Effect.CHANGES)
class UnloadController(Request[Done], frozen=True, kw_only=True):
    """Unload an inactive controller."""

    controller: str


@ROBOT.method("switch", Effect.CHANGES)
class SwitchControllers(Request[Done], frozen=True, kw_only=True):
    """Activate and deactivate controllers in one step; with `strict` a partial switch is refused."""

    activate: tuple[str, ...] = ()
    deactivate: tuple[str, ...] = ()
    strict: bool = True


ROBOT.declare(PARAMETER_METHODS)
ROBOT.declare(SIMULATION_METHODS)


class InterfaceReading(msgspec.Struct, frozen=True):
    """Interface of a hardware component, with a name such as "joint/position"."""

    name: str
    available: bool
    claimed: bool = False


class HardwareReading(msgspec.Struct, frozen=True, kw_only=True):
    """Hardware component as in ros2_control's `list_hardware_components`; `rate` is in Hz."""

    name: str
    type: str
    plugin: str
    state: str
    rate: int
    command_interfaces: list[InterfaceReading]
    state_interfaces: list[InterfaceReading]


@ROBOT.method("hardware", Effect.READS)
class ListHardware(Request[list[HardwareReading]], frozen=True):
    """List the hardware components."""


class ComponentState(msgspec.Struct, frozen=True):
    """Lifecycle state of a hardware component."""

    state: str


@ROBOT.method("set_hardware_state", Effect.CHANGES)
class SetHardwareState(Request[ComponentState], frozen=True, kw_only=True):
    """Set a hardware component to "unconfigured", "inactive" or "active", which causes no motion."""

    component: str
    state: str


# -- nodes and their objects

ROBOT.declare(NODE_METHODS)


@ROBOT.method("layout", Effect.READS)
class GetLayout(Request[Layout], frozen=True):
    """Return the PDO mappings of all buses."""


class Description(msgspec.Struct, frozen=True, omit_defaults=True):
    """Description of a robot as URDF text; `path` is the source file.

    `world` has the objects around a simulated robot in a recording; for a running robot, the drives have these objects.
    """

    urdf: str
    path: str = ""
    world: tuple[WorldShape, ...] = ()


@ROBOT.method("description", Effect.READS)
class GetDescription(Request[Description], frozen=True):
    """Return the robot's description as URDF, after xacro processing."""
