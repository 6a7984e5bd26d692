"""Motion of one axis of a running robot for a jog or a tuning run, without a trajectory or base controller.

A drive that a controller commands is refused, because only one client may move the drive. The client selects the mode,
enables the drive, sends commands that expire with its connection, and finally always stops and disables the drive.
"""

from __future__ import annotations

import contextlib
import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.emcy import code_text
from canopen_control.cia402.objects import ERROR_CODE, axis_index
from canopen_control.cia402.state import State
from canopen_control.errors import ConfigError, RemoteError
from canopen_control.od.model import DataType
from canopen_control.rpc.messages.fault import FaultEvent
from canopen_control.rpc.messages.robot import AxisRequest, CommandController, GetNodes, ListControllers, SdoRead
from canopen_control.trace.values import is_faulty

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.client import RobotClient
    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.rpc.messages.state import AxisReading, ControllerReading, StateSample


# Reasons why a drive must not be moved now: a fault with its explanation, or torque commanded by another client.


_POWERED: Final = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)
_REGISTER, _HISTORY = (0x1001, 0), (0x1003, 1)
_MAX_ERRORS: Final = 32


def fault_words(node: NodeSession) -> str:
    """Return the fault of a drive as text, from 0x603F, 0x1003 and 0x1001, or "" if no axis has a fault."""
    axes = [axis for axis, state in node.drive_states().items() if is_faulty(state)]
    if not axes:
        return ""
    code = next(filter(None, (node.number(axis_index(ERROR_CODE, axis), 0, DataType.UNSIGNED16) for axis in axes)), 0)
    code = code or (node.number(*_HISTORY) or 0) & 0xFFFF
    fault = FaultEvent(code or None, node.number(*_REGISTER, DataType.UNSIGNED8) or None)
    return fault.text or "unknown (the drive reports no error code)"


def error_history(node: NodeSession) -> list[str]:
    """Return the error history (0x1003) as texts, newest first; raise ConfigError if the node has none."""
    count = node.number(_HISTORY[0], 0, DataType.UNSIGNED8)
    if count is None:
        raise ConfigError(f"{node} has no error history (0x1003)")
    codes = (node.number(_HISTORY[0], subindex) for subindex in range(1, min(count, _MAX_ERRORS) + 1))
    return [f"{code_text(code & 0xFFFF)}{_additional_text(code)}" for code in codes if code]


def _additional_text(code: int) -> str:
    """Return the manufacturer-specific upper half of an error history entry as text, or "" if it is 0."""
    return f", additional information 0x{code >> 16:04X}" if code >> 16 else ""


def why_not_free(node: NodeSession) -> str:
    """Return why the drive must not be moved if another program has enabled it, else ""."""
    powered = [state for state in node.drive_states().values() if state in _POWERED]
    if not powered or powered[0] is None:
        return ""
    words = powered[0].name.replace("_", " ")
    return f"{node} is {words}: another program has enabled it, and only one may move it; end that program first"


PERIOD_S: Final = 0.02
RENEWED_S: Final = 0.1
CURRENT_S: Final = 0.2
ENABLE_S: Final = 15.0
CURRENTS: Final = ((0x6078, 0), (0x6077, 0))
"""Objects with the current in per mille of the rated current, else the torque in per mille of the rated torque."""


@dataclass(frozen=True, slots=True)
class JogDrive:
    """Names of a drive in a running robot, and the mode of operation to request ("" for no change).

    `alone` means that the robot was started for this drive on a bare bus, so that its names mean nothing to the user.
    """

    robot: str
    node: str
    joint: str
    controller: str
    mode: str = ""
    alone: bool = False

    @property
    def title(self) -> str:
        """Name of the drive in messages: the joint of a running robot, "the drive" on a bare bus."""
        return "the drive" if self.alone else self.joint


def drive_of_robot(client: RobotClient, node: str, axis: int, mode: str) -> JogDrive:
    """Return the drive of an axis; raise ConfigError with advice if no controller takes targets for its joint alone."""
    places = client.ask(GetNodes()).nodes
    place = next((place for place in places if node in (place.name, str(place.node_id))), None)
    if place is None:
        names = ", ".join(f"{place.node_id} {place.name}" for place in places) or "none"
        raise ConfigError(f"robot {client.robot} has no node {node!r}; its nodes: {names}")
    if not axis < len(place.joints):
        raise ConfigError(
            f"node {place.node_id} ({place.name}) of the running robot {client.robot} does not move a joint"
        )
    joint = place.joints[axis]
    controllers = client.ask(ListControllers())
    controller_of_joint = next((controller for controller in controllers if takes_targets(controller, joint)), None)
    if controller_of_joint is not None:
        return JogDrive(client.robot, place.name, joint, controller_of_joint.name, mode)
    users = users_of(controllers, joint)
    place_text = f"node {place.node_id} ({place.name}) is {joint} of the running robot {client.robot}"
    shutdown = f"canopen-control shutdown --name {client.robot}"
    if not users:
        raise ConfigError(
            f"{place_text}, but no active controller moves it; activate one (canopen-control controller switch "
            f"--activate NAME --name {client.robot}) and send it commands, or end the robot first: {shutdown}"
        )
    raise ConfigError(
        f"{place_text} and is commanded by {users[0]}, and only one client may move it; "
        f"drive it by `canopen-control command` or `teleop`, or end the robot first: {shutdown}"
    )


