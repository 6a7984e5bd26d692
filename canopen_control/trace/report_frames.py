"""What recorded frames tell of a run: bus load, who spoke how much, the states of drives, and the last words.

The law of this file: frames are decoded by the one decoder, in the order they came. Times are seconds from `begin`
(Unix). A bus nobody described is read by the predefined connection set.
"""

from __future__ import annotations

from collections import Counter, deque
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.cia301.nmt import state_of_byte
from canopen_control.cia402 import objects
from canopen_control.cia402.state import decode_statusword
from canopen_control.frame import FRAME_BITS
from canopen_control.rpc.messages.state import RobotEvent
from canopen_control.trace.decoder import DecodedFrame, Decoder, Mark
from canopen_control.trace.frame_lines import identifier_text
from canopen_control.trace.network_description import NetworkDescription
from canopen_control.trace.report_facts import BusFacts, BusLoad, FrameFacts, NodeFacts
from canopen_control.trace.report_samples import Spans

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.frame import CanFrame
    from canopen_control.trace.flight_file import FlightFrame
    from canopen_control.trace.report_facts import Span

__all__ = ["FrameReader", "read_frames"]

_NS: Final = 1_000_000_000
_BIN_S: Final = 0.5  # of the bus load
_MOST_BINS: Final = 20_000  # three hours
_BEFORE, _AFTER = 40, 15  # frames around the fault that are shown
_SILENT_S: Final = 0.5
_MOST_NOTABLE: Final = 1000
_LEVELS: Final = {Mark.NOTABLE: "info", Mark.WARNING: "warning", Mark.ERROR: "error"}


class _Heard(NamedTuple):
    """A decoded frame, its bus, and when it came."""

    bus: str
    time: float
    decoded: DecodedFrame


class _Drive(NamedTuple):
    """A node that was heard: the states of its communication, and of its axes by number."""

    name: str
    nmt: Spans
    axes: dict[int, Spans]


