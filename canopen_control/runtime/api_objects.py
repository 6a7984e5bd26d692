"""API methods for NMT commands, SDO transfers and process data of nodes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

from canopen_control.cia301.nmt import COMMAND_NAMES
from canopen_control.cia301.pdo import PdoCodec
from canopen_control.cia402.objects import ABORT_CONNECTION_OPTION, MOTION, axis_of
from canopen_control.errors import CanopenError, ControlError, LocalProtocolError, UnknownName
from canopen_control.hardware.interfaces import DIGITAL_OUTPUTS
from canopen_control.master.event_log import Event
from canopen_control.od.codec import decode, encode, fitted
from canopen_control.od.eds_values import format_value
from canopen_control.od.indices import FIRST_OBJECT, GUARD_TIME, HEARTBEAT_CONSUMER, LIFE_FACTOR
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.messages.robot import (
    MAX_OBJECT,
    CancelSdo,
    GetSdoProgress,
    MappedValue,
    NmtRequest,
    PdoWrite,
    SdoData,
    SdoPiece,
    SdoProgress,
    SdoRead,
    SdoWrite,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from canopen_control.cia301.pdo import MappedObject
    from canopen_control.cia301.sdo_exchange import SdoRequest
    from canopen_control.host.lineserver import Connection
    from canopen_control.master.cycle import ReceivedPdo
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.od.model import ObjectDictionary, Value
    from canopen_control.rpc.messages.robot import RobotHello, RobotPush
    from canopen_control.rpc.server import Call, Server
    from canopen_control.runtime.core import RobotCore


# Events about objects that clients write by SDO through a robot.
#
# The first `FEW` writes of one client to one node are reported one by one. Further writes, each within `WINDOW_NS` of
# the previous one, have the same text and are counted by the event log: restoring three hundred objects must not remove
# all other events from the log.


FEW: Final = 5
WINDOW_NS: Final = 2_000_000_000
_WIDEST: Final = 40  # characters of a value
_COMMUNICATION: Final = range(0x1000, 0x2000)  # identifiers and mappings are hexadecimal
_MAX: Final = 64  # remembered pairs of a client and a node


#: objects by which a drive detects the loss of the master (CiA 301, 7.5.2.11, 7.5.2.12, 7.5.2.19)


def refuse_unsupervised(node: RemoteNode, index: int, subindex: int, data: bytes) -> None:
    """Raise ControlError for a write after which a drive would no longer stop when the master is lost.

    Such a write disables what the boot has configured: the supervision of the master, or the reaction to its loss
    (0x6007). It is permitted while the node is taken out.
    """
    reaction = axis_of(index)[0] == ABORT_CONNECTION_OPTION
    if node.is_taken_out or not (reaction or index in (GUARD_TIME, LIFE_FACTOR, HEARTBEAT_CONSUMER)):
        return
    planned = next((write.data for write in reversed(node.plan.writes) if write.address == (index, subindex)), b"")
    if index == HEARTBEAT_CONSUMER:  # bits 0 to 15 are the time, bits 16 to 22 the node-ID
        lost = any(planned[:2]) and (planned[2:3] != data[2:3] or not any(data[:2]))
    else:
        lost = any(planned) and not any(data)
    if lost:
        raise ControlError(
            f"node {node.node_id} ({node.name}): 0x{index:04X}:{subindex:02X} was not written, because the drive would "
            f"no longer stop if the master died; first take the node out: canopen-control nmt preop {node.name}"
        )


def written_words(od: ObjectDictionary, index: int, subindex: int, data: bytes) -> str:
    """Return text such as `5 to 0x6060:00 Modes of operation`; the byte count is added if the EDS lacks the object."""
    address, entry = f"0x{index:04X}:{subindex:02X}", od.get(index, subindex)
    padded = None if entry is None else fitted(data, entry.data_type)
    if entry is None or padded is None:
        return f"{len(data)} bytes to {address}"
    value = decode(padded, entry.data_type)
    number = isinstance(value, int) and index not in _COMMUNICATION
    text = str(value) if number else format_value(value, entry.data_type)
    short = text if 0 < len(text) <= _WIDEST and text.isprintable() else f"{len(data)} bytes"
    return f"{short} to {address} {entry.name}"


class WriteLog:
    """Event texts about SDO writes; a client's consecutive writes to one node are summarised."""

    def __init__(self) -> None:
        self._counts: dict[tuple[str, str], tuple[int, int]] = {}  # number of writes, time of the last write

    def words(self, now: int, node: str, source: str, value: str) -> str:
        """Return the event text for a write by `source`; `now` is in monotonic ns."""
        count, last = self._counts.pop((node, source), (0, now))
        count = 1 if now - last > WINDOW_NS else count + 1
        if len(self._counts) >= _MAX:
            del self._counts[next(iter(self._counts))]
        self._counts[node, source] = count, now
        return f"{source} wrote {value}" if count <= FEW else f"{source} wrote more objects"


