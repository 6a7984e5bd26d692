"""A report of a run or a recording: its facts, made of what a flight recorder, or a listener, has kept.

The law of this file: `facts_of` is all that a report says. Where samples and frames both tell a state, the
frame does: it is there at once, a sample only at the next of its rate. Where nobody told events, the frames that are
remarkable stand for them: EMCY, aborts, faults, NMT.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.trace.flight_trigger import is_fault
from canopen_control.trace.network_description import network_of_layout
from canopen_control.trace.report_facts import Gaps, ReportFacts, event_at
from canopen_control.trace.report_frames import read_frames
from canopen_control.trace.report_samples import cycle_of, joints_of, node_spans, stopped_after
from canopen_control.trace.report_sensors import measured
from canopen_control.trace.report_words import summary

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.rpc.messages.state import TimedSnapshot
    from canopen_control.trace.flight_file import FlightFile
    from canopen_control.trace.network_description import NetworkDescription
    from canopen_control.trace.report_facts import EventFacts, NodeFacts

__all__ = ["facts_of", "networks_of"]


def networks_of(file: FlightFile) -> dict[str, NetworkDescription]:
    """Describe the buses of a recording by the layout and the EDS files that are in it."""
    with tempfile.TemporaryDirectory() as folder:
        kept = {name: Path(folder) / Path(name).name for name in file.eds}
        for name, text in file.eds.items():
            kept[name].write_bytes(text)
        return {bus: network_of_layout(layout, kept) for bus, layout in file.meta.layout.buses.items()}


def facts_of(file: FlightFile, networks: Mapping[str, NetworkDescription] | None = None) -> ReportFacts:
    """Return everything a report says of a recording; `networks` {bus: description} default to those in it."""
    networks = networks_of(file) if networks is None else networks
    meta, states, status = file.meta, file.states, file.meta.status
    begin, end = _bounds(file)
    told = file.events or read_frames(file.frames, networks, begin, None).notable
    events = [event_at(event, begin) for event in told]
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
    )
    facts.summary.extend(summary(facts))
    return facts


def _bounds(file: FlightFile) -> tuple[float, float]:
    """Return first and last moment, Unix seconds, of what was recorded continuously; events may be older."""
    times = [time_ns / 1e9 for time_ns, _, _ in file.frames[:1] + file.frames[-1:]]
    times += [sample.time for sample in file.states[:1] + file.states[-1:]]
    times = times or [event.time for event in file.events] or [file.meta.written]
    return min(times), max(times)


def _first_fault(events: Sequence[EventFacts], reason: EventFacts) -> EventFacts | None:
    """Return the first fault of the window; the reason of the file where the window holds none."""
    inside = (event for event in events if event.at >= 0)
    return next((event for event in (*inside, reason) if is_fault(event)), None)


def _merged(
    sampled: dict[str, NodeFacts], heard: dict[str, NodeFacts], states: Sequence[TimedSnapshot]
) -> dict[str, NodeFacts]:
    """Return the nodes' states; those of the axes as the frames tell them, where they do."""
    if not sampled:
        return heard
    told = {(node.bus, node.node_id): node.axes for node in heard.values()}
    for name, last in states[-1].nodes.items():
        node = sampled[name]
        for axis in last.axes:
            spans = told.get((node.bus, node.node_id), {}).get(f"axis {axis.axis}")
            if spans:
                node.axes[axis.joint] = spans
    return sampled


def _gaps(file: FlightFile, networks: Mapping[str, NetworkDescription]) -> Gaps:
    meta = file.meta
    notes = (*file.notes, *(note for network in networks.values() for note in network.notes))
    return Gaps(meta.unheard, meta.frames_lost, file.unread_lines, meta.faults_left_out, notes)