class FrameReader:
    """Reads frames in order; then `buses`, `nodes`, `around`, `last_words` and `notable` have what they told."""

    def __init__(self, networks: Mapping[str, NetworkDescription], begin: float, fault: float | None) -> None:
        self._networks, self._begin, self._fault = networks, begin, fault
        self._decoders: dict[str, Decoder] = {}
        self._loads: dict[str, Counter[int]] = {}
        self._services: dict[str, Counter[str]] = {}
        self._drives: dict[tuple[str, int], _Drive] = {}
        self._same: dict[tuple[str, int], bytes] = {}
        self._before: deque[_Heard] = deque(maxlen=_BEFORE)
        self._after: list[_Heard] = []
        self._last: dict[tuple[str, int], _Heard] = {}
        self._heard: dict[tuple[str, int], float] = {}  # when each node spoke last
        self._end = 0.0
        self._told: set[tuple[int, str]] = set()
        self.notable: list[RobotEvent] = []  # frames that change or break something

    def read(self, time_ns: int, bus: str, frame: CanFrame) -> None:
        """Take the next frame."""
        decoder = self._decoders.get(bus)
        if decoder is None:
            network = self._networks.get(bus) or NetworkDescription(bus)
            decoder = self._decoders[bus] = Decoder(network)
            self._loads[bus], self._services[bus] = Counter(), Counter()
        self._end = time = time_ns / _NS - self._begin
        self._loads[bus][int(time // _BIN_S)] += FRAME_BITS + 8 * len(frame.data)
        decoded = decoder.decode(frame, time_ns)
        self._services[bus][decoded.service] += 1
        self._follow(bus, time, decoded)
        self._remember(bus, time, decoded)
        if decoded.mark is not Mark.PLAIN and len(self.notable) < _MOST_NOTABLE:
            self._note(time_ns, decoded)

    def _follow(self, bus: str, time: float, decoded: DecodedFrame) -> None:
        """See the states of a node: by its heartbeats, and its statuswords, each only when it says something else."""
        if decoded.node_id is None or decoded.service not in ("hb", "pdo") or not decoded.data:
            return
        drive = self._drives.setdefault((bus, decoded.node_id), _Drive(decoded.node, Spans(), {}))
        if decoded.service == "hb":
            state = state_of_byte(decoded.data[0])
            drive.nmt.see(time, state.name if state is not None else None)
        elif self._same.get((bus, decoded.can_id)) != decoded.data:
            self._same[bus, decoded.can_id] = decoded.data
            for value in decoded.values:
                index, axis = objects.axis_of(value.index)
                if index == objects.STATUSWORD and isinstance(value.value, int):
                    drive_state = decode_statusword(value.value)
                    name = drive_state.name if drive_state is not None else None
                    drive.axes.setdefault(axis, Spans()).see(time, name)

    def _note(self, time_ns: int, decoded: DecodedFrame) -> None:
        """Take a frame for an event, a repeated one only once: a drive in fault says so in every statusword."""
        said = (decoded.can_id, decoded.text)
        if said in self._told:
            return
        self._told.add(said)
        node = decoded.who or None
        text = f"{node or 'bus'}: {decoded.subject or decoded.service} {decoded.text}".rstrip()
        level = _LEVELS[decoded.mark]
        self.notable.append(RobotEvent(time=time_ns / _NS, kind=decoded.service, node=node, level=level, text=text))

    def _remember(self, bus: str, time: float, decoded: DecodedFrame) -> None:
        heard = _Heard(bus, time, decoded)
        if decoded.node_id is not None and _from_node(decoded):
            self._heard[bus, decoded.node_id] = time
        if self._fault is None or time <= self._fault:
            self._before.append(heard)
            if decoded.node_id is not None and _from_node(decoded):
                self._last[bus, decoded.node_id] = heard
        elif len(self._after) < _AFTER:
            self._after.append(heard)

    @property
    def around(self) -> list[FrameFacts]:
        """The last frames before the fault, or of all, and the first after it."""
        return [_line(each) for each in (*self._before, *self._after)]

    @property
    def last_words(self) -> list[FrameFacts]:
        """The last frame of each node before the fault, the longest silent first."""
        return [_line(each) for each in sorted(self._last.values(), key=lambda heard: heard.time)]

    def buses(self) -> dict[str, BusFacts]:
        """Return what each bus has carried."""
        facts = {}
        for bus, counted in self._loads.items():
            bitrate = self._decoders[bus].network.bitrate
            bits, width = _coarse(counted)
            bins = [each for each in range(min(bits), max(bits) + 1) if self._covered(each, width) > width / 5]
            load = [bits[each] / self._covered(each, width) / bitrate for each in bins]
            times = [round((each + 0.5) * width, 3) for each in bins]
            services = dict(self._services[bus].most_common())
            facts[bus] = BusFacts(sum(services.values()), services, bitrate, BusLoad(times, load))
        return facts

    def _covered(self, number: int, width: float) -> float:
        """Return how many seconds of a bin the recording covers: the last one is rarely whole."""
        return min((number + 1) * width, self._end) - max(number * width, 0.0)

    def nodes(self) -> dict[str, NodeFacts]:
        """Return what `node_spans` returns, its axes as "axis N"; a node that fell silent is in no known state."""
        facts: dict[str, NodeFacts] = {}
        for (bus, node_id), drive in sorted(self._drives.items()):
            heard = self._heard.get((bus, node_id), self._end)
            nmt = self._ended(drive.nmt, heard)
            axes = {f"axis {axis}": self._ended(spans, heard) for axis, spans in drive.axes.items()}
            if nmt or axes:
                facts[drive.name or f"node {node_id}"] = NodeFacts(bus, node_id, nmt, axes)
        return facts

    def _ended(self, spans: Spans, heard: float) -> list[Span]:
        if spans and self._end - heard > _SILENT_S:
            spans.see(heard, None)
        return spans.end(self._end)


def _coarse(bits: Counter[int]) -> tuple[Counter[int], float]:
    """Return bits by bin and the width of a bin in s: wider where a recording, or one wrong time in it, spans days."""
    many = 1 + (max(bits) - min(bits)) // _MOST_BINS
    coarse: Counter[int] = Counter()
    for number, count in bits.items():
        coarse[number // many] += count
    return coarse, many * _BIN_S


def _line(heard: _Heard) -> FrameFacts:
    bus, time, decoded = heard
    return FrameFacts(
        time=round(time, 6),
        bus=bus,
        id=identifier_text(decoded.can_id),
        data=decoded.data.hex(" ").upper(),
        service=decoded.subject or decoded.service,
        node=decoded.who,
        node_id=decoded.node_id,
        text=decoded.text,
        mark=decoded.mark.name.lower(),
    )


def _from_node(decoded: DecodedFrame) -> bool:
    """Whether the node itself has spoken, as far as the names of the predefined set tell."""
    if decoded.service == "pdo":
        return decoded.subject.startswith("TPDO")
    return decoded.service in ("hb", "emcy") or decoded.subject == "SDO response"


def read_frames(
    frames: Sequence[FlightFrame],
    networks: Mapping[str, NetworkDescription],
    begin: float,
    fault: float | None,
) -> FrameReader:
    """Read all frames of a recording; `fault` is when it happened, in seconds from `begin`, None if nothing did."""
    reader = FrameReader(networks, begin, fault)
    for frame in frames:
        reader.read(*frame)
    return reader
