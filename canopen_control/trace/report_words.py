"""The first lines of a report: what a person would say who had looked at everything else."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.trace.report_facts import ReportFacts


_MOST = 4  # further faults that are listed


def clock(unix_s: float, *, date: bool = False) -> str:
    """Return a time of day where the reader is, with milliseconds."""
    text = time.strftime("%Y-%m-%d %H:%M:%S" if date else "%H:%M:%S", time.localtime(unix_s))
    return f"{text}.{int(unix_s * 1000) % 1000:03d}"


def summary(facts: ReportFacts) -> list[str]:
    """Return the sentences: who and when, what went wrong first, what followed, how it ended, what is not known."""
    how = (*_cycle(facts), *_tracking(facts), *_truth(facts))
    return [*_who(facts), *_wrong(facts), *_reaction(facts), *how, *_gaps(facts)]


def _who(facts: ReportFacts) -> Iterator[str]:
    drives = ", ".join(f"{name} (node {node.node_id})" for name, node in facts.nodes.items())
    where = ", ".join(f"{name} ({channel})" for name, channel in facts.channels.items())
    heard = f" on {where}" if where else ""
    yield (
        f"{facts.robot or 'A recording'}: {facts.seconds:.1f} s up to {clock(facts.end, date=True)}"
        f"{heard}; {drives or _no_drives(facts)}."
    )


def _no_drives(facts: ReportFacts) -> str:
    joints = ", ".join(facts.joints)
    return f"no bus, made-up hardware: {joints}" if joints and not facts.channels else "no node was seen"


def _wrong(facts: ReportFacts) -> Iterator[str]:
    errors = [event for event in facts.events if event.level == "error" and event.at >= 0]
    first = facts.fault
    if first is None:
        yield "Nothing was reported to go wrong in this time."
        return
    yield f"What went wrong first, {first.at:.3f} s into it ({clock(first.time)}): {_sentence(first.text)}"
    later = [event for event in errors if event.time >= first.time and event.text != first.text]
    for event in later[:_MOST]:
        yield f"{1e3 * (event.time - first.time):.0f} ms later: {_sentence(event.text)}"
    if len(later) > _MOST:
        yield f"{len(later) - _MOST} more errors followed; they are in the list of events."


def _reaction(facts: ReportFacts) -> Iterator[str]:
    for joint, seconds in facts.stopped_after_s.items():
        yield f"{joint} {'was not seen to stop' if seconds is None else f'came to rest {seconds:.2f} s later'}."
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
    """Say which joint followed worst of each kind, and which set-points were repeated or skipped."""
    known = {name: joint.tracking for name, joint in facts.joints.items() if joint.tracking is not None}
    for interface, unit in (("position", "rad"), ("velocity", "rad/s")):
        errors = {name: each for name, each in known.items() if each.interface == interface}
        if errors:
            name = max(errors, key=lambda each: errors[each].error_max_since_enable)
            worst, rms = errors[name].error_max_since_enable, errors[name].error_rms_since_enable
            yield f"Largest {interface} tracking error: {name}, {worst:.2g} {unit}, RMS {rms:.2g}."
    odd = [
        f"{name} {each.repeated} and {each.skipped}" for name, each in known.items() if each.repeated or each.skipped
    ]
    if odd:
        yield f"Set-points that were repeated, and skipped, while a joint moved: {', '.join(odd)}."


def _truth(facts: ReportFacts) -> Iterator[str]:
    """Say where a simulated base was in the end, and what odometry had made of it."""
    if facts.true_pose is not None:
        yield _sentence(f"At the end: {facts.true_pose.words}")


def _gaps(facts: ReportFacts) -> Iterator[str]:
    """Say what is missing here, so that nobody takes silence for good news."""
    gaps = facts.gaps
    if gaps.unheard:
        yield f"Not listened to: {', '.join(gaps.unheard)}; its frames are not in here."
    if gaps.frames_lost:
        yield f"{gaps.frames_lost} frames were lost: they came faster than they were recorded."
    if gaps.unread_lines:
        yield f"{gaps.unread_lines} lines of the log could not be read."
    if gaps.faults_left_out:
        yield f"{gaps.faults_left_out} earlier faults of this run have no file of their own."
    yield from (_sentence(note) for note in gaps.notes)


def _sentence(text: str) -> str:
    text = " ".join(text.split())
    return text if text.endswith((".", "?", "!")) else f"{text}."
