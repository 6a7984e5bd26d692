"""Facts of a report, computed from a flight recording, or from a recording of a running robot in memory.

`facts_of` computes everything in a report. If samples and frames both contain a state, the frame counts, because it is
immediate, whereas a sample is delayed by up to its period. Without recorded events, notable frames are used instead:
EMCY, aborts, faults, NMT.

`watch` records samples, events and frames for some seconds. It only listens; the caller limits the time, because all
data are kept in memory. A bus inside the robot's process is omitted and named in the result.
"""

from __future__ import annotations

import contextlib
import functools
import operator
import tempfile
from collections import Counter, deque
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.bus.channel import open_port, parse_channel
from canopen_control.bus.port_abilities import Arrivals
from canopen_control.cia301.nmt import state_of_byte
from canopen_control.cia402 import objects
from canopen_control.cia402.state import decode_statusword
from canopen_control.client.robot_client import RobotClient
from canopen_control.errors import BusError, CanopenError
from canopen_control.frame import FRAME_BITS, frames_of
from canopen_control.host.reactor import Reactor
from canopen_control.ros.sample_topics import measured_values
from canopen_control.rpc.messages.robot import GetLayout, GetStatus, Subscribe
from canopen_control.rpc.messages.state import CycleTimes, RobotEvent, StateSample
from canopen_control.trace.decoder import DecodedFrame, Decoder, Mark
from canopen_control.trace.flight_file import NO_FAULT, FlightFile, FlightMeta, is_fault
from canopen_control.trace.frame_lines import identifier_text
from canopen_control.trace.network_description import NetworkDescription, network_of_layout
from canopen_control.trace.report_facts import (
    BusFacts,
    BusLoad,
    CycleFacts,
    FrameFacts,
    Gaps,
    JointFacts,
    MeasuredFacts,
    NodeFacts,
    ReportFacts,
    Span,
    event_at,
    summary,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from canopen_control.bus.port import Port
    from canopen_control.frame import CanFrame
    from canopen_control.rpc.messages.state import Status, TimedSnapshot
    from canopen_control.trace.flight_file import FlightFrame
    from canopen_control.trace.report_facts import EventFacts

    Row = tuple[str, str, float | None]  # name, unit, value


# -- samples of the state stream: states of nodes, tracking of joints. A state lasts until a sample with another one.


_QUANTITIES: Final = {"PP": "position", "IP": "position", "CSP": "position", "TQ": "effort", "CST": "effort"}
_BEFORE_FAULT_S: Final = 1.0  # interval before a fault in which a joint counts as moving
_STANDING: Final = 1e-3  # speed in rad/s or m/s that counts as standstill
_STOOD_S: Final = 1.0
_SMALL: Final = 0.02  # fraction of the previous maximum speed that counts as standing


class Spans:
    """Builder of time spans, one for each state; `see` adds a sample."""

    def __init__(self) -> None:
        self._since: list[tuple[float, str | None]] = []  # times at which the state changed
        self._last = 0.0

    def __bool__(self) -> bool:
        return bool(self._since)

    def see(self, time: float, state: str | None) -> None:
        if not self._since or self._since[-1][1] != state:
            self._since.append((time, state))
        self._last = time

    def end(self, time: float) -> list[Span]:
        """Return the spans; the last one ends at `time`."""
        ends = [*(begin for begin, _ in self._since), max(time, self._last)][1:]
        return [Span(begin, end, state) for (begin, state), end in zip(self._since, ends, strict=True)]


def node_spans(states: Sequence[TimedSnapshot], begin: float) -> dict[str, NodeFacts]:
    """Return the NMT states of the nodes, and the states of their axes by joint; times are relative to `begin`."""
    nmt: dict[str, Spans] = {}
    axes: dict[str, dict[str, Spans]] = {}
    first: dict[str, tuple[str, int]] = {}
    for sample in states:
        time = sample.time - begin
        for name, node in sample.nodes.items():
            first.setdefault(name, (node.bus, node.node_id))
            nmt.setdefault(name, Spans()).see(time, node.nmt_state)
            for axis in node.axes:
                axes.setdefault(name, {}).setdefault(axis.joint, Spans()).see(time, axis.state)
    end = states[-1].time - begin if states else 0.0
    return {
        name: NodeFacts(
            *place, nmt[name].end(end), {joint: spans.end(end) for joint, spans in axes.get(name, {}).items()}
        )
        for name, place in first.items()
    }


def joints_of(states: Sequence[TimedSnapshot], begin: float) -> dict[str, JointFacts]:
    """Return the motion of the joints; the drive's mode determines the commanded quantity, velocity by default."""
    modes = _modes(states)
    tracked = {name: joint.tracking for sample in states for name, joint in sample.joints.items() if joint.tracking}
    joints: dict[str, JointFacts] = {}
    for sample in states:
        for name, values in sample.joints.items():
            if name not in joints:
                quantity = _QUANTITIES.get(modes.get(name, ""), "velocity")
                joints[name] = JointFacts(quantity, [], [], [], [], [], [], [], tracked.get(name))
            joint = joints[name]
            actual, command = values.value(joint.quantity), values.command
            joint.time.append(round(sample.time - begin, 4))
            joint.command.append(command)
            joint.actual.append(actual)
            joint.error.append(None if actual is None or command is None else command - actual)
            joint.position.append(values.position)
            joint.velocity.append(values.velocity)
            joint.effort.append(values.effort)
    return joints


def _modes(states: Iterable[TimedSnapshot]) -> dict[str, str]:
    modes = {}
    for sample in states:
        for node in sample.nodes.values():
            modes.update({axis.joint: axis.mode for axis in node.axes if axis.mode})
    return modes


def cycle_of(states: Sequence[TimedSnapshot], status: Status | None) -> CycleFacts | None:
    """Return the cycle period, the cycle counts, the maximum lateness and work time, and a histogram of the lateness.

    Return None without data. The counts cover the time of the samples, or the whole run if there are fewer than two;
    the maxima are those of the whole run. The bins are those of `status --json`.
    """
    last = states[-1].cycle if states else None if status is None else status.cycle
    if last is None or last == CycleTimes():
        return None
    first = states[0].cycle if len(states) > 1 else CycleTimes()
    before = [*first.late_counts, *([0] * len(last.late_counts))]
    return CycleFacts(
        period_s=last.period_s,
        count=last.count - first.count,
        missed=last.missed - first.missed,
        late_max_s=last.late_max_s,
        work_max_s=last.work_max_s,
        late_edges_s=[] if status is None else status.late_edges_s,
        late_counts=[max(0, count - earlier) for count, earlier in zip(last.late_counts, before, strict=False)],
    )


def stopped_after(joints: Mapping[str, JointFacts], time: float) -> dict[str, float | None]:
    """Return, for each joint that moves at `time`, the time in s until it is at rest; None if it never is.

    A joint has stopped if it stands for `_STOOD_S` or to the end of the recording; later motion is ignored.
    """
    stopped: dict[str, float | None] = {}
    for name, joint in joints.items():
        pairs = zip(joint.time, joint.velocity, strict=True)
        moves = [(at, abs(value)) for at, value in pairs if value is not None]
        fastest = max((speed for at, speed in moves if time - _BEFORE_FAULT_S <= at <= time), default=0.0)
        if fastest < _STANDING:
            continue
        since = _standstill_since([(at, speed) for at, speed in moves if at >= time], _SMALL * fastest)
        stopped[name] = None if since is None else round(since - time, 3)
    return stopped


def _standstill_since(moves: Sequence[tuple[float, float]], small: float) -> float | None:
    since: float | None = None
    for at, speed in moves:
        if speed > small:
            since = None
        elif since is None:
            since = at
        elif at - since > _STOOD_S:
            break
    return since


# -- recorded frames: bus load, traffic of nodes, states of drives, last frames. Frames are decoded in their order.
# Times are in s from `begin` (Unix). A bus without a description is decoded by the predefined connection set.


_NS: Final = 1_000_000_000
_BIN_S: Final = 0.5  # bin width of the bus load
_MAX_BINS: Final = 20_000  # number of bins in three hours
_BEFORE, _AFTER = 40, 15  # number of frames shown before and after the fault
_SILENT_S: Final = 0.5
_MAX_NOTABLE: Final = 1000
_LEVELS: Final = {Mark.NOTABLE: "info", Mark.WARNING: "warning", Mark.ERROR: "error"}


class _Decoded(NamedTuple):
    """Decoded frame with its bus, and its time in s."""

    bus: str
    time: float
    decoded: DecodedFrame


class _Drive(NamedTuple):
    """Node on a bus: the time spans of its NMT states, and those of the states of its axes by axis number."""

    name: str
    nmt: Spans
    axes: dict[int, Spans]


class FrameReader:
    """Evaluator of frames in order: bus loads, node states, frames around the fault, and notable events."""

    def __init__(self, networks: Mapping[str, NetworkDescription], begin: float, fault: float | None) -> None:
        self._networks, self._begin, self._fault = networks, begin, fault
        self._decoders: dict[str, Decoder] = {}
        self._loads: dict[str, Counter[int]] = {}
        self._services: dict[str, Counter[str]] = {}
        self._drives: dict[tuple[str, int], _Drive] = {}
        self._same: dict[tuple[str, int], bytes] = {}
        self._before: deque[_Decoded] = deque(maxlen=_BEFORE)
        self._after: list[_Decoded] = []
        self._last: dict[tuple[str, int], _Decoded] = {}
        self._last_times: dict[tuple[str, int], float] = {}  # time of the last frame of each node
        self._end = 0.0
        self._reported: set[tuple[int, str]] = set()
        self.notable: list[RobotEvent] = []  # frames that report a change or an error

    def read(self, time_ns: int, bus: str, frame: CanFrame) -> None:
        """Evaluate the next frame, whose time is in Unix ns."""
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
        if decoded.mark is not Mark.PLAIN and len(self.notable) < _MAX_NOTABLE:
            self._note(time_ns, decoded)

    def _follow(self, bus: str, time: float, decoded: DecodedFrame) -> None:
        """Record the states of a node from heartbeats, and from PDOs whose data has changed."""
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
        """Record a frame as an event; a repeated frame, such as a fault in every statusword, counts once."""
        note_key = (decoded.can_id, decoded.text)
        if note_key in self._reported:
            return
        self._reported.add(note_key)
        node = decoded.node_label or None
        text = f"{node or 'bus'}: {decoded.subject or decoded.service} {decoded.text}".rstrip()
        level = _LEVELS[decoded.mark]
        event = RobotEvent(
            time=time_ns / _NS, kind=decoded.service, node=node, level=level, text=text, details=decoded.fault
        )
        self.notable.append(event)

    def _remember(self, bus: str, time: float, decoded: DecodedFrame) -> None:
        decoded_frame = _Decoded(bus, time, decoded)
        if decoded.node_id is not None and _from_node(decoded):
            self._last_times[bus, decoded.node_id] = time
        if self._fault is None or time <= self._fault:
            self._before.append(decoded_frame)
            if decoded.node_id is not None and _from_node(decoded):
                self._last[bus, decoded.node_id] = decoded_frame
        elif len(self._after) < _AFTER:
            self._after.append(decoded_frame)

    @property
    def around(self) -> list[FrameFacts]:
        """Last frames up to the fault (or to the end without a fault), and the first frames after it."""
        return [_line(frame) for frame in (*self._before, *self._after)]

    @property
    def last_words(self) -> list[FrameFacts]:
        """Last frame of each node up to the fault (or to the end without a fault), longest silence first."""
        return [_line(frame) for frame in sorted(self._last.values(), key=lambda last: last.time)]

    def buses(self) -> dict[str, BusFacts]:
        """Return the traffic and the load of each bus."""
        facts = {}
        for bus, counted in self._loads.items():
            bitrate = self._decoders[bus].network.bitrate
            bits, width = _coarse(counted)
            bins = [
                bin_number
                for bin_number in range(min(bits), max(bits) + 1)
                if self._covered(bin_number, width) > width / 5
            ]
            load = [bits[bin_number] / self._covered(bin_number, width) / bitrate for bin_number in bins]
            times = [round((bin_number + 0.5) * width, 3) for bin_number in bins]
            services = dict(self._services[bus].most_common())
            facts[bus] = BusFacts(sum(services.values()), services, bitrate, BusLoad(times, load))
        return facts

    def _covered(self, number: int, width: float) -> float:
        """Return the length in s of the recorded part of a time bin; the last bin is rarely complete."""
        return min((number + 1) * width, self._end) - max(number * width, 0.0)

    def nodes(self) -> dict[str, NodeFacts]:
        """Return the node states; axes are named "axis N", and the state is None after a node became silent."""
        facts: dict[str, NodeFacts] = {}
        for (bus, node_id), drive in sorted(self._drives.items()):
            last_time = self._last_times.get((bus, node_id), self._end)
            nmt = self._ended(drive.nmt, last_time)
            axes = {f"axis {axis}": self._ended(spans, last_time) for axis, spans in drive.axes.items()}
            if nmt or axes:
                facts[drive.name or f"node {node_id}"] = NodeFacts(bus, node_id, nmt, axes)
        return facts

    def _ended(self, spans: Spans, last_time: float) -> list[Span]:
        if spans and self._end - last_time > _SILENT_S:
            spans.see(last_time, None)
        return spans.end(self._end)


def _coarse(bits: Counter[int]) -> tuple[Counter[int], float]:
    """Return the bits by bin, and the bin width in s, which is larger if the times are days apart."""
    many = 1 + (max(bits) - min(bits)) // _MAX_BINS
    coarse: Counter[int] = Counter()
    for number, count in bits.items():
        coarse[number // many] += count
    return coarse, many * _BIN_S


def _line(frame: _Decoded) -> FrameFacts:
    bus, time, decoded = frame
    return FrameFacts(
        time=round(time, 6),
        bus=bus,
        id=identifier_text(decoded.can_id),
        data=decoded.data.hex(" ").upper(),
        service=decoded.subject or decoded.service,
        node=decoded.node_label,
        node_id=decoded.node_id,
        text=decoded.text,
        mark=decoded.mark.name.lower(),
    )


def _from_node(decoded: DecodedFrame) -> bool:
    """Whether the node itself sent the frame, judged by service and direction."""
    if decoded.service == "pdo":
        return decoded.subject.startswith("TPDO")
    return decoded.service in ("hb", "emcy") or decoded.subject == "SDO response"


def read_frames(
    frames: Sequence[FlightFrame],
    networks: Mapping[str, NetworkDescription],
    begin: float,
    fault: float | None,
) -> FrameReader:
    """Evaluate all frames in order; `fault` is the time of the fault in s from `begin`, or None."""
    reader = FrameReader(networks, begin, fault)
    for frame in frames:
        reader.read(*frame)
    return reader


# -- measured values of sensors, batteries, inputs, outputs and grippers: minimum, maximum and last. A value is named
# after its interface or field; unknown values are ignored, and a value that was never known has no entry.


def measured(states: Iterable[TimedSnapshot]) -> list[MeasuredFacts]:
    """Return the minimum, maximum and last value of each measured quantity that was ever known."""
    last_times: dict[str, float] = {}
    facts: dict[tuple[str, str], MeasuredFacts] = {}
    for state in states:
        for name, sample in state.samples.items() if isinstance(state, StateSample) else ():
            if last_times.get(name) == sample.time:
                continue
            last_times[name] = sample.time
            for quantity, unit, value in measured_values(sample):
                if value is not None:
                    previous = facts.get((name, quantity))
                    facts[name, quantity] = _extended(
                        MeasuredFacts(name, quantity, unit, value, value, value), previous
                    )
    return list(facts.values())


def _extended(now: MeasuredFacts, before: MeasuredFacts | None) -> MeasuredFacts:
    if before is None:
        return now
    least, most = min(before.least, now.last), max(before.most, now.last)
    return MeasuredFacts(now.controller, now.what, now.unit, least, most, now.last)


def networks_of(file: FlightFile) -> dict[str, NetworkDescription]:
    """Return the descriptions of the buses in a recording, from its layout and its EDS files."""
    with tempfile.TemporaryDirectory() as folder:
        paths = {name: Path(folder) / Path(name).name for name in file.eds}
        for name, text in file.eds.items():
            paths[name].write_bytes(text)
        return {bus: network_of_layout(layout, paths) for bus, layout in file.meta.layout.buses.items()}


def facts_of(file: FlightFile, networks: Mapping[str, NetworkDescription] | None = None) -> ReportFacts:
    """Compute all facts of a recording; `networks`, by bus, default to the descriptions in the recording."""
    networks = networks_of(file) if networks is None else networks
    meta, states, status = file.meta, file.states, file.meta.status
    begin, end = _bounds(file)
    notable = file.events or read_frames(file.frames, networks, begin, None).notable
    events = [event_at(event, begin) for event in notable]
    fault = _first_fault(events, event_at(meta.reason, begin))
    frames = read_frames(file.frames, networks, begin, None if fault is None else fault.at)
    joints = joints_of(states, begin)
    facts = ReportFacts(
        summary=[],
        robot=meta.robot,
        begin=begin,
        end=end,
        seconds=end - begin,
        channels=meta.buses,
        fault=fault,
        events=events,
        nodes=_merged(node_spans(states, begin), frames.nodes(), states),
        joints=joints,
        stopped_after_s={} if fault is None else stopped_after(joints, fault.at),
        last_state=states[-1].state if states else "",
        cycle=cycle_of(states, status),
        boot=[] if status is None else status.boot,
        sdo={} if status is None else {name: node.sdo for name, node in status.nodes.items()},
        buses=frames.buses(),
        frames=frames.around,
        last_words=frames.last_words,
        gaps=_gaps(file, networks),
        measured=tuple(measured(states)),
        true_pose=states[-1].true_pose if states else None,
    )
    facts.summary.extend(summary(facts))
    return facts


def _bounds(file: FlightFile) -> tuple[float, float]:
    """Return the first and last Unix time in s of frames and samples; without both, those of the events."""
    times = [time_ns / 1e9 for time_ns, _, _ in file.frames[:1] + file.frames[-1:]]
    times += [sample.time for sample in file.states[:1] + file.states[-1:]]
    times = times or [event.time for event in file.events] or [file.meta.written]
    return min(times), max(times)


def _first_fault(events: Sequence[EventFacts], reason: EventFacts) -> EventFacts | None:
    """Return the first fault in the window, or the reason for the file if it is a fault, or None."""
    inside = (event for event in events if event.at >= 0)
    return next((event for event in (*inside, reason) if is_fault(event)), None)


def _merged(
    sampled: dict[str, NodeFacts], received: dict[str, NodeFacts], states: Sequence[TimedSnapshot]
) -> dict[str, NodeFacts]:
    """Merge node states from samples and frames; axis states in frames take precedence."""
    if not sampled:
        return received
    axes = {(node.bus, node.node_id): node.axes for node in received.values()}
    for name, last in states[-1].nodes.items():
        node = sampled[name]
        for axis in last.axes:
            spans = axes.get((node.bus, node.node_id), {}).get(f"axis {axis.axis}")
            if spans:
                node.axes[axis.joint] = spans
    return sampled


def _gaps(file: FlightFile, networks: Mapping[str, NetworkDescription]) -> Gaps:
    meta = file.meta
    notes = (*file.notes, *(note for network in networks.values() for note in network.notes))
    return Gaps(meta.unheard, meta.frames_lost, file.unread_lines, meta.faults_left_out, notes)


RATE: Final = 50.0  # sampling rate of a recording in Hz


def watch(name: str | None, seconds: float) -> FlightFile:
    """Record the robot `name` (None: the only running robot) until `seconds` elapse or the robot ends.

    Raise ConfigError if there is no such robot.
    """
    with RobotClient.connect(name) as robot, Reactor() as reactor:
        layout, status = robot.ask(GetLayout()), robot.ask(GetStatus())
        channels = {bus: bus_layout.channel for bus, bus_layout in layout.buses.items()}
        file = FlightFile(FlightMeta(robot=robot.robot, reason=NO_FAULT), events=list(status.events))
        ports = _listen(reactor, channels, file)
        robot.ask(Subscribe(state_rate=RATE, events=True))
        reactor.add_reader(robot.fileno(), lambda: _read(reactor, robot, file))
        reactor.call_later(round(seconds * _NS), reactor.stop)
        reactor.run()
        with contextlib.suppress(CanopenError):
            status = robot.ask(GetStatus())
        file.meta = FlightMeta(
            robot=robot.robot,
            reason=NO_FAULT,
            buses=channels,
            unheard=tuple(bus for bus in channels if bus not in ports),
            frames_lost=sum(port.stats.lost for port in ports.values()),
            layout=layout,
            status=status,
        )
        for port in ports.values():
            port.close()
    file.frames.sort(key=operator.itemgetter(0))  # several buses are read one after the other
    return file


def _read(reactor: Reactor, robot: RobotClient, file: FlightFile) -> None:
    try:
        for message in robot.messages(0):
            if isinstance(message, StateSample):
                file.states.append(message)
            elif isinstance(message, RobotEvent) and message not in file.events:
                file.events.append(message)
    except CanopenError:  # the robot has ended
        reactor.remove_reader(robot.fileno())
        reactor.stop()


def _listen(reactor: Reactor, channels: dict[str, str], file: FlightFile) -> dict[str, Port]:
    ports: dict[str, Port] = {}
    for bus, channel in channels.items():
        if not parse_channel(channel).kind.shared:
            continue
        ports[bus] = port = open_port(channel, label="report", join=True)
        reactor.add_reader(port.fileno(), functools.partial(_receive, reactor, file, bus, Arrivals(port)))
    return ports


def _receive(reactor: Reactor, file: FlightFile, bus: str, arrivals: Arrivals) -> None:
    try:
        records, stamps = arrivals.receive()
    except BusError:
        reactor.remove_reader(arrivals.port.fileno())
        return
    offset = arrivals.unix_offset_ns
    file.frames.extend((at + offset, bus, frame) for at, frame in zip(stamps, frames_of(records), strict=True))
