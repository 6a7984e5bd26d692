"""Facts of a report, as printed by `report --json` and shown by the report page.

Times are in s from `begin` (Unix); values are in SI units, None if unknown.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, TypeAlias

from canopen_control.rpc.messages.declare import Document
from canopen_control.rpc.messages.state import UNITS, BootStep, RobotEvent, SdoCounts, TrackingReading, TruePose

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping


_MAX = 4  # maximum number of further faults in the summary


def clock(unix_s: float, *, date: bool = False) -> str:
    """Return the local time of day with milliseconds, optionally with the date."""
    text = time.strftime("%Y-%m-%d %H:%M:%S" if date else "%H:%M:%S", time.localtime(unix_s))
    return f"{text}.{int(unix_s * 1000) % 1000:03d}"


def summary(facts: ReportFacts) -> list[str]:
    """Return the sentences of the summary: robot and time, first fault, consequences, timing, and missing data."""
    how = (*_cycle(facts), *_tracking(facts), *_true_pose(facts))
    return [*_drive_names(facts), *_wrong(facts), *_reaction(facts), *how, *_gaps(facts)]


def _drive_names(facts: ReportFacts) -> Iterator[str]:
    titles = {name: f"node {node.node_id}" for name, node in facts.nodes.items()}  # also the name of an unknown node
    drives = ", ".join(name if name == title else f"{name} ({title})" for name, title in titles.items())
    channels = ", ".join(f"{name} ({channel})" for name, channel in facts.channels.items())
    channels_text = f" on {channels}" if channels else ""
    yield (
        f"{facts.robot or 'A recording'}: {facts.seconds:.1f} s up to {clock(facts.end, date=True)}"
        f"{channels_text}; {drives or _no_drives(facts)}."
    )


def _no_drives(facts: ReportFacts) -> str:
    joints = ", ".join(facts.joints)
    return f"no bus, simulated hardware: {joints}" if joints and not facts.channels else "no node was seen"


def _wrong(facts: ReportFacts) -> Iterator[str]:
    errors = [event for event in facts.events if event.level == "error" and event.at >= 0]
    first = facts.fault
    if first is None:
        yield "No error was reported in this time."
        return
    yield f"First error, {first.at:.3f} s after the beginning ({clock(first.time)}): {_sentence(first.text)}"
    later = [event for event in errors if event.time >= first.time and event.text != first.text]
    for event in later[:_MAX]:
        yield f"{1e3 * (event.time - first.time):.0f} ms later: {_sentence(event.text)}"
    if len(later) > _MAX:
        count = len(later) - _MAX
        words = "1 more error followed; it is" if count == 1 else f"{count} more errors followed; they are"
        yield f"{words} in the list of events."


def _reaction(facts: ReportFacts) -> Iterator[str]:
    for joint, seconds in facts.stopped_after_s.items():
        yield f"{joint} {'did not stop in the recording' if seconds is None else f'stopped {seconds:.2f} s later'}."
    if facts.last_state:
        yield f"At the end the robot was in state {facts.last_state}."


def _cycle(facts: ReportFacts) -> Iterator[str]:
    cycle = facts.cycle
    if cycle is None or not cycle.count:
        return
    share = f", {cycle.missed} missed" if cycle.missed else ", none missed"
    yield (
        f"{cycle.count} cycles of {1e3 * cycle.period_s:g} ms{share}; "
        f"the largest delay was {1e3 * cycle.late_max_s:.2f} ms."
    )


def _tracking(facts: ReportFacts) -> Iterator[str]:
    """Yield sentences about the joints with the largest position and velocity errors, and about set-points."""
    trackings = {name: joint.tracking for name, joint in facts.joints.items() if joint.tracking is not None}
    for interface in ("position", "velocity"):
        errors = {name: tracking for name, tracking in trackings.items() if tracking.interface == interface}
        if errors:
            name = max(errors, key=lambda tracking: errors[tracking].error_max_since_enable)
            worst, rms = errors[name].error_max_since_enable, errors[name].error_rms_since_enable
            yield f"Largest {interface} tracking error: {name}, {worst:.2g} {UNITS[interface][0]}, RMS {rms:.2g}."
    odd = [
        f"{name} {tracking.repeated} and {tracking.skipped}"
        for name, tracking in trackings.items()
        if tracking.repeated or tracking.skipped
    ]
    if odd:
        yield f"Set-points that were repeated, and skipped, while a joint moved: {', '.join(odd)}."


def _true_pose(facts: ReportFacts) -> Iterator[str]:
    """Yield a sentence about the final true pose of a simulated base and its odometry error."""
    if facts.true_pose is not None:
        yield _sentence(f"At the end: {facts.true_pose.words}")


def _gaps(facts: ReportFacts) -> Iterator[str]:
    """Yield sentences about missing data, so that its absence is not mistaken for normal operation."""
    gaps = facts.gaps
    if gaps.unheard:
        yield f"Not recorded: the frames of {', '.join(gaps.unheard)}."
    if gaps.frames_lost:
        yield f"{gaps.frames_lost} frames were lost because they arrived too fast."
    if gaps.unread_lines:
        yield f"{gaps.unread_lines} lines of the log could not be read."
    if gaps.faults_left_out:
        yield f"{gaps.faults_left_out} earlier faults of this run have no file of their own."
    yield from (_sentence(note) for note in gaps.notes)


def _sentence(text: str) -> str:
    text = " ".join(text.split())
    return text if text.endswith((".", "?", "!")) else f"{text}."


Column: TypeAlias = list[float | None]


class Span(Document, frozen=True, rename={"begin": "from", "end": "to"}):
    """Time span in which a node or an axis is in one state; `state` is None if unknown."""

    begin: float
    end: float
    state: str | None


class NodeFacts(Document, frozen=True):
    """NMT states of a node, and CiA 402 states of its axes by joint."""

    bus: str
    node_id: int
    nmt: list[Span]
    axes: dict[str, list[Span]]


class JointFacts(Document, frozen=True):
    """Motion of a joint over `time`; `error` is the command minus the actual value of `quantity`.

    `tracking` is the last tracking quality measured by the master, or None if the joint was not commanded.
    """

    quantity: str
    time: list[float]
    command: Column
    actual: Column
    error: Column
    position: Column
    velocity: Column
    effort: Column
    tracking: TrackingReading | None = None


class CycleFacts(Document, frozen=True, kw_only=True):
    """Timing of the cycle; `late_counts[i]` cycles were at most `late_edges_s[i]` late.

    The last of `late_counts` is the number of cycles that were later than all edges.
    """

    period_s: float
    count: int
    missed: int
    late_max_s: float
    work_max_s: float
    late_edges_s: list[float]
    late_counts: list[int]


class EventFacts(RobotEvent, frozen=True, kw_only=True, omit_defaults=True):
    """Event with its time in the recording."""

    at: float


class FrameFacts(Document, frozen=True, kw_only=True):
    """Frame in a report; `id` and `data` are hexadecimal, `mark` is the importance of the frame."""

    time: float
    bus: str
    id: str
    data: str
    service: str
    node: str
    node_id: int | None
    text: str
    mark: str


class BusLoad(Document, frozen=True):
    """Bus load as fractions; the times are the centres of the time bins."""

    time: list[float]
    value: list[float]


class BusFacts(Document, frozen=True):
    """Traffic of a bus: numbers of frames, in total and by service, and the load; `bitrate` is in bit/s."""

    frames: int
    services: dict[str, int]
    bitrate: int
    load: BusLoad


class MeasuredFacts(Document, frozen=True):
    """Minimum, maximum and last value of a quantity that a controller measured during the recording."""

    controller: str
    what: str
    unit: str
    least: float
    most: float
    last: float


class Gaps(Document, frozen=True):
    """Missing parts of a recording."""

    unheard: tuple[str, ...] = ()
    frames_lost: int = 0
    unread_lines: int = 0
    faults_left_out: int = 0
    notes: tuple[str, ...] = ()


class ReportFacts(Document, frozen=True, kw_only=True):
    """All facts of a report.

    `summary` consists of sentences. `stopped_after_s` has the joints that moved at the time of the fault, None for a
    joint whose stop is unknown. `true_pose` is the last true pose of a simulated base.
    """

    summary: list[str]
    robot: str
    begin: float
    end: float
    seconds: float
    channels: dict[str, str]
    fault: EventFacts | None
    events: list[EventFacts]
    nodes: dict[str, NodeFacts]
    joints: dict[str, JointFacts]
    stopped_after_s: dict[str, float | None]
    last_state: str
    cycle: CycleFacts | None
    boot: list[BootStep]
    sdo: dict[str, SdoCounts]
    buses: dict[str, BusFacts]
    frames: list[FrameFacts]
    last_words: list[FrameFacts]
    gaps: Gaps
    measured: tuple[MeasuredFacts, ...] = ()
    true_pose: TruePose | None = None

    @property
    def fault_at(self) -> float | None:
        """Time of the fault in the recording, or None."""
        return None if self.fault is None else self.fault.at


def event_at(event: RobotEvent, begin: float) -> EventFacts:
    """Return an event together with its time in s relative to `begin`."""
    fields: Mapping[str, object] = {name: getattr(event, name) for name in event.__struct_fields__}
    return EventFacts(at=round(event.time - begin, 6), **fields)  # type: ignore[arg-type] # its own fields
