"""Session with a node of a robot in virtual time, in place of a session on a running robot or a bare bus.

The robot's own SDO client executes the transfers, so that jobs such as a backup or a restore run in virtual time as on
hardware; a request advances the time until its end.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.commissioning.node_session import NodeSession, Transfers
from canopen_control.errors import DriveError

if TYPE_CHECKING:
    from canopen_control.cia301.sdo_exchange import SdoRequest
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.simulation.robot_under_test import RobotUnderTest


_STEP_NS: Final = 1_000_000
_NMT_NS: Final = 30_000_000_000  # for a state, a boot included
_STATES: Final = {
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
    NmtCommand.RESET_NODE: NmtState.PRE_OPERATIONAL,
    NmtCommand.RESET_COMMUNICATION: NmtState.PRE_OPERATIONAL,
}


class SimulatedTransfers(Transfers):
    """SDO transfers and NMT commands for one node through its master in virtual time."""

    def __init__(self, robot: RobotUnderTest, node_id: int) -> None:
        self._robot, self._node_id = robot, node_id
        self._timeout_ns: int | None = None

    @property
    def _node(self) -> RemoteNode:
        return self._robot.core.node(str(self._node_id))

    def read(self, index: int, subindex: int, *, block: bool = False) -> bytes:
        node = self._node
        return self._ended(node.sdo.read(index, subindex, block=block, timeout_ns=self._timeout_ns)).data

    def write(self, index: int, subindex: int, data: bytes) -> None:
        self._ended(self._node.sdo.write(index, subindex, data, timeout_ns=self._timeout_ns))

    def _ended(self, request: SdoRequest) -> SdoRequest:
        self._robot.host.call(self._robot.core.bus_of(self._node).send_waiting)
        while not request.done:
            self._robot.run_for(_STEP_NS)
        if request.error is not None:
            raise request.error
        return request

    def be_patient(self, seconds: float | None) -> None:
        self._timeout_ns = None if seconds is None else round(seconds * 1e9)

    def command(self, command: NmtCommand) -> None:
        """Send an NMT command through the robot; DriveError if the node does not reach the resulting state."""
        robot, node = self._robot, self._node
        robot.host.call(partial(node.command, command, robot.core.reactor.now()))
        robot.host.call(robot.core.bus_of(node).send_waiting)
        end = robot.now_ns + _NMT_NS
        robot.run_for(_STEP_NS)  # until the robot has processed the command
        while not (node.ready if command is NmtCommand.START else node.nmt_state is _STATES[command]):
            robot.run_for(_STEP_NS)
            if robot.now_ns > end:
                state = "silent" if node.nmt_state is None else node.nmt_state.text
                raise DriveError(f"node {self._node_id} is {state} after NMT {command.name.replace('_', ' ').lower()}")

    def nmt_state(self) -> NmtState | None:
        return self._node.nmt_state

    def taken_out(self) -> bool:
        return self._node.is_taken_out

    def progress(self) -> tuple[int, int | None]:
        return self._node.sdo.progress

    def pause(self, seconds: float) -> None:
        """Advance the virtual time by `seconds`."""
        self._robot.run_for(round(seconds * 1e9))

    def close(self) -> None:
        """Do nothing, because the node belongs to the robot."""


def simulated_session(robot: RobotUnderTest, name: str, node_id: int) -> NodeSession:
    """Return a session with a node of a robot in virtual time."""
    node = robot.core.node(name)
    return NodeSession(SimulatedTransfers(robot, node_id), node_id, node.od, name=name)
