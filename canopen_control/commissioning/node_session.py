"""Service session with one node over any SDO transport: typed objects, identity, NMT and CiA 402 states.

Sans-IO except for `Transfers`, which is implemented for a bare bus and for a running robot, and by a dictionary in
tests. Values have the types of the EDS (CiA 306), states are those of CiA 402. A session writes only on request.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.cia301.nmt import NmtState
from canopen_control.cia402.objects import CONTROLWORD, STATUSWORD, axis_count, axis_index
from canopen_control.cia402.state import POWERED_STATES, State, decode_statusword
from canopen_control.client import RobotClient
from canopen_control.commissioning.identity import FIELDS, TEXTS, DeviceIdentity, eds_number
from canopen_control.errors import CanopenError, ConfigError, ControlError, RemoteError, SdoAbort, SdoLengthError
from canopen_control.od.codec import decode, encode, fitted
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType
from canopen_control.rpc.messages.robot import MAX_OBJECT, CancelSdo, GetSdoProgress, GetStatus, SdoRead, SdoWrite

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.cia301.nmt import NmtCommand
    from canopen_control.od.model import Entry, ObjectDictionary, Value
    from canopen_control.rpc.messages.robot import NodePlace
    from canopen_control.rpc.messages.state import NodeReading


_DECIDING: Final = ("vendor_id", "product_code")  # vendor and product identify the device, the revision its firmware


class Transfers(Protocol):
    """SDO transport to one node, and NMT commands if the transport allows them."""

    def read(self, index: int, subindex: int, *, block: bool = False) -> bytes:
        """Upload an object; raise RemoteError or RemoteProtocolError on failure."""

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """Download an object; raise RemoteError or RemoteProtocolError on failure."""

    def set_timeout(self, seconds: float | None) -> None:
        """Set the timeout for a response in s; None restores the default."""

    def command(self, command: NmtCommand) -> None:
        """Send an NMT command, on a bare bus only; raise DriveError if the node does not enter the state."""

    def nmt_state(self) -> NmtState | None:
        """Return the last known NMT state of the node, or None if unknown."""

    def taken_out(self) -> bool:
        """Whether no running robot uses the node; always True on a bare bus."""

    def progress(self) -> tuple[int, int | None]:
        """Return the number of transferred bytes and the total (None if unknown); callable from any thread."""

    def cancel(self) -> None:
        """Cancel a segmented or block transfer, which then aborts and raises an error; callable from any thread."""

    def pause(self, seconds: float) -> None:
        """Wait for `seconds`, in simulated time if the node is simulated."""
        time.sleep(seconds)

    def close(self) -> None:
        """Close connections that the transport has opened itself."""


class NodeSession:
    """Session with one node of a robot, or of a bus without a robot.

    `name` is the node's name in bus.yml or "", `robot` the name of the robot or "" on a bare bus. `od` is the EDS of
    the node, or None; if it is not given, the file `eds` is read on first use (EdsError).

    Every call may raise the errors of the node or the robot: RemoteProtocolError (SdoAbort, SdoTimeout) or RemoteError.
    """

    def __init__(
        self,
        transfers: Transfers,
        node_id: int,
        od: ObjectDictionary | None = None,
        *,
        name: str = "",
        robot: str = "",
        eds: Path | None = None,
    ) -> None:
        self.transfers, self.node_id = transfers, node_id
        self.name, self.robot, self._eds = name, robot, eds
        if od is not None:
            self.od = od

    def __str__(self) -> str:
        return f"node {self.node_id} ({self.name})" if self.name else f"node {self.node_id}"

    @functools.cached_property
    def od(self) -> ObjectDictionary | None:
        """EDS of the node, or None."""
        return None if self._eds is None else read_eds(self._eds, self.node_id).od

    @property
    def dictionary(self) -> ObjectDictionary:
        """EDS of the node; raise ConfigError if the node has none."""
        if self.od is None:
            raise ConfigError(f"{self} has no EDS; give one with --eds FILE")
        return self.od

    # -- objects

    def read(self, index: int, subindex: int = 0, *, block: bool = False) -> bytes:
        return self.transfers.read(index, subindex, block=block)

    def write(self, index: int, subindex: int, data: bytes) -> None:
        self.transfers.write(index, subindex, data)

    def read_value(self, entry: Entry) -> Value:
        """Upload and decode an object; raise SdoLengthError if the length does not fit the data type."""
        return self.decoded(entry, self.read(entry.index, entry.subindex))

    def decoded(self, entry: Entry, data: bytes) -> Value:
        """Decode uploaded bytes; raise SdoLengthError if the length does not fit the data type."""
        padded = fitted(data, entry.data_type)
        if padded is None:
            expected = f"{entry.data_type.name} has {((entry.data_type.bits or 0) + 7) // 8}"
            raise SdoLengthError(self.node_id, entry.index, entry.subindex, data, expected, entry.name, self.name)
        return decode(padded, entry.data_type)

    def write_value(self, entry: Entry, value: Value) -> None:
        """Encode and download a value; raise ConfigError if the value does not fit the data type."""
        try:
            data = encode(value, entry.data_type)
        except ValueError as error:
            raise ConfigError(f"{self}: 0x{entry.index:04X}:{entry.subindex:02X} {entry.name}: {error}") from None
        self.write(entry.index, entry.subindex, data)

    def number(self, index: int, subindex: int, data_type: DataType = DataType.UNSIGNED32) -> int | None:
        """Upload and return an integer, or None if the node aborts or the length does not fit the data type."""
        try:
            data = fitted(self.read(index, subindex), data_type)
        except (SdoAbort, RemoteError) as error:
            if not is_abort(error):
                raise
            return None
        return None if data is None else int.from_bytes(data, "little", signed=data_type.signed)

    # -- identity

    def identity(self) -> DeviceIdentity:
        """Read the device type, the numbers of 0x1018, and the name and versions for which the EDS has objects."""
        numbers = [self.number(*address) for address, _ in FIELDS.values()]
        return DeviceIdentity.of(numbers, [self._text(*address) for address in TEXTS.values()])

    def _text(self, index: int, subindex: int) -> str:
        entry = None if self.od is None else self.od.get(index, subindex)
        if entry is None or entry.data_type is not DataType.VISIBLE_STRING:
            return ""
        try:
            value = self.read_value(entry)
        except CanopenError as error:
            if not (isinstance(error, SdoLengthError) or is_abort(error)):
                raise
            return ""
        return " ".join(str(value).split())

    def identity_differences(self) -> list[str]:
        """Return the differences in vendor and product between EDS and device; the revision is not compared."""
        texts = []
        for (index, subindex), label in (FIELDS[field] for field in _DECIDING):
            expected, actual = eds_number(self.dictionary, subindex), self.number(index, subindex)
            if expected and actual != expected:
                shown = "none" if actual is None else f"0x{actual:08X}"
                texts.append(f"{label} 0x{expected:08X} in the EDS, {shown} in the device")
        return texts

    # -- states

    def nmt_state(self) -> NmtState | None:
        return self.transfers.nmt_state()

    def axes(self) -> range:
        """Return the axis numbers of a CiA 402 drive; without an EDS, only the first axis."""
        if self.od is None:
            return range(1)
        return range(axis_count({index for index, _ in self.od.entries}))

    def drive_states(self) -> dict[int, State | None]:
        """Return the CiA 402 state of each axis that has a statusword; None for an undefined statusword."""
        words = {
            axis: self.number(axis_index(STATUSWORD, axis), 0, DataType.UNSIGNED16)
            for axis in self.axes()
            if self.od is None or (axis_index(CONTROLWORD, axis), 0) in self.od
        }
        return {axis: decode_statusword(word) for axis, word in words.items() if word is not None}

    def powered_axes(self) -> list[int]:
        """Return the axes whose motor may have torque, including those in an undefined state."""
        return [axis for axis, state in self.drive_states().items() if state is None or state in POWERED_STATES]


def is_abort(error: CanopenError) -> bool:
    """Whether an error is an SDO abort by the node, received directly or through a robot."""
    return isinstance(error, SdoAbort) or (isinstance(error, RemoteError) and error.kind == SdoAbort.__name__)


# SDO transfers with one node of a running robot: all go through the robot, the only client of the node's SDO server.


TIMEOUT_S: Final = 15.0  # the robot may have queued other requests for the node
_BYTES_PER_S: Final = 1_000  # rate of the slowest transfer for which the timeout allows
_WATCH_S: Final = 2.0
_NUMBERS: Final = itertools.count(1)  # numbers of the sessions of this process


class RobotTransfers(Transfers):
    """SDO transport to a node through a running robot; `timeout` is in s, None for the timeout in bus.yml.

    `source` names the writer in the robot's events; None means the name of this program.
    """

    def __init__(
        self, robot: RobotClient, node_id: int, timeout: float | None = None, source: str | None = None
    ) -> None:
        self._robot, self._node_id, self._source = robot, node_id, source
        self._timeout = self._default_timeout = timeout
        self._session = f"{os.getpid()}-{next(_NUMBERS)}"
        self._watching: RobotClient | None = None

    def read(self, index: int, subindex: int, *, block: bool = False) -> bytes:
        request = SdoRead(
            node=str(self._node_id),
            index=index,
            subindex=subindex,
            block=block,
            timeout=self._timeout,
            session=self._session,
        )
        timeout = TIMEOUT_S + (MAX_OBJECT / _BYTES_PER_S if block else 0) + (self._timeout or 0)
        return self._robot.ask(request, timeout).data

    def write(self, index: int, subindex: int, data: bytes) -> None:
        if len(data) > MAX_OBJECT:
            raise ConfigError(
                f"{len(data)} bytes are more than the {MAX_OBJECT} that a running robot can transfer; "
                "end the robot and write on the bus with --can"
            )
        request = SdoWrite(
            node=str(self._node_id),
            index=index,
            subindex=subindex,
            data=data,
            timeout=self._timeout,
            source=self._source,
            session=self._session,
        )
        self._robot.sdo_write(request, TIMEOUT_S + len(data) / _BYTES_PER_S + (self._timeout or 0))

    def set_timeout(self, seconds: float | None) -> None:
        self._timeout = seconds or self._default_timeout

    def command(self, command: NmtCommand) -> None:
        """Raise ControlError, since the robot is the NMT master of its nodes."""
        raise ControlError(
            f"NMT {command.name.replace('_', ' ').lower()} can only be sent by the robot; use `canopen-control nmt`"
        )

    def nmt_state(self) -> NmtState | None:
        reading = self._reading()
        return NmtState.__members__.get("" if reading is None else reading.nmt_state or "")

    def taken_out(self) -> bool:
        reading = self._reading()
        return reading is not None and reading.taken_out

    def progress(self) -> tuple[int, int | None]:
        """Request the progress on a separate connection, or return (0, None) if that fails."""
        try:
            if self._watching is None:
                self._watching = RobotClient.connect(self._robot.robot, _WATCH_S)
            progress_read = self._watching.ask(GetSdoProgress(node=str(self._node_id)))
        except CanopenError:
            return 0, None  # the caller of the transfer gets the reason
        return progress_read.done, progress_read.total

    def cancel(self) -> None:
        """Request the cancellation on a separate connection; do nothing if the robot does not answer."""
        with contextlib.suppress(CanopenError), RobotClient.connect(self._robot.robot, _WATCH_S) as robot:
            robot.ask(CancelSdo(node=str(self._node_id), session=self._session))

    def close(self) -> None:
        if self._watching is not None:
            self._watching.close()

    def _reading(self) -> NodeReading | None:
        nodes = self._robot.ask(GetStatus()).nodes
        return next((node for node in nodes.values() if node.node_id == self._node_id), None)


def dictionary_of(place: NodePlace) -> ObjectDictionary | None:
    """Read the EDS of a robot's node, or return None without one; raise EdsError if the file cannot be read."""
    return read_eds(Path(place.eds), place.node_id).od if place.eds else None


@contextlib.contextmanager
def session_with(
    robot: RobotClient, place: NodePlace, od: ObjectDictionary | None, *, source: str | None = None
) -> Iterator[NodeSession]:
    """Open a session with a node of a running robot; `source` names the writer in the robot's events."""
    with contextlib.closing(RobotTransfers(robot, place.node_id, source=source)) as transfers:
        yield NodeSession(transfers, place.node_id, od, name=place.name, robot=robot.robot)
