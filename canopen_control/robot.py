"""Library interface `Robot`, for a robot that this program starts or that is already running.

    with Robot.from_config("robby", can="local:robby") as robot:  # runs until the end of the block
        robot.command("robby_forward_controller", [10.0, 10.0])

    with Robot.attach("robby") as robot:  # started by `canopen-control run robby`; keeps running after the block
        print(robot.joints()["left_wheel_joint"].velocity)

Values are in SI units. Methods are thread-safe and raise CanopenError; a refusal by the robot is raised with the class
of the robot's error if that class can be constructed from a message alone, else with a base class.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, TypeVar

from canopen_control import errors
from canopen_control.client import RobotClient, select_robot
from canopen_control.client.robot_client import EventStream
from canopen_control.errors import BusError, CanopenError, ConfigError, RemoteError, RemoteProtocolError
from canopen_control.rpc.messages import robot as messages
from canopen_control.rpc.messages.robot import MAX_OBJECT, SdoRead, SdoWrite

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import TracebackType

    from canopen_control.od.address import ObjectAddress
    from canopen_control.od.model import ObjectDictionary, Value
    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.robot import NodePlace
    from canopen_control.rpc.messages.state import ControllerReading, JointReading, NodeReading, Status
    from canopen_control.runtime.background import BackgroundRobot

__all__ = ["AxisAction", "Robot"]

A = TypeVar("A")
AxisAction = Literal["enable", "disable", "halt", "quick-stop", "fault-reset", "home", "mode"]

_CALL_S: Final = 20.0
_BLOCK_BYTES_PER_S: Final = 1_000  # for the slowest acceptable transfer
_SOURCE: Final = "program"


class Robot:
    """Robot that this program starts (`from_config`) or that already runs (`attach`), for use in a `with` block."""

    def __init__(self, name: str, background: BackgroundRobot | None = None) -> None:
        self.name = name
        self._background = background
        self._open = False
        self._connecting = threading.Lock()
        self._connected: RobotClient | None = None
        self._listing: list[NodePlace] = []
        self._dictionaries: dict[int, ObjectDictionary] = {}

    @classmethod
    def from_config(
        cls,
        config: str,
        *,
        can: str | Sequence[str] = (),
        controllers: Sequence[str] = (),
        name: str | None = None,
        mock: bool = False,
        drives: bool = True,
        xacro: Mapping[str, str] | None = None,
    ) -> Robot:
        """Create a robot from its files, for `start` or a `with` block; raise ConfigError for invalid files.

        `can`, `name` and `mock` are as the options `--can`, `--as` and `--mock`; `controllers` are activated at start.
        `drives=False` starts no virtual drives. `xacro` are the arguments of the description.
        """
        from canopen_control.runtime.background import BackgroundRobot
        from canopen_control.runtime.robot_files import find_robot
        from canopen_control.runtime.run_session import RunOptions
        from canopen_control.runtime.setup import read_robot

        channels = [can] if isinstance(can, str) else list(can)
        files = find_robot(config, arguments=[f"{key}:={value}" for key, value in (xacro or {}).items()])
        setup = read_robot(files, name=name, can=channels, controllers=controllers, mock=mock)
        if setup.real:
            setup.require_places(files.hardware.real_word)
        return cls(setup.name, BackgroundRobot(setup, RunOptions(drives=drives and not (mock or setup.real))))

    @classmethod
    def attach(cls, name: str | None = None) -> Robot:
        """Connect to the running robot with this name (None: the only one).

        Raise ConfigError if none or several match.
        """
        robot = cls(select_robot(name))
        robot.start()
        return robot

    def __enter__(self) -> Robot:
        self.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    # -- life cycle

    def start(self) -> None:
        """Boot the robot of `from_config` and return once it runs, or connect to an already running robot.

        Raise CanopenError if the start or the connection fails.
        """
        try:
            if self._background is not None:
                self._background.start()
            self._open = True
            self._client()
        except BaseException:  # also an interrupt: a `with` block that has not begun does not end the robot
            self.close()
            raise

    def close(self) -> None:
        """Shut down a robot that this program started, or disconnect from another robot, which continues to run."""
        if self._background is not None:
            self._background.shutdown()
        self._open = False
        self._leave()

    def shutdown(self) -> None:
        """Ramp to a standstill, disable the drives and end the robot, in whichever process it runs; idempotent."""
        if self._background is None and self._connected is not None:
            self._ask(messages.Shutdown())
        self.close()

    # -- motion

    def command(self, controller: str, values: Sequence[float] | Mapping[str, float]) -> dict[str, str]:
        """Command a controller with one value per joint; velocity and effort commands expire after the command timeout.

        Outputs of a GPIO command controller can be given by name, `{"io/lamp": 1.0}`; other outputs are unchanged.
        Return the joints that do not follow, such as a single disabled axis, each with the reason and the remedy.
        """
        if isinstance(values, Mapping):
            by_name = messages.CommandByName(controller=controller, values=dict(values), source=_SOURCE)
            return self._ask(by_name).idle
        return self._ask(messages.CommandController(controller=controller, values=list(values), source=_SOURCE)).idle

    def twist(self, controller: str, linear: float, angular: float, lateral: float = 0.0) -> None:
        """Command the velocity of a base: `linear` forward and `lateral` to the left in m/s, `angular` in rad/s."""
        self._ask(
            messages.TwistController(
                controller=controller, linear=linear, lateral=lateral, angular=angular, source=_SOURCE
            )
        )

    def stop(self, *, latch: bool = False) -> None:
        """Ramp to a standstill and disable the drives; return once no drive has power.

        With `latch`, no client can move the robot before `release`.
        """
        self._ask(messages.Stop(latch=latch, source=_SOURCE))

    def release(self) -> None:
        """Release a latched stop; the drives remain disabled."""
        self._ask(messages.Release(source=_SOURCE))

    def axis(
        self,
        action: AxisAction,
        node: str | int = "all",
        *,
        joint: str | None = None,
        method: int | None = None,
        mode: str | None = None,
    ) -> None:
        """Execute an axis action, as `canopen-control axis` does, and return when the action is complete.

        `joint` selects an axis of a multi-axis drive, `method` is the homing method, `mode` the mode such as "CSP".
        """
        request = messages.AxisRequest(action=action, node=str(node), joint=joint, method=method, mode=mode)
        self._ask(request, request.timeout_s(_CALL_S))

    def switch(self, *, activate: Sequence[str] = (), deactivate: Sequence[str] = ()) -> None:
        """Activate and deactivate controllers in one step; if refused, all active controllers stay active.

        Controllers that are already in the requested state are skipped; unloaded controllers are loaded and configured
        first.
        """
        states = {controller.name: controller.state for controller in self.controllers().values()}
        for name in activate:
            if name not in states:
                self._ask(messages.LoadController(controller=name))
            if states.get(name, "unconfigured") == "unconfigured":
                self._ask(messages.ConfigureController(controller=name))
        new = [name for name in activate if states.get(name) != "active"]
        # an unknown controller is requested too, and refused
        old = [name for name in deactivate if states.get(name, "active") == "active"]
        if new or old:
            self._ask(messages.SwitchControllers(activate=tuple(new), deactivate=tuple(old)))

    # -- state

    def state(self) -> str:
        """Return the state of the robot, such as "running", "disabled" or "fault"."""
        return self.status().state

    def joints(self) -> dict[str, JointReading]:
        """Return the states of all joints, by name."""
        return self.status().joints

    def nodes(self) -> dict[str, NodeReading]:
        """Return the states of all nodes with their axes, by name."""
        return self.status().nodes

    def controllers(self) -> dict[str, ControllerReading]:
        """Return the states of the loaded controllers, by name."""
        return {controller.name: controller for controller in self._ask(messages.ListControllers())}

    def status(self) -> Status:
        """Return the complete status, as `status --json` prints it."""
        return self._ask(messages.GetStatus())

    def events(self, timeout: float | None = None) -> EventStream:
        """Return a stream of the events from now on; it ends after `timeout` s without an event (None: never)."""
        self._client()  # raises if the robot is not running
        return EventStream(RobotClient.connect(self.name, _CALL_S), timeout)

    # -- objects

    def sdo_read(self, node: str | int, item: str | int, subindex: int = 0) -> Value:
        """Read an object by name or by index and subindex; return bytes if the object is not in the EDS.

        `node` is a name or a node-ID, `item` is for example "Statusword" (a name in the EDS), "0x1018:01" or 0x6041.
        Raise RemoteProtocolError if the node aborts the transfer or does not answer.
        """
        from canopen_control.od.codec import decode

        node_id, address = self._address(node, item, subindex)
        data = self.sdo_upload(node_id, address.index, address.subindex, block=False)
        if address.entry is None:
            return data
        try:
            return decode(data, address.entry.data_type)
        except ValueError as error:
            raise RemoteProtocolError(node_id, f"node {node_id}: {address.label}: {error}") from None

    def sdo_write(self, node: str | int, item: str | int, value: Value, subindex: int = 0) -> None:
        """Write an object, encoded in the data type of the EDS; `value` must be bytes if the object is not in the EDS.

        `node` and `item` are as in `sdo_read`. Raise ConfigError for a value that does not fit the data type.
        """
        from canopen_control.od.codec import encode

        node_id, address = self._address(node, item, subindex)
        if address.entry is not None:
            try:
                value = encode(value, address.entry.data_type)
            except ValueError as error:
                raise ConfigError(f"{address.label}: {error}") from None
        if not isinstance(value, bytes):
            raise ConfigError(f"{address.label} is not in the EDS, so its value must be bytes of the object's length")
        self.sdo_download(node_id, address.index, address.subindex, value)

    def sdo_upload(self, node: str | int, index: int, subindex: int = 0, *, block: bool = True) -> bytes:
        """Read the bytes of an object; with `block`, by SDO block transfer if the node supports it."""
        reading = self._find_node(node)
        seconds = _CALL_S + (MAX_OBJECT / _BLOCK_BYTES_PER_S if block else 0)
        request = SdoRead(node=str(reading.node_id), index=index, subindex=subindex, block=block)
        return self._ask_node(reading, request, seconds).data

    def sdo_download(self, node: str | int, index: int, subindex: int, data: bytes) -> None:
        """Write the bytes of an object; raise ConfigError for more than `MAX_OBJECT` bytes."""
        reading = self._find_node(node)
        if len(data) > MAX_OBJECT:
            raise ConfigError(f"{len(data)} bytes are more than {MAX_OBJECT}, the limit for transfers through a robot")
        request = SdoWrite(node=str(reading.node_id), index=index, subindex=subindex, data=data)
        try:
            self._client().sdo_write(request, _CALL_S + len(data) / _BLOCK_BYTES_PER_S)
        except RemoteError as error:
            raise _of_node(reading, error) from None

    def _address(self, node: str | int, item: str | int, subindex: int) -> tuple[int, ObjectAddress]:
        from canopen_control.od.address import find_object

        reading = self._find_node(node)
        text = f"0x{item:04X}:{subindex:02X}" if isinstance(item, int) else item
        return reading.node_id, find_object(text, self._dictionary(reading))

    def _find_node(self, node: str | int) -> NodePlace:
        self._listing = self._listing or self._ask(messages.GetNodes()).nodes
        match = next((reading for reading in self._listing if str(node) in (reading.name, str(reading.node_id))), None)
        if match is None:
            names = ", ".join(f"{reading.name} ({reading.node_id})" for reading in self._listing) or "none"
            raise errors.UnknownName(f"no node {str(node)!r}; available: {names}")
        return match

    def _dictionary(self, node: NodePlace) -> ObjectDictionary:
        from canopen_control.od.eds import read_eds

        node_id = node.node_id
        if node_id not in self._dictionaries:
            self._dictionaries[node_id] = read_eds(Path(node.eds), node_id).od
        return self._dictionaries[node_id]

    # -- connection

    def _client(self) -> RobotClient:
        if not self._open or (self._background is not None and not self._background.running):
            raise BusError(f"robot {self.name} is not running or was closed; use it in a with block")
        with self._connecting:
            if self._connected is None:
                self._connected = RobotClient.connect(self.name, _CALL_S)
            return self._connected

    def _leave(self) -> None:
        with self._connecting:
            client, self._connected = self._connected, None
        if client is not None:
            client.close()

    def _ask(self, request: Request[A], seconds: float = _CALL_S) -> A:
        try:
            return self._client().ask(request, seconds)
        except RemoteError as error:
            raise _as_here(error) from None

    def _ask_node(self, node: NodePlace, request: Request[A], seconds: float) -> A:
        try:
            return self._client().ask(request, seconds)
        except RemoteError as error:
            raise _of_node(node, error) from None


_OF_THE_NODE: Final = ("SdoAbort", "SdoTimeout", "RemoteProtocolError")


def _of_node(node: NodePlace, error: RemoteError) -> CanopenError:
    """Return the local error for a failed SDO transfer: RemoteProtocolError for SDO errors of the node."""
    if error.kind in _OF_THE_NODE:
        return RemoteProtocolError(node.node_id, str(error))
    return _as_here(error)


def _as_here(error: RemoteError) -> CanopenError:
    """Return the local exception for an error of the robot's process, of the same class or a base class.

    Only classes that can be constructed from a message alone are suitable; else the RemoteError itself is returned.
    """
    kind = getattr(errors, error.kind, None)
    for base in kind.__mro__ if isinstance(kind, type) else ():
        if issubclass(base, CanopenError) and base.__init__ is Exception.__init__ and base is not CanopenError:
            return base(str(error))
    return error
