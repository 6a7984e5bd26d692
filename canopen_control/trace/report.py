"""A report of a run or a recording: its facts as plain data, made of what a flight recorder, or a listener, has kept.

The law of this file: `facts_of` is all that a report says; the page only shows it, and `--json` prints it. Times `at`
and in series are seconds from `begin` (Unix), values are SI units. Where samples and frames both tell a state, the
frame does: it is there at once, a sample only at the next of its rate. Where nobody told events, the frames that are
remarkable stand for them: EMCY, aborts, faults, NMT.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from canopen_control.trace.flight_trigger import is_fault
from canopen_control.trace.network import network_of_layout
from canopen_control.trace.report_frames import read_frames
from canopen_control.trace.report_samples import cycle_of, joints_of, node_spans, stopped_after
from canopen_control.trace.report_words import summary

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.trace.flight_file import FlightFile
    from canopen_control.trace.network import NetworkDescription

__all__ = ["facts_of", "networks_of"]

Json = dict[str, Any]


def networks_of(file: FlightFile) -> dict[str, NetworkDescription]:
    """Describe the buses of a recording by the layout and the EDS files that are in it."""
    buses = file.meta.get("layout", {}).get("buses", {})
    with tempfile.TemporaryDirectory() as folder:
        for name, text in file.eds.items():
            (Path(folder) / Path(name).name).write_bytes(text)
        return {bus: network_of_layout(_with_eds(layout, Path(folder), file)) for bus, layout in buses.items()}


def _with_eds(layout: Json, folder: Path, file: FlightFile) -> Json:
    """Point a layout to the EDS files of the recording, where it has them; a robot that runs here has its own."""
    nodes = []
    for node in layout["nodes"]:
        name = Path(node.get("eds") or "").name
        nodes.append({**node, "eds": str(folder / name)} if name in file.eds else node)
    return {**layout, "nodes": nodes}


def facts_of(file: FlightFile, networks: Mapping[str, NetworkDescription] | None = None) -> Json:
    """Return everything a report says of a recording; `networks` {bus: description} default to those in it."""
    networks = networks_of(file) if networks is None else networks
    meta, states = file.meta, file.states
    begin, end = _bounds(file)
    told = file.events or read_frames(file.frames, networks, begin, None).notable
    events = [{**event, "at": round(event["time"] - begin, 6)} for event in told]
    fault = _first_fault(events, meta.get("reason"), begin)
    frames = read_frames(file.frames, networks, begin, None if fault is None else fault["at"])
    joints, status = joints_of(states, begin), meta.get("status") or {}
    facts = {
        "robot": meta.get("robot", ""),
        "begin": begin,
        "end": end,
        "seconds": end - begin,
        "channels": meta.get("buses", {}),
        "fault": fault,
        "events": events,
        "nodes": _merged(node_spans(states, begin), frames.nodes(), states),
        "joints": joints,
        "stopped_after_s": {} if fault is None else stopped_after(joints, fault["at"]),
        "last_state": states[-1]["state"] if states else "",
        "cycle": cycle_of(states, status),
        "boot": status.get("boot", []),
        "sdo": {name: node.get("sdo", {}) for name, node in status.get("nodes", {}).items()},
        "buses": frames.buses(),
        "frames": frames.around,
        "last_words": frames.last_words,
        "gaps": _gaps(meta, networks),
    }
    return {"summary": summary(facts), **facts}


def _bounds(file: FlightFile) -> tuple[float, float]:
    """Return first and last moment, Unix seconds, of what was recorded continuously; events may be older."""
    times = [time_ns / 1e9 for time_ns, _, _ in file.frames[:1] + file.frames[-1:]]
    times += [sample["time"] for sample in file.states[:1] + file.states[-1:]]
    times = times or [event["time"] for event in file.events] or [file.meta.get("written", 0.0)]
    return min(times), max(times)


def _first_fault(events: list[Json], reason: Json | None, begin: float) -> Json | None:
    """Return the first fault of the window; the reason of the file where the window holds none."""
    found = next((event for event in events if event["at"] >= 0 and is_fault(event)), None)
    if found is None and reason is not None and is_fault(reason):
        return {**reason, "at": round(reason["time"] - begin, 6)}
    return found


def _merged(sampled: Json, heard: Json, states: list[Json]) -> Json:
    """Return the nodes' states; those of the axes as the frames tell them, where they do."""
    if not sampled:
        return heard
    by_id = {(node["bus"], node["node_id"]): node for node in heard.values()}
    axes = {name: node["axes"] for name, node in states[-1]["nodes"].items()} if states else {}
    for name, node in sampled.items():
        told = by_id.get((node["bus"], node["node_id"]), {}).get("axes", {})
        for axis in axes.get(name, ()):
            spans = told.get(f"axis {axis.get('axis', 0)}")
            if spans:
                node["axes"][axis["joint"]] = spans
    return sampled


def _gaps(meta: Json, networks: Mapping[str, NetworkDescription]) -> Json:
    return {
        "unheard": meta.get("unheard", []),
        "frames_lost": meta.get("frames_lost", 0),
        "unread_lines": meta.get("unread_lines", 0),
        "faults_left_out": meta.get("faults_left_out", 0),
        "notes": [*meta.get("notes", ()), *(note for network in networks.values() for note in network.notes)],
    }
