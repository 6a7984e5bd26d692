"""What recorded frames tell of a run: bus load, who spoke how much, the states of drives, and the last words.

The law of this file: frames are decoded by the one decoder, in the order they came. Times are seconds from `begin`
(Unix). A bus nobody described is read by the predefined connection set.
"""

from __future__ import annotations

from collections import Counter, deque
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from canopen_control.cia301.nmt import state_of_byte
from canopen_control.cia402 import objects
from canopen_control.cia402.state import decode_statusword
from canopen_control.frame import FRAME_BITS
from canopen_control.trace.decoder import DecodedFrame, Decoder, Mark
from canopen_control.trace.lines import identifier_text
from canopen_control.trace.network import NetworkDescription
from canopen_control.trace.report_samples import Spans

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.frame import CanFrame
    from canopen_control.trace.flight_file import FlightFrame

__all__ = ["FrameFacts", "read_frames"]

Json = dict[str, Any]
_NS: Final = 1_000_000_000
_BIN_S: Final = 0.5  # of the bus load
_BEFORE, _AFTER = 40, 15  # frames around the fault that are shown
_SILENT_S: Final = 0.5
_MOST_NOTABLE: Final = 1000
_LEVELS: Final = {Mark.NOTABLE: "info", Mark.WARNING: "warning", Mark.ERROR: "error"}


class _Heard(NamedTuple):
    """A decoded frame, its bus, and when it came."""

    bus: str
    time: float
    decoded: DecodedFrame


class FrameFacts:
    """Reads frames in order; then `buses`, `nodes`, `around`, `last_words` and `notable` have what they told."""

    def __init__(self, networks: Mapping[str, NetworkDescription], begin: float, fault: float | None) -> None:
        self._networks, self._begin, self._fault = networks, begin, fault
        self._decoders: dict[str, Decoder] = {}
        self._loads: dict[str, Counter[int]] = {}
        self._services: dict[str, Counter[str]] = {}
        self._spans: dict[tuple[str, int], Json] = {}
        self._same: dict[tuple[str, int], bytes] = {}
        self._before: deque[_Heard] = deque(maxlen=_BEFORE)
        self._after: list[_Heard] = []
        self._last: dict[tuple[str, int], _Heard] = {}
        self._heard: dict[tuple[str, int], float] = {}  # when each node spoke last
        self._end = 0.0
        self._told: set[tuple[int, str]] = set()
        self.notable: list[Json] = []  # frames that change or break something, as events of the API's shape

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
        node = self._spans.setdefault((bus, decoded.node_id), {"name": decoded.node, "nmt": Spans(), "axes": {}})
        if decoded.service == "hb":
            state = state_of_byte(decoded.data[0])
            node["nmt"].see(time, state.name if state is not None else None)
        elif self._same.get((bus, decoded.can_id)) != decoded.data:
            self._same[bus, decoded.can_id] = decoded.data
            for value in decoded.values:
                index, axis = objects.axis_of(value.index)
                if index == objects.STATUSWORD and isinstance(value.value, int):
                    drive_state = decode_statusword(value.value)
                    name = drive_state.name if drive_state is not None else None
                    node["axes"].setdefault(f"axis {axis}", Spans()).see(time, name)

    def _note(self, time_ns: int, decoded: DecodedFrame) -> None:
        """Take a frame for an event, a repeated one only once: a drive in fault says so in every statusword."""
        said = (decoded.can_id, decoded.text)
        if said in self._told:
            return
        self._told.add(said)
        node = decoded.who or None
        text = f"{node or 'bus'}: {decoded.subject or decoded.service} {decoded.text}".rstrip()
        event = {"time": time_ns / _NS, "kind": decoded.service, "node": node, "level": _LEVELS[decoded.mark]}
        self.notable.append({**event, "text": text})

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
    def around(self) -> list[Json]:
        """The last frames before the fault, or of all, and the first after it."""
        return [_line(each) for each in (*self._before, *self._after)]

    @property
    def last_words(self) -> list[Json]:
        """The last frame of each node before the fault, the longest silent first."""
        return [_line(each) for each in sorted(self._last.values(), key=lambda heard: heard.time)]

    def buses(self) -> dict[str, Json]:
        """Return {bus: {"frames", "services", "load": {"time", "value"}}}; the load is a share of the bit rate."""
        facts = {}
        for bus, bits in self._loads.items():
            bitrate = self._decoders[bus].network.bitrate
            bins = [each for each in range(min(bits), max(bits) + 1) if self._covered(each) > _BIN_S / 5]
            load = [bits[each] / self._covered(each) / bitrate for each in bins]
            times = [round((each + 0.5) * _BIN_S, 3) for each in bins]
            services = dict(self._services[bus].most_common())
            facts[bus] = {
                "frames": sum(services.values()),
                "services": services,
                "bitrate": bitrate,
                "load": {"time": times, "value": load},
            }
        return facts

    def _covered(self, number: int) -> float:
        """Return how many seconds of a bin the recording covers: the last one is rarely whole."""
        return min((number + 1) * _BIN_S, self._end) - max(number * _BIN_S, 0.0)

    def nodes(self) -> dict[str, Json]:
        """Return what `node_spans` returns, as the frames told it; a node that fell silent is in no known state."""
        facts: dict[str, Json] = {}
        for (bus, node_id), node in sorted(self._spans.items()):
            heard = self._heard.get((bus, node_id), self._end)
            nmt = self._ended(node["nmt"], heard)
            axes = {axis: self._ended(spans, heard) for axis, spans in node["axes"].items()}
            if nmt or axes:
                facts[node["name"] or f"node {node_id}"] = {"bus": bus, "node_id": node_id, "nmt": nmt, "axes": axes}
        return facts

    def _ended(self, spans: Spans, heard: float) -> list[Json]:
        if spans.spans and self._end - heard > _SILENT_S:
            spans.see(heard, None)
        return spans.end(self._end)


def _line(heard: _Heard) -> Json:
    bus, time, decoded = heard
    return {
        "time": round(time, 6),
        "bus": bus,
        "id": identifier_text(decoded.can_id),
        "data": decoded.data.hex(" ").upper(),
        "service": decoded.subject or decoded.service,
        "node": decoded.who,
        "node_id": decoded.node_id,
        "text": decoded.text,
        "mark": decoded.mark.name.lower(),
    }


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
) -> FrameFacts:
    """Read all frames of a recording; `fault` is when it happened, in seconds from `begin`, None if nothing did."""
    facts = FrameFacts(networks, begin, fault)
    for frame in frames:
        facts.read(*frame)
    return facts
