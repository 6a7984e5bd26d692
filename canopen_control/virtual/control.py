"""The control socket of a virtual node: faults and state, for people, scripts and tests, past the bus.

JSON lines, as the runtime's API: {"id": 1, "method": M, "params": {...}} is answered with {"id": 1, "result": ...} or
{"id": 1, "error": {"kind", "message"}}. The first message is {"hello": {"node_id", "name", "channel", "pid"}}.

  faults {}                          every fault: name, row, acts, does, reaction, on
  fault {"name", "on": true|false}   switch one; answers {"active": [...]}
  state {}                           what the node is doing, and the plant's position and velocity; where a plant file
                                     couples axes, what they do together: {"world": {"base": {"x", "y", "heading"}}}
  inputs {"value", "axis": 0}        set further bits of 0x60FD
  plant {"axis": 0, NAME: value}     set a number of the plant: external, inertia, friction, backlash, stalled...

Messages without an id are asked and not answered. Each state change is pushed as {"event": text}.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from canopen_control.cia301.nmt import NmtState
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.host.jsonlines import LineServer
from canopen_control.host.sockets import socket_path
from canopen_control.virtual.faults import FAULTS
from canopen_control.virtual.switchboard import FaultSwitches

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from canopen_control.host.jsonlines import Connection, Message
    from canopen_control.virtual.node import VirtualNode
    from canopen_control.virtual.nodehost import NodeHost
    from canopen_control.virtual.plant import Plant
    from canopen_control.virtual.world import World

__all__ = ["NodeControl", "control_path", "describe"]


def control_path(channel: str, node_id: int) -> Path:
    """Return the path of the control socket of a node on a channel, ``drive-<bus>-<node>``."""
    bus = channel.removeprefix("local:").removeprefix("memory:").removeprefix("virtual:")
    name = "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in bus)
    return socket_path("drive", f"{name[:31]}-{node_id}")


def describe(node: VirtualNode) -> dict[str, Any]:
    """Return what a node is doing: plain values, JSON-able."""
    return {
        "node_id": node.node_id,
        "name": node.name,
        "nmt_state": NmtState(node.nmt.state).name,
        "error_register": node.emcy.error_register,
        "errors": list(node.emcy.active),
        "faults": [] if node.switches is None else node.switches.active,
        "axes": [drive.describe() for drive in node.drives.values()],
    }


class NodeControl:
    """Serves the control socket of `node`, which runs in `host`, on the axes of `world`."""

    def __init__(self, host: NodeHost, node: VirtualNode, world: World | None = None) -> None:
        self._host, self._node, self._world = host, node, world
        self._switches = node.switches or FaultSwitches(node)
        self._methods: dict[str, Callable[[dict[str, Any]], Any]] = {
            "faults": self._faults,
            "fault": self._fault,
            "state": self._state,
            "inputs": self._inputs,
            "plant": self._plant,
        }
        path = control_path(host.port.channel, node.node_id)
        self._server = LineServer(host.reactor, path, self._on_connect, self._on_message)

    def close(self) -> None:
        """Remove the socket."""
        self._server.close()

    def push(self, text: str) -> None:
        """Tell everybody connected what happened."""
        self._server.broadcast({"event": text})

    def _on_connect(self, connection: Connection) -> None:
        hello = {
            "node_id": self._node.node_id,
            "name": self._node.name,
            "channel": self._host.port.channel,
            "pid": os.getpid(),
        }
        connection.send({"hello": hello})

    def _on_message(self, connection: Connection, message: Message) -> None:
        answer: dict[str, Any]
        try:
            answer = {"result": self._serve(message)}
        except CanopenError as error:
            answer = {"error": {"kind": type(error).__name__, "message": str(error)}}
        if "id" in message:
            connection.send({"id": message["id"], **answer})

    def _serve(self, message: Message) -> Any:  # noqa: ANN401 - whatever the method answers
        method = self._methods.get(str(message.get("method")))
        if method is None:
            raise ConfigError(f"no method {message.get('method')!r}; there are: {', '.join(self._methods)}")
        parameters = message.get("params") or {}
        if not isinstance(parameters, dict):
            raise ConfigError("params is a JSON object")
        return self._run(method, parameters)

    def serve(self, method: str, parameters: dict[str, Any]) -> Any:  # noqa: ANN401 - whatever the method answers
        """Serve a method for somebody in this process; ConfigError for wrong parameters."""
        return self._run(self._methods[method], parameters)

    def _run(self, method: Callable[[dict[str, Any]], Any], parameters: dict[str, Any]) -> Any:  # noqa: ANN401 - as above
        self._node.tick(self._host.reactor.now())
        result = method(parameters)
        self._host.wake(self._node)
        return result

    def _faults(self, _parameters: dict[str, Any]) -> list[dict[str, Any]]:
        active = self._switches.active
        return [
            {
                "name": fault.name,
                "row": fault.row,
                "acts": fault.acts,
                "does": fault.does,
                "reaction": fault.reaction,
                "once": fault.once,
                "on": fault.name in active,
            }
            for fault in FAULTS.values()
        ]

    def _fault(self, parameters: dict[str, Any]) -> dict[str, Any]:
        on = parameters.get("on", True)
        if not isinstance(on, bool):
            raise ConfigError('fault: "on" is true or false')
        self._switches.set(str(parameters.get("name", "")), on, self._host.reactor.now())
        return {"active": self._switches.active}

    def _state(self, _parameters: dict[str, Any]) -> dict[str, Any]:
        world = {} if self._world is None else {"world": self._world.describe()}
        return describe(self._node) | world

    def _inputs(self, parameters: dict[str, Any]) -> dict[str, Any]:
        drive = self._node.drives.get(parameters.get("axis", 0))
        value = parameters.get("value")
        if drive is None or not isinstance(value, int) or not 0 <= value <= 0xFFFFFFFF:
            raise ConfigError('inputs: "value" is the 32 bits of 0x60FD, "axis" one that the node has')
        drive.set_inputs(value, self._host.reactor.now())
        self._node.tick(self._host.reactor.now())
        return {}

    def _plant(self, parameters: dict[str, Any]) -> dict[str, Any]:
        drive = self._node.drives.get(parameters.pop("axis", 0))
        if drive is None:
            raise ConfigError("plant: the node has no such axis")
        plant = drive.mover.plant
        for name, value in parameters.items():
            present = getattr(_holder(plant, name), name, None)
            if name.startswith("_") or not isinstance(present, int | float) or not isinstance(value, int | float):
                raise ConfigError(f"plant: {name!r} is no number of this plant")
        for name, value in parameters.items():
            holder = _holder(plant, name)
            setattr(holder, name, type(getattr(holder, name))(value))
        return {}


def _holder(plant: Plant, name: str) -> object:
    """Return who has a number of a plant: it, or the motor inside a wheel."""
    return plant if hasattr(plant, name) else getattr(plant, "inner", plant)