# Process data for clients: the objects in received TPDOs, and objects to send in RPDOs.
#
# Without a subscriber nothing is evaluated. A subscriber first receives all known values, and after each cycle the
# changed ones; a value that changed several times within a cycle is sent once. A value is the little-endian bytes
# of the object (CiA 301, 7.1), as in an SDO upload. Objects that move an axis (controlword, mode and targets,
# CiA 402-2) are written only by controllers, which have limits and timeouts.


class _Watched:
    """TPDO of a node, with the values last sent to subscribers."""

    __slots__ = ("count", "node", "objects", "pdo", "values")

    def __init__(self, node: str, pdo: ReceivedPdo, mapped: Sequence[MappedObject]) -> None:
        self.node, self.pdo, self.objects = node, pdo, mapped
        self.count, self.values = 0, tuple[Any, ...]()

    def changed(self) -> list[MappedValue]:
        """Return the mapped objects whose values have changed since the last call; the first call returns all."""
        pdo, before = self.pdo, self.values
        if pdo.count == self.count:
            return []
        self.count, self.values = pdo.count, pdo.values
        is_complete = len(before) == len(pdo.values)
        return [
            _object_value(mapped, value)
            for position, (mapped, value) in enumerate(zip(self.objects, pdo.values, strict=True))
            if mapped.index >= FIRST_OBJECT and not (is_complete and before[position] == value)
        ]


class ProcessDataFeed:
    """Latest values of the objects in received TPDOs, by node name."""

    def __init__(self, nodes: Iterable[RemoteNode]) -> None:
        self._watched = [
            _Watched(node.name, pdo, layout.objects)
            for node in nodes
            for layout, pdo in zip(node.plan.tpdos, node.received, strict=True)
        ]

    def everything(self) -> dict[str, list[MappedValue]]:
        """Return all values received in TPDOs since each node booted, by node name."""
        values: dict[str, list[MappedValue]] = {}
        for watched in self._watched:
            if watched.pdo.stamp >= 0:
                pairs = zip(watched.objects, watched.pdo.values, strict=True)
                values.setdefault(watched.node, []).extend(
                    _object_value(mapped, value) for mapped, value in pairs if mapped.index >= FIRST_OBJECT
                )
        return values

    def changes(self) -> dict[str, list[MappedValue]]:
        """Return the values that have changed since the last call, by node name."""
        values: dict[str, list[MappedValue]] = {}
        for watched in self._watched:
            if changed := watched.changed():
                values.setdefault(watched.node, []).extend(changed)
        return values


def write_mapped(robot: RobotCore, node: RemoteNode, index: int, subindex: int, data: bytes) -> None:
    """Write an object through an RPDO in the next cycle; raise ControlError if not allowed.

    Not allowed are objects in no RPDO, objects that move an axis, digital outputs that a controller commands, and
    any object while the node is not OPERATIONAL. An RPDO that moves no axis is sent once.
    """
    place = f"{node.label}: 0x{index:04X}:{subindex:02X}"
    output = robot.bus_of(node).network.image.output(node.node_id, index, subindex)
    mapped = next((entry for sent in node.sent for entry in sent.codec.objects if entry[:2] == (index, subindex)), None)
    if output is None or mapped is None:
        raise ControlError(f"{place} is not mapped in an RPDO; map it in bus.yml, or write it by SDO")
    if any(index - offset in MOTION for offset in node.plan.axes):
        raise ControlError(f"{place} moves the drive and is written by controllers only; command one of them")
    for joint in robot.joints.values():
        commanded = joint.commands.get(DIGITAL_OUTPUTS)
        if joint.axis.digital_outputs is output and commanded is not None and commanded.owner is not None:
            raise ControlError(f"{place} is commanded by {commanded.owner}; deactivate that controller first")
    if not node.ready:
        raise ControlError(f"{place} cannot be sent: the node is not operational: {node.reason or 'it has not booted'}")
    output.write(_number(data, mapped, place))


def _number(data: bytes, mapped: MappedObject, title: str) -> int:
    """Return the value to pack into the RPDO; raise ControlError if it is out of range, so that no cycle fails."""
    try:
        value = decode(data, mapped.data_type)
        PdoCodec((mapped,)).pack([value])
    except (ValueError, CanopenError) as error:
        raise ControlError(f"{title}: {error}") from None
    return value  # type: ignore[return-value]  # most often a number


def _object_value(mapped: MappedObject, value: Value) -> MappedValue:
    if isinstance(value, int):
        size = (mapped.bits + 7) // 8
        data = (value & ((1 << 8 * size) - 1)).to_bytes(size, "little")
    else:
        data = value if isinstance(value, bytes) else encode(value, mapped.data_type)
    return MappedValue(mapped.index, mapped.subindex, data)


class _Transfer(NamedTuple):
    """SDO transfer of a client, with the name of the client's session."""

    connection: Connection
    session: str | None
    node: RemoteNode
    request: SdoRequest


