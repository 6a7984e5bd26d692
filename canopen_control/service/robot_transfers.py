"""The SDO transfers of one node of a running robot: each is asked of the robot, the one client of its SDO server."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.nmt import NmtState
from canopen_control.client import RobotClient
from canopen_control.errors import CanopenError, ConfigError, ControlError
from canopen_control.od.eds import read_eds
from canopen_control.rpc.messages.robot import MAX_OBJECT, GetSdoProgress, GetStatus, SdoRead, SdoWrite
from canopen_control.service.node_session import NodeSession, Transfers

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.cia301.nmt import NmtCommand
    from canopen_control.od.model import ObjectDictionary
    from canopen_control.rpc.messages.robot import NodePlace
    from canopen_control.rpc.messages.state import NodeReading

__all__ = ["RobotTransfers", "dictionary_of", "session_with"]

TIMEOUT_S: Final = 15.0  # with a robot that has other requests for the node waiting
_BYTES_PER_S: Final = 1_000  # of the slowest transfer worth waiting for
_WATCH_S: Final = 2.0


class RobotTransfers(Transfers):
    """Carries the SDO of the node `node_id` through `robot`; `timeout` in s for each answer, None: that of bus.yml.

    `source` is by whose name the robot's events tell what is written, None: that of this program.
    """

    def __init__(
        self, robot: RobotClient, node_id: int, timeout: float | None = None, source: str | None = None
    ) -> None:
        self._robot, self._node_id, self._timeout, self._source = robot, node_id, timeout, source
        self._watching: RobotClient | None = None

    def read(self, index: int, subindex: int, *, block: bool = False) -> bytes:
        """Upload an object."""
        request = SdoRead(node=str(self._node_id), index=index, subindex=subindex, block=block, timeout=self._timeout)
        timeout = TIMEOUT_S + (MAX_OBJECT / _BYTES_PER_S if block else 0) + (self._timeout or 0)
        return self._robot.ask(request, timeout).data

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """Download an object; ConfigError for one that is longer than a robot passes on."""
        if len(data) > MAX_OBJECT:
            raise ConfigError(
                f"{len(data)} bytes are more than the {MAX_OBJECT} a running robot passes on; "
                "end it and write straight on the bus with --can"
            )
        request = SdoWrite(
            node=str(self._node_id),
            index=index,
            subindex=subindex,
            data=data,
            timeout=self._timeout,
            source=self._source,
        )
        self._robot.sdo_write(request, TIMEOUT_S + len(data) / _BYTES_PER_S + (self._timeout or 0))

    def command(self, command: NmtCommand) -> None:
        """Refuse: the NMT master of these nodes is the robot, and who takes one out of it says so to the robot."""
        raise ControlError(f"NMT {command.name.replace('_', ' ').lower()} is the robot's to send; ask it for that")

    def nmt_state(self) -> NmtState | None:
        """Return what the robot knows of the node."""
        reading = self._reading()
        return NmtState.__members__.get("" if reading is None else reading.nmt_state or "")

    def taken_out(self) -> bool:
        """Return what the robot says, which boots a node again and again otherwise."""
        reading = self._reading()
        return reading is not None and reading.taken_out

    def progress(self) -> tuple[int, int | None]:
        """Ask the robot how far the transfer is, on a connection of its own; from another thread."""
        try:
            if self._watching is None:
                self._watching = RobotClient.connect(self._robot.robot, _WATCH_S)
            found = self._watching.ask(GetSdoProgress(node=str(self._node_id)))
        except CanopenError:
            return 0, None  # who waits for the transfer is told what is the matter
        return found.done, found.total

    def close(self) -> None:
        """Ask no more how far a transfer is."""
        if self._watching is not None:
            self._watching.close()

    def _reading(self) -> NodeReading | None:
        nodes = self._robot.ask(GetStatus()).nodes
        return next((each for each in nodes.values() if each.node_id == self._node_id), None)


def dictionary_of(place: NodePlace) -> ObjectDictionary | None:
    """Read the EDS of a node of a robot; None for one that has none, EdsError for one that cannot be read."""
    return read_eds(Path(place.eds), place.node_id).od if place.eds else None


@contextlib.contextmanager
def session_with(
    robot: RobotClient, place: NodePlace, od: ObjectDictionary | None, *, source: str | None = None
) -> Iterator[NodeSession]:
    """Open a session with a node of a running robot."""
    with contextlib.closing(RobotTransfers(robot, place.node_id, source=source)) as transfers:
        yield NodeSession(transfers, place.node_id, od, name=place.name, robot=robot.robot)
