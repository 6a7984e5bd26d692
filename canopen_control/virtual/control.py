"""Control socket of a virtual node: the methods of `rpc/messages/drive.py`, independent of the bus.

For every request the node is first advanced to the present time, and the resulting frames are sent at once.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, get_args

from canopen_control.cia301.nmt import NmtState
from canopen_control.errors import ConfigError
from canopen_control.host.sockets import drive_name, socket_path
from canopen_control.rpc.messages import drive as messages
from canopen_control.rpc.messages.declare import PROTOCOL, Done
from canopen_control.rpc.messages.drive import (
    DRIVE,
    ActiveFaults,
    ActiveQuirks,
    DriveEvent,
    DriveHello,
    DriveState,
    FaultListing,
    QuirkListing,
    WorldState,
)
from canopen_control.rpc.server import Server
from canopen_control.version import __version__
from canopen_control.virtual.fault_table import FAULTS, FaultSwitches
from canopen_control.virtual.plant import AcceptsEvents, HasScenery
from canopen_control.virtual.quirks import QUIRKS, switches_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.drive import WorldShape
    from canopen_control.rpc.server import Call
    from canopen_control.virtual.node_host import NodeHost
    from canopen_control.virtual.plant import Plant, World
    from canopen_control.virtual.virtual_drive import VirtualDrive
    from canopen_control.virtual.virtual_node import VirtualNode


A = TypeVar("A")


def describe(node: VirtualNode, world: WorldState | None = None) -> DriveState:
    """Return the state of a node; `world` is the state of its world, or None to leave it out."""
    return DriveState(
        node_id=node.node_id,
        name=node.name,
        nmt_state=NmtState(node.nmt.state).name,
        error_register=node.emcy.error_register,
        errors=list(node.emcy.active),
        faults=[] if node.fault_switches is None else node.fault_switches.active,
        axes=tuple(drive.describe() for drive in node.drives.values()),
        world=world,
        signals=() if node.function is None else node.function.describe(),
        quirks=[] if node.quirks is None else node.quirks.active,
    )


class NodeMethods:
    """Methods of the control socket of `node`, which runs in `host` and whose axes are in `world`."""

    def __init__(self, host: NodeHost, node: VirtualNode, world: World | None = None) -> None:
        self._host, self._node, self._world = host, node, world
        self._switches = node.fault_switches or FaultSwitches(node)
        self._quirks = switches_of(node)

    @property
    def kinds(self) -> tuple[type[Request[Any]], ...]:
        return tuple(self._WORK)

    def do(self, request: Request[A]) -> A:
        """Execute a request of a client or of this process; raise ConfigError if invalid or impossible on the node."""
        self._node.tick(self._host.reactor.now())
        answer: A = self._WORK[type(request)](self, request)
        self._host.wake(self._node)
        return answer

    def _faults(self, _request: messages.ListFaults) -> tuple[FaultListing, ...]:
        active = self._switches.active
        shown = [fault for fault in FAULTS.values() if fault.fits(self._node)]
        return tuple(fault.listing(on=fault.name in active) for fault in shown)

    def _switch_fault(self, request: messages.SwitchFault) -> ActiveFaults:
        self._switches.set(request.name, request.on, self._host.reactor.now())
        return ActiveFaults(self._switches.active)

    def _list_quirks(self, _request: messages.ListQuirks) -> tuple[QuirkListing, ...]:
        shown = [quirk for quirk in QUIRKS.values() if quirk.axis is None or self._node.drives]
        return tuple(quirk.listing(self._quirks.settings(quirk.name)) for quirk in shown)

    def _switch_quirk(self, request: messages.SwitchQuirk) -> ActiveQuirks:
        self._quirks.set(request.quirk, request.on, self._host.reactor.now())
        return ActiveQuirks(self._quirks.active)

    def _state(self, _request: messages.GetDriveState) -> DriveState:
        return describe(self._node, None if self._world is None else self._world.describe())

    def _world_state(self, _request: messages.GetWorld) -> WorldState:
        if self._world is None:
            return WorldState()
        world_state = self._world.describe()
        return WorldState(
            world_state.base, world_state.others, world_state.sensors, changeable=isinstance(self._world, AcceptsEvents)
        )

    def _world_shapes(self, _request: messages.GetWorldShapes) -> tuple[WorldShape, ...]:
        return self._world.shapes() if isinstance(self._world, HasScenery) else ()

    def _restart_quality(self, request: messages.RestartQuality) -> Done:
        self._axis(request.axis).meter.restart()
        return Done()

    def _set_inputs(self, request: messages.SetInputs) -> Done:
        now = self._host.reactor.now()
        self._axis(request.axis).set_inputs(request.value, now)
        self._node.tick(now)
        return Done()

    def _set_signals(self, request: messages.SetSignals) -> Done:
        node, now = self._node, self._host.reactor.now()
        if node.function is None:
            device = "a drive" if node.drives else "a device without a supported profile"
            raise ConfigError(f"node {node.node_id} ({node.name}) has no signals, because it is {device}")
        node.function.set_signals(request.values, now)
        node.tick(now)
        return Done()

    def _act(self, request: messages.WorldAct) -> Done:
        if not isinstance(self._world, AcceptsEvents):
            raise ConfigError(
                f"node {self._node.node_id} is not in a world with physics; start the robot with --physics"
            )
        self._world.act(request)
        return Done()

    def _set_plant(self, request: messages.SetPlant) -> Done:
        plant = self._axis(request.axis).mover.plant
        holders = {name: _holder(plant, name) for name in request.numbers}
        for name, value in request.numbers.items():
            holder = holders[name]
            setattr(holder, name, type(getattr(holder, name))(value))
        return Done()

    def _axis(self, axis: int) -> VirtualDrive:
        drive = self._node.drives.get(axis)
        if drive is None:
            raise ConfigError(f"the node has no axis {axis}; it has: {', '.join(map(str, self._node.drives))}")
        return drive

    _WORK: ClassVar[dict[type[Request[Any]], Callable[[Any, Any], Any]]] = {
        messages.ListFaults: _faults,
        messages.SwitchFault: _switch_fault,
        messages.ListQuirks: _list_quirks,
        messages.SwitchQuirk: _switch_quirk,
        messages.GetDriveState: _state,
        messages.SetInputs: _set_inputs,
        messages.SetSignals: _set_signals,
        messages.SetPlant: _set_plant,
        messages.RestartQuality: _restart_quality,
        **dict.fromkeys(get_args(messages.WorldAct), _act),
        messages.GetWorld: _world_state,
        messages.GetWorldShapes: _world_shapes,
    }


class NodeControl:
    """Server of the control socket of `node`; raises SocketInUse if another process uses that socket.

    Without a socket only this process can send requests.
    """

    def __init__(
        self, host: NodeHost, node: VirtualNode, world: World | None = None, *, with_socket: bool = True
    ) -> None:
        methods = NodeMethods(host, node, world)
        self.do = methods.do
        self._server: Server[DriveHello, DriveEvent] | None = None
        if with_socket:
            self._server = self._serve(host, node, methods)

    def _serve(self, host: NodeHost, node: VirtualNode, methods: NodeMethods) -> Server[DriveHello, DriveEvent]:
        channel = host.port.channel
        hello = DriveHello(
            node_id=node.node_id,
            name=node.name,
            channel=channel,
            version=__version__,
            protocol=PROTOCOL,
            pid=os.getpid(),
        )
        path = socket_path("drive", drive_name(channel, node.node_id))
        server: Server[DriveHello, DriveEvent] = Server(DRIVE, host.reactor, path, lambda: hello)
        for kind in methods.kinds:
            server.register(kind, self._answer)
        server.check()
        return server

    def _answer(self, call: Call[Request[Any]]) -> None:
        call.reply(self.do(call.request))

    def close(self) -> None:
        if self._server is not None:
            self._server.close()

    def push(self, text: str) -> None:
        if self._server is not None:
            self._server.push(DriveEvent(text))


def _holder(plant: Plant, name: str) -> object:
    """Return the object that has the parameter `name`, the plant or a wheel's motor.

    Raise ConfigError if none has it.
    """
    holder = plant if hasattr(plant, name) else getattr(plant, "inner", plant)
    if name.startswith("_") or not isinstance(getattr(holder, name, None), int | float):
        raise ConfigError(f"plant: {name!r} is not a number of this plant")
    return holder
