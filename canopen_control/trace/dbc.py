"""PDO layout of a bus as a DBC file for SavvyCAN, cantools and Vector's tools, written by cantools.

Values are raw, as on the bus, with factor, offset and unit if the robot's files contain them. A DBC can name only whole
values, so statusword and controlword are split into named parts (`WORD_PARTS`). Heartbeats, EMCY and NMT commands are
included. Names in a DBC are C identifiers of at most 32 characters, unique within a message.
"""

from __future__ import annotations

import re
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.cia301.emcy import ERROR_TEXTS
from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID, NMT_COB_ID, NmtCommand, NmtState
from canopen_control.cia402 import objects
from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import command_of, decode_statusword
from canopen_control.errors import ConfigError
from canopen_control.frame import EXTENDED_FLAG
from canopen_control.trace.network_description import address_text, is_gap, mapped_name, mapped_object, pdo_name

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from cantools.database.can import Message, Node, Signal
    from cantools.database.namedsignalvalue import NamedSignalValue

    from canopen_control.rpc.messages.layout import MappedEntry, PdoLayout
    from canopen_control.trace.network_description import NetworkDescription, NodeDescription


_LONGEST = 32
_HEARTBEAT_BITS = 7
_MASTER = "master"


class WordField(NamedTuple):
    """Named part of a statusword or controlword, with its first bit and number of bits."""

    name: str
    start: int
    bits: int


WORD_PARTS: Mapping[int, tuple[WordField, ...]] = {
    objects.STATUSWORD: (
        WordField("state", 0, 7),  # bits 0 to 6 without bit 4 give the state (CiA 402-2)
        WordField("warning", 7, 1),
        WordField("bit8", 8, 1),
        WordField("remote", 9, 1),
        WordField("target_reached", 10, 1),
        WordField("internal_limit", 11, 1),
        WordField("mode_specific", 12, 2),
        WordField("manufacturer", 14, 2),
    ),
    objects.CONTROLWORD: (
        WordField("command", 0, 8),  # bits 0 to 7; 4 to 6 depend on the mode (CiA 402-2)
        WordField("halt", 8, 1),
        WordField("bit9", 9, 1),
        WordField("bit10", 10, 1),
        WordField("manufacturer", 11, 5),
    ),
}


def _words(name: str) -> str:
    return name.replace("_", " ")


def _state_names() -> dict[int, str]:
    states = ((bits, decode_statusword(bits)) for bits in range(0x80))
    return {bits: _words(state.name) for bits, state in states if state is not None}


def _command_names() -> dict[int, str]:
    commands = ((bits, command_of(bits, 0)) for bits in range(0x100))
    return {bits: _words(command.name) for bits, command in commands if command is not None}


_MODES = {int(mode): mode.name for mode in OperationMode}
_VALUES: Mapping[tuple[int, str], Mapping[int, str]] = {
    (objects.STATUSWORD, "state"): _state_names(),
    (objects.CONTROLWORD, "command"): _command_names(),
    (objects.MODES_OF_OPERATION, ""): _MODES,
    (objects.MODES_OF_OPERATION_DISPLAY, ""): _MODES,
    (objects.ERROR_CODE, ""): ERROR_TEXTS,
}


def dbc_text(network: NetworkDescription) -> str:
    """Return the text of a DBC file; raise ConfigError if cantools is not installed."""
    try:
        from cantools.database.can import Database
    except ImportError:
        raise ConfigError("a DBC needs cantools: pip install 'canopen-control[dbc]'") from None
    senders = _senders(network)
    messages = [_message(message) for message in _distinct(_messages(network, senders))]
    database = Database(messages, nodes=[_node(name) for name in senders.values()], version="")
    # Vector's tools read windows-1252; LF line ends, as usual in DBC files
    return str(database.as_dbc_string()).replace("\r\n", "\n")


