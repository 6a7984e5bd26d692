"""Signals of a scope, written `NODE:OBJECT` or `JOINT:velocity`, and the sources of their samples."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.cia402.objects import STATUSWORD
from canopen_control.commissioning.node_session import is_abort
from canopen_control.commissioning.object_rows import READS_PER_S, unit_of
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.od.address import find_object
from canopen_control.od.codec import decode, fitted
from canopen_control.rpc.messages.robot import GetStatus, ProcessData, Subscribe
from canopen_control.rpc.messages.state import StateSample

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from canopen_control.client import RobotClient
    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.od.model import DataType
    from canopen_control.rpc.messages.state import JointReading


# Sources of a scope's samples: TPDOs and joint states of a running robot, and SDO for objects that no TPDO maps.
#
# Objects in TPDOs cause no traffic and are sampled with each SYNC. The others are polled one at a time, through a
# running robot no faster than `READS_PER_S` in total, so that the scope does not delay the robot's own requests.


_EVERY_CYCLE: Final = 1000.0  # rate in Hz at which every cycle is reported


class ScopeSource(Protocol):
    """Source of scope samples; sample times are Unix times in seconds."""

    def samples(self, seconds: float) -> Iterator[tuple[float, tuple[float | None, ...]]]:
        """Wait for up to `seconds` and yield the samples of that time."""

    def cycles(self) -> tuple[int, int] | None:
        """Return the numbers of cycles and of missed cycles of a robot, or None without a robot."""


class PolledSource:
    """Source on a bare bus that reads every signal by SDO up to `rate` times a second."""

    def __init__(self, values: SignalValues, sessions: Mapping[int, NodeSession], rate: float) -> None:
        self._values, self._sessions = values, sessions
        self._period = 1.0 / rate
        self._next_sample = time.monotonic()

    def cycles(self) -> None:
        return

    def samples(self, seconds: float) -> Iterator[tuple[float, tuple[float | None, ...]]]:
        wait = self._next_sample - time.monotonic()
        if wait > 0:
            time.sleep(min(wait, seconds))
            if wait > seconds:
                return
        self._next_sample = max(self._next_sample + self._period, time.monotonic() - self._period)
        for signal in self._values.objects:
            read_signal(self._values, self._sessions[signal.node_id], signal)
        yield time.time(), self._values.row


class RobotSource:
    """Source of samples from a running robot: TPDOs and joint states as they arrive, other objects by polling."""

    def __init__(
        self, client: RobotClient, values: SignalValues, sessions: Mapping[int, NodeSession], rate: float
    ) -> None:
        self._client, self._values, self._sessions = client, values, sessions
        self._ids = {session.name: node_id for node_id, session in sessions.items()}
        self._polled = {signal.key: signal for signal in values.objects}
        self._period = 1.0 / min(rate, READS_PER_S)
        self._next_sample = time.monotonic() + self._period  # the first message has all that TPDOs carry
        if values.joints:
            joints = client.ask(GetStatus()).joints
            if missing := [joint for joint in values.joints if joint not in joints]:
                raise ConfigError(f"robot {client.robot} has no joint {missing[0]!r}; its joints: {', '.join(joints)}")
        client.ask(Subscribe(pdos=bool(values.objects), state_rate=_EVERY_CYCLE if values.joints else None))

    def cycles(self) -> tuple[int, int]:
        cycle = self._client.ask(GetStatus()).cycle
        return cycle.count, cycle.missed

    @property
    def polled(self) -> list[ScopeSignal]:
        """Signals that no TPDO has contained so far."""
        return list(self._polled.values())

    def samples(self, seconds: float) -> Iterator[tuple[float, tuple[float | None, ...]]]:
        wait = min(seconds, max(self._next_sample - time.monotonic(), 0.0)) if self._polled else seconds
        end = time.monotonic() + wait
        for message in self._client.messages(wait):
            if (isinstance(message, ProcessData) and self._take(message)) or (
                isinstance(message, StateSample) and self._values.put_joints(message.joints)
            ):
                yield message.time, self._values.row
            if time.monotonic() >= end:
                break
        if self._polled and time.monotonic() >= self._next_sample:
            yield from self._poll()

    def _take(self, message: ProcessData) -> bool:
        is_read = False
        for name, mapped in message.nodes.items():
            node_id = self._ids.get(name)
            for entry in mapped if node_id is not None else ():
                if self._values.put(node_id or 0, entry.index, entry.subindex, entry.data):
                    self._polled.pop((node_id or 0, entry.index, entry.subindex), None)
                    is_read = True
        return is_read

    def _poll(self) -> Iterator[tuple[float, tuple[float | None, ...]]]:
        """Read the next polled signal, in round-robin order, and yield a sample."""
        self._next_sample = time.monotonic() + self._period
        key, signal = next(iter(self._polled.items()))
        self._polled[key] = self._polled.pop(key)
        read_signal(self._values, self._sessions[signal.node_id], signal)
        yield time.time(), self._values.row


def read_signal(values: SignalValues, session: NodeSession, signal: ScopeSignal) -> None:
    """Read a signal by SDO and store its value, or None if the node refuses the upload."""
    try:
        data = session.read(signal.index, signal.subindex)
    except CanopenError as error:
        if not is_abort(error):
            raise
        data = b""
    values.put(signal.node_id, signal.index, signal.subindex, data)


MAX_SIGNALS: Final = 8
_QUANTITIES: Final = {"position": "rad or m", "velocity": "rad/s or m/s", "effort": "", "command": ""}
"""Quantities of a joint that a robot reports, with their units."""


@dataclass(frozen=True, slots=True)
class ScopeSignal:
    """Numeric object of a node; `name` is the text for users and files, such as left_drive:0x6064."""

    node_id: int
    index: int
    subindex: int
    data_type: DataType
    name: str
    label: str = ""
    unit: str = ""

    @property
    def key(self) -> tuple[int, int, int]:
        return self.node_id, self.index, self.subindex

    @property
    def topic(self) -> str:
        """Topic of the signal in a bag, below the name of the node."""
        return f"o{self.index:04X}_{self.subindex:02X}"

    def value(self, data: bytes) -> float | None:
        """Decode the bytes of the object, or return None if their length does not fit the data type."""
        padded = fitted(data, self.data_type)
        number = None if padded is None else decode(padded, self.data_type)
        return float(number) if isinstance(number, int | float) else None


@dataclass(frozen=True, slots=True)
class JointSignal:
    """Signal of a joint of a running robot: position, velocity, effort or command."""

    joint: str
    quantity: str
    label: str = "of the joint"

    @property
    def name(self) -> str:
        return f"{self.joint}:{self.quantity}"

    @property
    def unit(self) -> str:
        """Unit of the quantity, or "" if it depends on the joint."""
        return _QUANTITIES[self.quantity]

    @property
    def key(self) -> tuple[str, str]:
        return self.joint, self.quantity

    @property
    def topic(self) -> str:
        """Topic of the signal in a bag, below the name of the joint."""
        return self.quantity

    def value(self, reading: JointReading) -> float | None:
        """Return the value of the signal in a joint reading, or None if unknown."""
        value: float | None = getattr(reading, self.quantity)
        return value


Signal = ScopeSignal | JointSignal


def joint_signal_of(text: str) -> JointSignal | None:
    """Parse a joint signal such as `JOINT:velocity`, or return None for other texts."""
    joint, _, quantity = text.partition(":")
    return JointSignal(joint, quantity) if joint and quantity in _QUANTITIES else None


def node_of(text: str) -> str:
    """Return the node in `NODE:OBJECT`; raise ConfigError if the text does not have this form."""
    node, colon, item = text.partition(":")
    if not (node and colon and item):
        raise ConfigError(
            f"{text!r} is not a signal; write NODE:OBJECT, such as 3:0x6064 or left_drive:0x606C, or for a running "
            f"robot JOINT:QUANTITY ({', '.join(_QUANTITIES)})"
        )
    return node


def signal_of(text: str, session: NodeSession) -> ScopeSignal:
    """Return the signal `NODE:OBJECT`; raise ConfigError if the object is unknown, not numeric or not readable."""
    item = text.partition(":")[2]
    address = find_object(item, session.dictionary)
    entry = address.entry
    if entry is None:
        raise ConfigError(f"{text}: the EDS of {session} has no 0x{address.index:04X}:{address.subindex:02X}")
    if not (entry.data_type.is_integer or entry.data_type.is_real) or not entry.readable:
        raise ConfigError(f"{text}: {address.label} is not a readable number ({entry.data_type.name}, {entry.access})")
    sub = f":{entry.subindex:02X}" if entry.subindex else ""
    return ScopeSignal(
        session.node_id,
        entry.index,
        entry.subindex,
        entry.data_type,
        f"{session.name or session.node_id}:0x{entry.index:04X}{sub}",
        entry.name,
        unit_of(session.dictionary, entry.index, entry.subindex),
    )


def statusword_of(session: NodeSession) -> ScopeSignal:
    """Return the signal of a node's statusword; raise ConfigError if the node has none."""
    return signal_of(f"{session.node_id}:0x{STATUSWORD:04X}", session)