def takes_targets(controller: ControllerReading, joint: str) -> bool:
    """Whether a controller is active and accepts targets for a single joint."""
    return controller.active and controller.topic == "target" and controller.joints == (joint,)


def users_of(controllers: Iterable[ControllerReading], joint: str) -> list[str]:
    """Return the names of the active controllers that command a joint."""
    return [
        controller.name
        for controller in controllers
        if controller.active and joint in controller.joints and not controller.is_broadcaster
    ]


def choose_mode(client: RobotClient, request: AxisRequest) -> None:
    """Request a mode of operation, and retry for up to `ENABLE_S` while the robot refuses with ControlError."""
    deadline = time.monotonic() + ENABLE_S
    while True:
        try:
            client.ask(request, ENABLE_S)
        except RemoteError as error:
            if error.kind != "ControlError" or time.monotonic() > deadline:
                raise
            time.sleep(PERIOD_S)
        else:
            return


class AxisCommand:
    """Velocity, position or effort command (`interface`) to a drive, which expires when the client disconnects."""

    def __init__(self, drive: JogDrive, interface: str, source: str) -> None:
        self._drive, self._interface, self._source = drive, interface, source
        self._sent, self._sent_ns = math.nan, 0

    def send(self, client: RobotClient, value: float) -> bool:
        """Send a changed value, or renew a nonzero one after `RENEWED_S`; return False if the drive is not enabled."""
        now = time.monotonic_ns()
        if value == self._sent and (not value or now - self._sent_ns < RENEWED_S * 1e9):
            return True
        request = CommandController(
            controller=self._drive.controller,
            values=[value],
            source=self._source,
            dead_man=True,
            interface=self._interface,
        )
        enabled = True
        try:
            client.ask(request, 1.0)
        except RemoteError as error:
            if error.kind not in ("NotEnabled", "NotYetEnabled"):
                raise
            enabled = False
        self._sent, self._sent_ns = value, now
        return enabled


class DriveCurrent:
    """Current of a drive in per mille of the rated current, read by SDO (0x6078, or else the torque 0x6077)."""

    def __init__(self, drive: JogDrive) -> None:
        self.value: float | None = None
        self._drive = drive
        self._currents = [*CURRENTS]
        self._read_ns = 0

    def ask(self, client: RobotClient) -> None:
        """Read the current if the last read is `CURRENT_S` old; an object that the drive refused is not read again."""
        now = time.monotonic_ns()
        if not self._currents or now - self._read_ns < CURRENT_S * 1e9:
            return
        self._read_ns = now
        index, subindex = self._currents[0]
        try:
            data = client.ask(SdoRead(node=self._drive.node, index=index, subindex=subindex), 1.0).data
            self.value = float(int.from_bytes(data[:2], "little", signed=True))
        except RemoteError as error:
            if error.kind == "BusClosed":
                raise
            del self._currents[0]


def axis_reading(sample: StateSample | None, drive: JogDrive) -> AxisReading | None:
    """Return the reading of the drive's axis in a sample, or None if the sample lacks the axis."""
    node = None if sample is None else sample.nodes.get(drive.node)
    axes = () if node is None else node.axes
    return next((axis for axis in axes if axis.joint == drive.joint), None)


def stop_drive(client: RobotClient, drive: JogDrive, source: str) -> None:
    """Stop and disable the drive on behalf of `source`; ignore a RemoteError, because the robot may have ended."""
    with contextlib.suppress(RemoteError):
        client.ask(AxisRequest(action="disable", node=drive.node, joint=drive.joint, source=source), ENABLE_S)


def ended_words(sample: StateSample | None, drive: JogDrive) -> str:
    """Return the state and the error of a drive that is no longer enabled, as text."""
    axis = axis_reading(sample, drive)
    if axis is None or not axis.state:
        return "the drive reports no state any more, so it may still move; check its supply and its cable"
    error = f": {axis.error}" if axis.error else ""
    return f"the drive is {axis.state.replace('_', ' ')}{error}; faults are not reset automatically"
