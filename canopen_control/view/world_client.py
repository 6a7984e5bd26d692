"""Lets something happen in the world of a simulated robot: asks its virtual drives, by their control sockets.

A robot without drives, which a simulation plugin moves, is asked itself. The law of this file: a real drive has no such
socket, and a robot that has one refuses, so that nothing here can reach one. Everything waits for an answer, a second
for each drive at most; it is called from threads that may.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Final

from canopen_control.client import RobotClient
from canopen_control.client.drive_client import DriveClient
from canopen_control.errors import CanopenError, RemoteError
from canopen_control.host.sockets import drive_name, list_sockets
from canopen_control.rpc.messages.drive import GetWorld
from canopen_control.rpc.messages.simulation import GetSimulation

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.rpc.messages.drive import WorldAct
    from canopen_control.view.robot_info import VirtualNode

__all__ = ["WorldClient"]

_TIMEOUT_S: Final = 1.0


class WorldClient:
    """Asks for what happens in the world of `robot`; `nodes` are its own, virtual or not."""

    def __init__(self, robot: str, nodes: Iterable[VirtualNode]) -> None:
        self._robot, self._nodes = robot, tuple(nodes)

    def changeable(self) -> bool:
        """Return whether the robot or a drive is in a world in which something may be asked for."""
        return self._drive() is not None or self._simulated()

    def _simulated(self) -> bool:
        """Whether physics moves the robot without drives."""
        if self._nodes:
            return False
        try:
            with RobotClient.connect(self._robot, _TIMEOUT_S) as client:
                return client.ask(GetSimulation()).changeable
        except CanopenError:
            return False

    def act(self, what: WorldAct) -> bool:
        """Let it happen now, and return whether the robot tells of it; RemoteError where it is refused, or no world."""
        if not self._nodes:
            with RobotClient.connect(self._robot, _TIMEOUT_S) as client:
                client.ask(what)
            return True
        node = self._drive()
        if node is None:
            raise RemoteError("BusClosed", "the robot's drives are in no world with physics: run it with --physics")
        with _connect(node) as client:
            client.ask(what)
        return False

    def _drive(self) -> VirtualNode | None:
        """Return any virtual drive in such a world: all of a world answer for it."""
        alive = set(list_sockets("drive"))
        for node in self._nodes:
            if drive_name(node.channel, node.node_id) not in alive:
                continue
            with contextlib.suppress(RemoteError), _connect(node) as client:
                if client.ask(GetWorld()).changeable:
                    return node
        return None


def _connect(node: VirtualNode) -> DriveClient:
    return DriveClient.connect(node.channel, node.node_id, _TIMEOUT_S, label=f"the virtual drive {node.name}")