class SignalValues:
    """Latest value of each signal, as a row for `ScopeCapture`."""

    def __init__(self, signals: Iterable[Signal]) -> None:
        self.signals = tuple(signals)
        self._values: list[float | None] = [None] * len(self.signals)
        self._places: dict[tuple[int, int, int], list[tuple[int, ScopeSignal]]] = {}
        self._joints: list[tuple[int, JointSignal]] = []
        for place, signal in enumerate(self.signals):
            if isinstance(signal, JointSignal):
                self._joints.append((place, signal))
            else:
                self._places.setdefault(signal.key, []).append((place, signal))

    @property
    def objects(self) -> list[ScopeSignal]:
        return [signal for signal in self.signals if isinstance(signal, ScopeSignal)]

    @property
    def joints(self) -> list[str]:
        """Names of the joints with sampled signals, without duplicates."""
        return list(dict.fromkeys(signal.joint for _, signal in self._joints))

    @property
    def row(self) -> tuple[float | None, ...]:
        """Latest values in the order of the signals."""
        return tuple(self._values)

    def put(self, node_id: int, index: int, subindex: int, data: bytes) -> bool:
        """Decode and store the bytes of an object; return whether the object is one of the signals."""
        places = self._places.get((node_id, index, subindex), ())
        for place, signal in places:
            self._values[place] = signal.value(data)
        return bool(places)

    def put_joints(self, readings: Mapping[str, JointReading]) -> bool:
        """Store the joint signals in a robot's readings; return whether the scope has joint signals."""
        for place, signal in self._joints:
            reading = readings.get(signal.joint)
            self._values[place] = None if reading is None else signal.value(reading)
        return bool(self._joints)