class ObjectMethods:
    """API methods for NMT commands, SDO transfers and objects in RPDOs; a transfer ends with its client."""

    def __init__(self, robot: RobotCore, server: Server[RobotHello, RobotPush]) -> None:
        self._robot = robot
        self._pieces: dict[Connection, bytearray] = {}  # first bytes of the next SDO write of a connection
        self._transfers: list[_Transfer] = []
        self._written = WriteLog()
        server.register(NmtRequest, self._nmt)
        server.register(SdoRead, self._read)
        server.register(SdoWrite, self._write)
        server.register(SdoPiece, self._take_piece)
        server.register(GetSdoProgress, self._progress)
        server.register(CancelSdo, self._cancel)
        server.register(PdoWrite, self._write_pdo)

    def forget(self, connection: Connection) -> None:
        """Cancel the transfers of a client that has disconnected, so that the next client need not wait for them."""
        self._pieces.pop(connection, None)
        self._end([transfer for transfer in self._transfers if transfer.connection is connection])

    def _nmt(self, call: Call[NmtRequest]) -> None:
        name, node_name, robot = call.request.command, str(call.request.node), self._robot
        source = call.request.source or call.client
        if name not in COMMAND_NAMES:
            raise UnknownName(f"no NMT command {name!r}; available: {', '.join(COMMAND_NAMES)}")
        for node in list(robot.nodes.values()) if node_name == "all" else [robot.node(node_name)]:
            self._robot.report(Event(robot.reactor.now(), "nmt_asked", node.name, f"{source} requested NMT {name}"))
            node.command(COMMAND_NAMES[name], robot.reactor.now(), boot=call.request.boot)
            robot.bus_of(node).send_waiting()
        call.reply(Done())

    def _read(self, call: Call[SdoRead]) -> None:
        upload, node = call.request, self._robot.node(str(call.request.node))
        request = node.sdo.read(
            upload.index, upload.subindex, block=upload.block, timeout_ns=_nanoseconds(upload.timeout)
        )
        self._begin(call, node, request, lambda ended: _answer_read(call, ended))

    def _write(self, call: Call[SdoWrite]) -> None:
        download = call.request
        data = bytes(self._pieces.pop(call.connection, b"")) + download.data
        node = self._robot.node(str(download.node))
        self._robot.latch.check_write(download.index)
        refuse_unsupervised(node, download.index, download.subindex, data)
        request = node.sdo.write(download.index, download.subindex, data, timeout_ns=_nanoseconds(download.timeout))
        self._begin(call, node, request, lambda ended: self._answer_write(call, node, data, ended))

    def _begin(
        self,
        call: Call[SdoRead] | Call[SdoWrite],
        node: RemoteNode,
        request: SdoRequest,
        answer: Callable[[SdoRequest], None],
    ) -> None:
        transfer = _Transfer(call.connection, call.request.session, node, request)
        self._transfers.append(transfer)

        def ended(request: SdoRequest) -> None:
            self._transfers.remove(transfer)
            answer(request)

        request.context = ended
        self._robot.bus_of(node).send_waiting()

    def _cancel(self, call: Call[CancelSdo]) -> None:
        node, session = self._robot.node(str(call.request.node)), call.request.session
        self._end([transfer for transfer in self._transfers if transfer.node is node and transfer.session == session])
        call.reply(Done())

    def _end(self, transfers: Iterable[_Transfer]) -> None:
        for transfer in transfers:
            transfer.node.sdo.cancel_transfer(transfer.request)
            self._robot.bus_of(transfer.node).send_waiting()

    def _answer_write(self, call: Call[SdoWrite], node: RemoteNode, data: bytes, ended: SdoRequest) -> None:
        if ended.error is not None:
            call.refuse(ended.error)
            return
        call.reply(Done())
        source = call.request.source or call.client
        now = self._robot.reactor.now()
        written_value = written_words(node.od, ended.index, ended.subindex, data)
        text = self._written.words(now, node.name, source, written_value)
        self._robot.report(Event(now, "object_written", node.name, text))

    def _progress(self, call: Call[GetSdoProgress]) -> None:
        call.reply(SdoProgress(*self._robot.node(str(call.request.node)).sdo.progress))

    def _take_piece(self, call: Call[SdoPiece]) -> None:
        piece = call.request.data
        pieces = self._pieces.setdefault(call.connection, bytearray())
        if len(pieces) + len(piece) > MAX_OBJECT:
            del self._pieces[call.connection]
            raise LocalProtocolError(
                f"sdo_data: more than {MAX_OBJECT} bytes; end the robot and write the object directly on the bus"
            )
        pieces += piece
        call.reply(Done())

    def _write_pdo(self, call: Call[PdoWrite]) -> None:
        request = call.request
        write_mapped(self._robot, self._robot.node(str(request.node)), request.index, request.subindex, request.data)
        call.reply(Done())


def _answer_read(call: Call[SdoRead], request: SdoRequest) -> None:
    if request.error is not None:
        call.refuse(request.error)
    elif len(request.data) > MAX_OBJECT:
        text = f"0x{request.index:04X}:{request.subindex:02X} has {len(request.data)} bytes, more than {MAX_OBJECT}"
        call.refuse(LocalProtocolError(f"{text}; end the robot and read the object directly on the bus"))
    else:
        call.reply(SdoData(request.data))


def _nanoseconds(seconds: float | None) -> int | None:
    return None if seconds is None else round(seconds * 1e9)
