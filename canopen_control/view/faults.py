"""The virtual drives of a robot as somebody who breaks them sees them: their own control sockets, past the bus.

The law of this file: a real drive has no such socket, so that nothing here can reach one. Everything waits for an
answer, a second at most; it is called from threads that may.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import RemoteError
from canopen_control.host.lineclient import LineClient
from canopen_control.host.sockets import list_sockets, socket_path

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["FaultDesk", "control_name"]

_TIMEOUT_S: Final = 1.0
_KINDS: Final = ("local:", "memory:", "virtual:")


def control_name(channel: str, node_id: int) -> str:
    """Return the name of the control socket of a virtual node; the same that `virtual` gives it."""
    bus = channel
    for kind in _KINDS:
        bus = bus.removeprefix(kind)
    safe = "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in bus)
    return f"{safe[:31]}-{node_id}"


class FaultDesk:
    """`nodes` is the runtime's answer to its method of that name."""

    def __init__(self, nodes: Mapping[str, Any]) -> None:
        channels = {name: str(bus["channel"]) for name, bus in nodes["buses"].items()}
        self._sockets = {
            str(node["name"]): control_name(channels[node["bus"]], int(node["node_id"])) for node in nodes["nodes"]
        }

    def drives(self) -> list[str]:
        """Return the nodes that are virtual and there."""
        alive = set(list_sockets("drive"))
        return [name for name, socket in self._sockets.items() if socket in alive]

    def faults(self, drive: str) -> list[dict[str, Any]]:
        """Return every fault of a drive: name, does, reaction, once, on. RemoteError if it is not there."""
        found: list[dict[str, Any]] = self._ask(drive, "faults", {})
        return found

    def switch(self, drive: str, fault: str, *, on: bool) -> list[str]:
        """Switch a fault and return those that are on; RemoteError if the drive refuses or is not there."""
        answer: dict[str, list[str]] = self._ask(drive, "fault", {"name": fault, "on": on})
        return answer["active"]

    def _ask(self, drive: str, method: str, params: dict[str, Any]) -> Any:  # noqa: ANN401 - what JSON holds
        path = socket_path("drive", self._sockets[drive])
        with LineClient(path, _TIMEOUT_S, label=f"the virtual drive {drive}") as client:
            client.send({"id": 1, "method": method, "params": params}, _TIMEOUT_S)
            while (answer := client.receive(_TIMEOUT_S)) is not None:
                if answer.get("id") != 1:
                    continue  # the greeting, and events
                if "error" in answer:
                    raise RemoteError(str(answer["error"]["kind"]), str(answer["error"]["message"]))
                return answer["result"]
        raise RemoteError("Timeout", f"the virtual drive {drive} does not answer")
