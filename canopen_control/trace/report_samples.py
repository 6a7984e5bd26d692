"""What the samples of the state stream tell of a run: who was in which state when, and how the joints followed.

The law of this file: a state lasts until the sample that shows another.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.rpc.messages.state import CycleTimes
from canopen_control.trace.report_facts import CycleFacts, JointFacts, NodeFacts, Span

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from canopen_control.rpc.messages.state import Status, TimedSnapshot

__all__ = ["Spans", "cycle_of", "joints_of", "node_spans", "stopped_after"]

_QUANTITIES: Final = {"PP": "position", "IP": "position", "CSP": "position", "TQ": "effort", "CST": "effort"}
_JUST_S: Final = 1.0  # before a fault: who moved then is asked when he stood
_STANDING: Final = 1e-3  # rad/s or m/s
_STOOD_S: Final = 1.0
_SMALL: Final = 0.02  # of the fastest before: what counts as standing


class Spans:
    """A state over time: `see` it at each sample, `end` it at the last."""

    def __init__(self) -> None:
        self._since: list[tuple[float, str | None]] = []  # when each state was seen first
        self._last = 0.0

    def __bool__(self) -> bool:
        return bool(self._since)

    def see(self, time: float, state: str | None) -> None:
        """Note the state at a time."""
        if not self._since or self._since[-1][1] != state:
            self._since.append((time, state))
        self._last = time

    def end(self, time: float) -> list[Span]:
        """Return the spans, the last one until `time`."""
        ends = [*(begin for begin, _ in self._since), max(time, self._last)][1:]
        return [Span(begin, end, state) for (begin, state), end in zip(self._since, ends, strict=True)]


def node_spans(states: Sequence[TimedSnapshot], begin: float) -> dict[str, NodeFacts]:
    """Return the states of the nodes, their axes by joint."""
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
    """Return how the joints followed; what a command means is by the drive's mode, velocity where nothing is known."""
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
    """Return the last mode of operation of each joint."""
    modes = {}
    for sample in states:
        for node in sample.nodes.values():
            modes.update({axis.joint: axis.mode for axis in node.axes if axis.mode})
    return modes


def cycle_of(states: Sequence[TimedSnapshot], status: Status | None) -> CycleFacts | None:
    """Return period, counts of these samples, and the histogram of how late the cycles came.

    `late_counts` and `late_edges_s` are those of `status --json`; without samples they are of the whole run.
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
    """Return how many seconds after `time` each joint that moved stood still; None where that was not seen.

    Who stands for `_STOOD_S` or to the end has stopped; what he is commanded after that is another story.
    """
    found: dict[str, float | None] = {}
    for name, joint in joints.items():
        pairs = zip(joint.time, joint.velocity, strict=True)
        moves = [(at, abs(value)) for at, value in pairs if value is not None]
        fastest = max((speed for at, speed in moves if time - _JUST_S <= at <= time), default=0.0)
        if fastest < _STANDING:
            continue
        since = _stands_since([(at, speed) for at, speed in moves if at >= time], _SMALL * fastest)
        found[name] = None if since is None else round(since - time, 3)
    return found


def _stands_since(moves: Sequence[tuple[float, float]], small: float) -> float | None:
    since: float | None = None
    for at, speed in moves:
        if speed > small:
            since = None
        elif since is None:
            since = at
        elif at - since > _STOOD_S:
            break
    return since
