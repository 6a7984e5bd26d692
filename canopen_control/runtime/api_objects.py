"""The API's methods about nodes and their objects: NMT commands, SDO transfers, process data that is written."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.nmt import COMMAND_NAMES
from canopen_control.errors import LocalProtocolError, UnknownName
from canopen_control.master.event_log import Event
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.messages.robot import (
    MAX_OBJECT,
    GetSdoProgress,
    NmtRequest,
    PdoWrite,
    SdoData,
    SdoPiece,
    SdoProgress,
    SdoRead,
    SdoWrite,
)
from canopen_control.runtime.process_data import write_mapped
from canopen_control.runtime.write_log import WriteLog, written_words

if TYPE_CHECKING:
    from canopen_control.cia301.sdo_client import SdoRequest
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.rpc.messages.robot import RobotHello, RobotPush
    from canopen_control.rpc.server import Call, Connection, Server
    from canopen_control.runtime.core import RobotCore

__all__ = ["ObjectMethods"]


class ObjectMethods:
    """Answers them on a server; `forget` drops what a connection has begun to write."""

    def __init__(self, robot: RobotCore, server: Server[RobotHello, RobotPush]) -> None:
        self._robot = robot
        self._pieces: dict[Connection, bytearray] = {}  # of what a connection writes next
        self._written = WriteLog()
        server.answers(NmtRequest, self._nmt)
        server.answers(SdoRead, self._read)
        server.answers(SdoWrite, self._write)
        server.answers(SdoPiece, self._take_piece)
        server.answers(GetSdoProgress, self._progress)
        server.answers(PdoWrite, self._write_pdo)

    def forget(self, connection: Connection) -> None:
        """Drop the pieces of a connection that has ended."""
        self._pieces.pop(connection, None)

    def _nmt(self, call: Call[NmtRequest]) -> None:
        name, wanted, robot = call.request.command, str(call.request.node), self._robot
        who = call.request.source or call.who
        if name not in COMMAND_NAMES:
            raise UnknownName(f"no NMT command {name!r}; there are: {', '.join(COMMAND_NAMES)}")
        for node in list(robot.nodes.values()) if wanted == "all" else [robot.node(wanted)]:
            self._robot.report(Event(robot.reactor.now(), "nmt_asked", node.name, f"{who} asked for NMT {name}"))
            node.command(COMMAND_NAMES[name], robot.reactor.now(), boot=call.request.boot)
            robot.bus_of(node).send_waiting()
        call.reply(Done())

    def _read(self, call: Call[SdoRead]) -> None:
        wanted, node = call.request, self._robot.node(str(call.request.node))
        request = node.sdo.read(
            wanted.index, wanted.subindex, block=wanted.block, timeout_ns=_nanoseconds(wanted.timeout)
        )
        request.context = lambda ended: _answer_read(call, ended)
        self._robot.bus_of(node).send_waiting()

    def _write(self, call: Call[SdoWrite]) -> None:
        wanted = call.request
        data = bytes(self._pieces.pop(call.connection, b"")) + wanted.data
        node = self._robot.node(str(wanted.node))
        self._robot.latch.check_write(wanted.index)
        request = node.sdo.write(wanted.index, wanted.subindex, data, timeout_ns=_nanoseconds(wanted.timeout))
        request.context = lambda ended: self._answer_write(call, node, data, ended)
        self._robot.bus_of(node).send_waiting()

    def _answer_write(self, call: Call[SdoWrite], node: RemoteNode, data: bytes, ended: SdoRequest) -> None:
        if ended.error is not None:
            call.refuse(ended.error)
            return
        call.reply(Done())
        who = call.request.source or call.who
        now = self._robot.reactor.now()
        what = written_words(node.od, ended.index, ended.subindex, data)
        text = self._written.words(now, node.name, who, what)
        self._robot.report(Event(now, "object_written", node.name, text))

    def _progress(self, call: Call[GetSdoProgress]) -> None:
        call.reply(SdoProgress(*self._robot.node(str(call.request.node)).sdo.progress))

    def _take_piece(self, call: Call[SdoPiece]) -> None:
        piece = call.request.data
        pieces = self._pieces.setdefault(call.connection, bytearray())
        if len(pieces) + len(piece) > MAX_OBJECT:
            del self._pieces[call.connection]
            raise LocalProtocolError(f"sdo_data: more than {MAX_OBJECT} bytes; write them straight on the bus")
        pieces += piece
        call.reply(Done())

    def _write_pdo(self, call: Call[PdoWrite]) -> None:
        wanted = call.request
        write_mapped(self._robot, self._robot.node(str(wanted.node)), wanted.index, wanted.subindex, wanted.data)
        call.reply(Done())


def _answer_read(call: Call[SdoRead], request: SdoRequest) -> None:
    if request.error is not None:
        call.refuse(request.error)
    elif len(request.data) > MAX_OBJECT:
        text = f"0x{request.index:04X}:{request.subindex:02X} has {len(request.data)} bytes, more than {MAX_OBJECT}"
        call.refuse(LocalProtocolError(f"{text}; end the robot and upload it straight from the bus"))
    else:
        call.reply(SdoData(request.data))


def _nanoseconds(seconds: float | None) -> int | None:
    return None if seconds is None else round(seconds * 1e9)
