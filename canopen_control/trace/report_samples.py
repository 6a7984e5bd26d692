"""What the samples of the state stream tell of a run: who was in which state when, and how the joints followed.

The law of this file: times are seconds from `begin` (Unix), values are SI units, None where nothing was known; a state
lasts until the sample that shows another.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

__all__ = ["Spans", "cycle_of", "joints_of", "node_spans", "stopped_after"]

Json = dict[str, Any]
_QUANTITIES: Final = {"PP": "position", "IP": "position", "CSP": "position", "TQ": "effort", "CST": "effort"}
_JUST_S: Final = 1.0  # before a fault: who moved then is asked when he stood
_STANDING: Final = 1e-3  # rad/s or m/s
_STOOD_S: Final = 1.0
_SMALL: Final = 0.02  # of the fastest before: what counts as standing


class Spans:
    """A state over time as spans {"from", "to", "state"}; `see` it at each sample, `end` it at the last."""

    def __init__(self) -> None:
        self.spans: list[Json] = []

    def see(self, time: float, state: str | None) -> None:
        """Note the state at a time."""
        if self.spans and self.spans[-1]["state"] == state:
            self.spans[-1]["to"] = time
            return
        if self.spans:
            self.spans[-1]["to"] = time
        self.spans.append({"from": time, "to": time, "state": state})

    def end(self, time: float) -> list[Json]:
        """Return the spans, the last one until `time`."""
        if self.spans:
            self.spans[-1]["to"] = max(time, self.spans[-1]["to"])
        return self.spans


def node_spans(states: Sequence[Json], begin: float) -> dict[str, Json]:
    """Return {node: {"bus", "node_id", "nmt": spans, "axes": {joint: spans}}}."""
    nodes: dict[str, Json] = {}
    for sample in states:
        time = sample["time"] - begin
        for name, node in sample["nodes"].items():
            each = nodes.setdefault(name, {"bus": node["bus"], "node_id": node["node_id"], "nmt": Spans(), "axes": {}})
            each["nmt"].see(time, node["nmt_state"])
            for axis in node["axes"]:
                each["axes"].setdefault(axis["joint"], Spans()).see(time, axis["cia402_state"])
    end = states[-1]["time"] - begin if states else 0.0
    for node in nodes.values():
        node["nmt"] = node["nmt"].end(end)
        node["axes"] = {joint: spans.end(end) for joint, spans in node["axes"].items()}
    return nodes


def joints_of(states: Sequence[Json], begin: float) -> dict[str, Json]:
    """Return {joint: {"quantity", "time", "command", "actual", "error", "position", "velocity", "effort"}}.

    `quantity` is what its command means, by the drive's mode of operation: velocity where nothing else is known.
    `error` is command minus actual.
    """
    modes = _modes(states)
    joints: dict[str, Json] = {}
    for sample in states:
        for name, values in sample["joints"].items():
            if name not in joints:
                columns = ("time", "command", "actual", "error", "position", "velocity", "effort")
                joints[name] = {
                    "quantity": _QUANTITIES.get(modes.get(name, ""), "velocity"),
                    **{c: [] for c in columns},
                }
            joint = joints[name]
            actual, command = values.get(joint["quantity"]), values.get("command")
            joint["time"].append(round(sample["time"] - begin, 4))
            joint["command"].append(command)
            joint["actual"].append(actual)
            joint["error"].append(None if actual is None or command is None else command - actual)
            for column in ("position", "velocity", "effort"):
                joint[column].append(values.get(column))
    return joints


def _modes(states: Iterable[Json]) -> dict[str, str]:
    """Return the last mode of operation of each joint."""
    modes = {}
    for sample in states:
        for node in sample["nodes"].values():
            modes.update({axis["joint"]: axis["mode"] for axis in node["axes"] if axis.get("mode")})
    return modes


def cycle_of(states: Sequence[Json], status: Json) -> Json:
    """Return period, counts of these samples, and the histogram of how late the cycles came; {} where nothing is known.

    `late_counts` and `late_edges_s` are those of `status --json`; without samples they are of the whole run.
    """
    last = (states[-1] if states else status).get("cycle")
    if not last:
        return {}
    first = states[0]["cycle"] if len(states) > 1 else {}
    counts, before = last.get("late_counts") or [], first.get("late_counts") or []
    return {
        "period_s": last["period_s"],
        "count": last["count"] - first.get("count", 0),
        "missed": last["missed"] - first.get("missed", 0),
        "late_max_s": last["late_max_s"],
        "work_max_s": last["work_max_s"],
        "late_edges_s": status.get("late_edges_s") or [],
        "late_counts": [count - (before[i] if i < len(before) else 0) for i, count in enumerate(counts)],
    }


def stopped_after(joints: Json, time: float) -> dict[str, float | None]:
    """Return how many seconds after `time` each joint that moved stood still; None where that was not seen.

    Who stands for `_STOOD_S` or to the end has stopped; what he is commanded after that is another story.
    """
    found: dict[str, float | None] = {}
    for name, joint in joints.items():
        pairs = zip(joint["time"], joint["velocity"], strict=True)
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