@dataclass(slots=True)
class _Signal:
    """Signal of a message, with its first bit and its length in bits."""

    name: str
    start: int
    bits: int
    signed: bool = False
    real: bool = False
    comment: str = ""
    values: Mapping[int, str] = field(default_factory=dict)
    factor: float = 1.0
    offset: float = 0.0
    unit: str = ""


@dataclass(slots=True)
class _Message:
    """Message with its identifier and the receiver of all its signals."""

    can_id: int
    name: str
    length: int
    sender: str
    receiver: str
    comment: str = ""
    signals: list[_Signal] = field(default_factory=list)

    def add(self, signal: _Signal) -> None:
        """Append a signal under a unique name."""
        signal.name = _unused(signal.name, {present.name for present in self.signals})
        self.signals.append(signal)


def _distinct(messages: Iterable[_Message]) -> list[_Message]:
    distinct: list[_Message] = []
    for message in messages:
        message.name = _unused(message.name, {message.name for message in distinct})
        distinct.append(message)
    return distinct


def _node(name: str) -> Node:
    from cantools.database.can import Node

    return Node(name, None)


def _message(message: _Message) -> Message:
    from cantools.database.can import Message

    return Message(
        message.can_id & 0x1FFFFFFF,
        message.name,
        message.length,
        [_signal(signal, message.receiver) for signal in message.signals],
        comment=_plain(message.comment) or None,
        senders=[message.sender],
        is_extended_frame=bool(message.can_id & EXTENDED_FLAG),
        strict=False,
    )


def _signal(signal: _Signal, receiver: str) -> Signal:
    from cantools.database.can import Signal
    from cantools.database.conversion import BaseConversion

    return Signal(
        signal.name,
        signal.start,
        signal.bits,
        is_signed=signal.signed,
        conversion=BaseConversion.factory(
            _plain_number(signal.factor),
            _plain_number(signal.offset),
            is_float=signal.real,
            choices=_choices(signal) or None,
        ),
        unit=_plain(signal.unit) or None,
        comment=_plain(signal.comment) or None,
        receivers=[receiver],
    )


def _choices(signal: _Signal) -> OrderedDict[int, str | NamedSignalValue]:
    from cantools.database.namedsignalvalue import NamedSignalValue

    return OrderedDict((value, NamedSignalValue(value, _plain(text))) for value, text in signal.values.items())


def _senders(network: NetworkDescription) -> dict[int, str]:
    """Return the DBC names of the nodes by node-ID; the key 0 is the master."""
    names = {0: _MASTER}
    for node_id, node in sorted(network.nodes.items()):
        names[node_id] = _unused(_identifier(node.name or f"node_{node_id}"), set(names.values()))
    return names


def _messages(network: NetworkDescription, senders: Mapping[int, str]) -> Iterator[_Message]:
    yield _nmt(network, senders)
    yield _Message(network.sync_cob_id, "SYNC", 0, _MASTER, _MASTER, "CiA 301, 7.2.5; perhaps with a counter")
    if network.master_node_id is not None:
        yield _heartbeat(network.master_node_id, _MASTER, _MASTER)
    for node_id, node in sorted(network.nodes.items()):
        sender = senders[node_id]
        for pdo in node.pdos:
            yield _pdo(node, pdo, sender)
        yield _emcy(node, sender)
        yield _heartbeat(node_id, sender, sender)


def _nmt(network: NetworkDescription, senders: Mapping[int, str]) -> _Message:
    message = _Message(NMT_COB_ID, "NMT", 2, _MASTER, "Vector__XXX", "NMT command (CiA 301, 7.2.8.2)")
    message.add(_Signal("NMT_command", 0, 8, values={int(command): _words(command.name) for command in NmtCommand}))
    nodes = {0: "all nodes", **{node_id: senders[node_id] for node_id in sorted(network.nodes)}}
    message.add(_Signal("NMT_node_id", 8, 8, values=nodes))
    return message


