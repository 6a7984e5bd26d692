"""Reads the parameters of a node through a service session: for a backup, a comparison, or before they are written.

What the node refuses is left out and told with the reason. With `twice` everything is read a second time: what differs
then lives by itself, whatever the EDS says, and is no parameter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.errors import CanopenError, SdoLengthError
from canopen_control.od.model import DataType
from canopen_control.service.backup_choice import parameters_of, without_unused_slots
from canopen_control.service.node_session import is_abort
from canopen_control.service.parameter_set import OBJECTS, TEXTS, ParameterSet, identity_from, same_value

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from canopen_control.od.model import Address, Entry, Value
    from canopen_control.service.node_session import NodeSession
    from canopen_control.service.parameter_set import DeviceIdentity

    Told = Callable[[int, int], None]

__all__ = ["LeftOut", "device_identity", "entry_label", "read_parameters", "read_same", "read_values", "reason_of"]

_VARIES = "two readings differed, so it is no parameter"


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A parameter that was not read, and why."""

    entry: Entry
    why: str

    def __str__(self) -> str:
        return f"{entry_label(self.entry)}: {self.why}"


def entry_label(entry: Entry) -> str:
    """Return address and name of a parameter."""
    return f"0x{entry.index:04X}:{entry.subindex:02X} {entry.name}"


def read_parameters(
    session: NodeSession, *, twice: bool = True, told: Told | None = None
) -> tuple[ParameterSet, list[LeftOut]]:
    """Read identity and parameters; ConfigError without an EDS, RemoteProtocolError where the node does not answer.

    `told(done, of)` hears how far it is.
    """
    od = session.dictionary
    identity = device_identity(session)
    entries = parameters_of(od)
    total = len(entries) * (2 if twice else 1)
    values, left_out = read_values(session, entries, lambda done: told(done, total) if told else None)
    if twice:
        again, _ = read_values(
            session, [od[each] for each in values], lambda done: told(len(entries) + done, total) if told else None
        )
        for address in [each for each, value in values.items() if not _again(od[each], again, value)]:
            left_out.append(LeftOut(od[address], _VARIES))
            del values[address]
    return ParameterSet(od, session.node_id, identity, without_unused_slots(values), str(session)), left_out


def read_same(session: NodeSession, file: ParameterSet, told: Told | None = None) -> tuple[ParameterSet, list[LeftOut]]:
    """Read from a node what a file holds, by the types of the file; a session without an EDS takes its dictionary."""
    od = file.od.for_node(session.node_id)
    if session.od is None:
        session.od = od
    entries = [od[address] for address in file.values]
    identity = device_identity(session)
    values, left_out = read_values(session, entries, lambda done: told(done, len(entries)) if told else None)
    return ParameterSet(od, session.node_id, identity, values, str(session)), left_out


def _again(entry: Entry, again: Mapping[Address, Value], value: Value) -> bool:
    return entry.address in again and same_value(entry, again[entry.address], value)


def read_values(
    session: NodeSession, entries: Iterable[Entry], told: Callable[[int], None] | None = None
) -> tuple[dict[Address, Value], list[LeftOut]]:
    """Read these objects: the values by address, and what the node refused or answered in another length."""
    values: dict[Address, Value] = {}
    left_out = []
    for number, entry in enumerate(entries, 1):
        try:
            values[entry.address] = session.read_value(entry)
        except CanopenError as error:
            if not (isinstance(error, SdoLengthError) or is_abort(error)):
                raise
            left_out.append(LeftOut(entry, reason_of(error)))
        if told is not None:
            told(number)
    return values, left_out


def reason_of(error: CanopenError) -> str:
    """Return why a node refused an object, without the object: its place is told beside it."""
    text = str(error)
    place = text.find("abort 0x")
    return text[place:] if place >= 0 else text


def device_identity(session: NodeSession) -> DeviceIdentity:
    """Read who the node is; the first question, so that a node that is not there is told at once."""
    numbers = {name: session.number(*OBJECTS[name]) for name in OBJECTS if name not in TEXTS.values()}
    return identity_from(numbers, {name: _text(session, *OBJECTS[name]) for name in TEXTS.values()})


def _text(session: NodeSession, index: int, subindex: int) -> str:
    entry = None if session.od is None else session.od.get(index, subindex)
    if entry is None or entry.data_type is not DataType.VISIBLE_STRING:
        return ""
    try:
        value = session.read_value(entry)
    except CanopenError as error:
        if not (isinstance(error, SdoLengthError) or is_abort(error)):
            raise
        return ""
    return " ".join(str(value).split())