def _heartbeat(node_id: int, name: str, sender: str) -> _Message:
    message = _Message(
        ERROR_CONTROL_COB_ID + node_id, _identifier(f"{name}_heartbeat"), 1, sender, _MASTER, f"node {node_id}"
    )
    states = {int(state): _words(state.name) for state in NmtState}
    message.add(_Signal("NMT_state", 0, _HEARTBEAT_BITS, values=states))
    message.add(_Signal("toggle", _HEARTBEAT_BITS, 1))
    return message


def _emcy(node: NodeDescription, sender: str) -> _Message:
    message = _Message(node.emcy_cob_id, _identifier(f"{sender}_EMCY"), 8, sender, _MASTER, f"node {node.node_id}")
    message.add(_Signal("error_code", 0, 16, values=ERROR_TEXTS))
    message.add(_Signal("error_register", 16, 8))
    message.add(_Signal("error_data", 24, 40))
    return message


def _pdo(node: NodeDescription, pdo: PdoLayout, sender: str) -> _Message:
    bits = sum(mapped.bits for mapped in pdo.objects)
    is_rpdo = pdo.direction == "rpdo"
    message = _Message(
        pdo.cob_id,
        _identifier(f"{sender}_{pdo_name(pdo)}"),
        (bits + 7) // 8,
        _MASTER if is_rpdo else sender,
        sender if is_rpdo else _MASTER,
        f"{pdo_name(pdo)} of node {node.node_id}, transmission type {pdo.transmission_type}",
    )
    start = 0
    for mapped in pdo.objects:
        if not is_gap(mapped):
            for signal in _signals(mapped, start, is_drive=node.is_drive):
                message.add(signal)
        start += mapped.bits
    return message


def _signals(mapped: MappedEntry, start: int, *, is_drive: bool) -> Iterator[_Signal]:
    """Yield the signals of a mapped object: one for each named part of a word, or one for the whole object."""
    title = mapped_name(mapped)
    name, comment = _identifier(title), f"{address_text(mapped.index, mapped.subindex)} {title}"
    base = objects.axis_of(mapped.index)[0] if is_drive and not mapped.subindex else 0
    parts = WORD_PARTS.get(base, ()) if mapped.bits == 16 else ()
    for part in parts:
        values = _VALUES.get((base, part.name), {})
        text = f"{comment}, bit {part.start}" + (f" to {part.start + part.bits - 1}" if part.bits > 1 else "")
        yield _Signal(
            f"{name[: _LONGEST - 1 - len(part.name)]}_{part.name}",
            start + part.start,
            part.bits,
            comment=text,
            values=values,
        )
    if not parts:
        data_type = mapped_object(mapped).data_type
        real = data_type.is_real
        signed = data_type.signed or real
        values = _VALUES.get((base, ""), {})
        meaning = mapped.factor, mapped.offset, mapped.unit
        yield _Signal(name, start, mapped.bits, signed, real, comment, values, *meaning)


# -- text


def _identifier(text: str) -> str:
    """Convert a text to a C identifier of at most 32 characters."""
    cleaned = re.sub(r"[^A-Za-z0-9]+", "_", text.encode("ascii", "ignore").decode()).strip("_") or "x"
    return (cleaned if not cleaned[0].isdigit() else f"_{cleaned}")[:_LONGEST]


def _plain_number(value: float) -> float:
    """Convert a whole number to int, because the file shows an int without a decimal point."""
    return int(value) if value.is_integer() else value


def _unused(name: str, names: set[str]) -> str:
    number, candidate = 2, name
    while candidate in names:
        suffix = f"_{number}"
        candidate, number = name[: _LONGEST - len(suffix)] + suffix, number + 1
    return candidate


def _plain(text: str) -> str:
    """Convert a text to one line of plain ASCII, with quotes and backslashes replaced."""
    return text.encode("ascii", "replace").decode().replace("\\", "/").replace('"', "'").replace("\n", " ")
