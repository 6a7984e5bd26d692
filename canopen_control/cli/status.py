"""Show the state of a running robot: once, as JSON, or as a live table.

Exit codes: 0 success; 1 the robot does not answer, or has died; 2 wrong usage, or no robot runs.
"""

from __future__ import annotations

import json
import os
import re
import sys
import time
from types import SimpleNamespace

from canopen_control.cli.support.output import ENDS, Table, is_printed, json_line, json_text, painted, with_token
from canopen_control.errors import RemoteError
from canopen_control.host.lineclient import LineClient
from canopen_control.host.sockets import select_robot, socket_path
from canopen_control.rpc.quick_verbs import state_name
from canopen_control.version import PURE, TO_COMPILE, __version__

TYPE_CHECKING = False  # the module typing takes longer to import than this one
if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Mapping, Sequence
    from typing import Any

    from canopen_control.client import RobotClient
    from canopen_control.rpc.messages.state import (
        AxisReading,
        JointReading,
        NodeReading,
        RobotEvent,
        Snapshot,
        StateSample,
        Status,
    )


# Warnings and errors of a robot as text, each cause once.
#
# One failure causes several events: a drive sends an emergency message, its statusword shows the fault, and the stop
# group of its joints is stopped. Programs need all three; a reader needs one line with place, cause and consequence.
# The line joins the clauses of these events, without repetition. Repeated failures are one line with count and time
# span.


_TOGETHER_S = 1.0  # the events of one failure are reported within this time
_LEVELS = ("info", "warning", "error")
_STOPPING = re.compile(r"(stopping [^:]+): (.*)", re.DOTALL)
_NEXT = "to continue"  # beginning of the advice, which is the last clause of a line
_PLACE = re.compile(r"((?:node \d+ \([^)]*\)|bus \S+ \([^)]*\))): (.*)", re.DOTALL)


class _Cause:
    """Cause of warnings or errors at one node or bus; `clauses` are the parts of the sentence, by key."""

    def __init__(self, place: str, event: RobotEvent, clauses: dict[str, str], stopping: str) -> None:
        self.place, self.level, self.kinds = place, event.level, {event.kind}
        self.since = self.until = event.time
        self.clauses, self.stopping = clauses, stopping
        self.count = 1

    def line(self) -> str:
        advice = [text for text in self.clauses.values() if text.startswith(_NEXT)]
        causes = [text for text in self.clauses.values() if text not in advice]
        text = "; ".join([*causes, *filter(None, [self.stopping]), *advice])
        span = f" ({self.count} times, {_clock(self.since)} to {_clock(self.until)})" if self.count > 1 else ""
        return f"{self.level}: {self.place}{': ' if self.place else ''}{text}{span}"


def cause_lines(events: Iterable[RobotEvent], current: Mapping[str, str]) -> list[str]:
    """Return one line for each cause in `events`, without what `current` (errors by node name) already contains."""
    merged: list[_Cause] = []
    for cause in _gather(events):
        same = next((previous for previous in merged if _same_cause(previous, cause)), None)
        if same is None:
            merged.append(cause)
        else:
            same.count, same.until = same.count + 1, cause.until
    for cause in merged:
        if cause.count == 1:
            _remove_shown(cause, current)
    return [cause.line() for cause in merged if cause.clauses or cause.stopping]


def _gather(events: Iterable[RobotEvent]) -> list[_Cause]:
    """Group events by cause; different kinds of events at one place that share a clause have one cause."""
    causes: list[_Cause] = []
    reported: set[tuple[float, str]] = set()  # each axis of a node reports its loss, in one cycle
    for event in events:
        if event.level == "info" or (event.time, event.text) in reported:
            continue
        reported.add((event.time, event.text))
        new = _cause_of(event)
        previous = next((cause for cause in reversed(causes) if _belongs(new, cause)), None)
        if previous is None:
            causes.append(new)
            continue
        previous.clauses |= {head: text for head, text in new.clauses.items() if head not in previous.clauses}
        previous.stopping = previous.stopping or new.stopping
        previous.level = max(previous.level, new.level, key=_LEVELS.index)
        previous.kinds |= new.kinds
        previous.until = new.until
    return causes


def _cause_of(event: RobotEvent) -> _Cause:
    text, stopping = event.text, ""
    if (stop := _STOPPING.fullmatch(text)) is not None:
        stopping, text = stop[1], stop[2]
    node = ""
    if (place := _PLACE.fullmatch(text)) is not None:
        node, text = place[1], place[2]
    return _Cause(node, event, _clauses(text), stopping)


def _clauses(text: str) -> dict[str, str]:
    """Split a sentence into clauses by key; the key of an emergency message is its code, without the data."""
    clauses = text.removeprefix("lost: ").split("; ")
    return {clause.partition(", register 0x")[0]: clause for clause in clauses}


def _belongs(new: _Cause, previous: _Cause) -> bool:
    is_close = new.since - previous.until <= _TOGETHER_S
    other_kind = new.kinds.isdisjoint(previous.kinds)  # the same kind again is another failure
    shares_clause = not new.clauses.keys().isdisjoint(previous.clauses)
    return is_close and other_kind and new.place == previous.place and shares_clause


def _same_cause(first: _Cause, second: _Cause) -> bool:
    return (first.place, first.clauses.keys(), first.stopping) == (second.place, second.clauses.keys(), second.stopping)


def _remove_shown(cause: _Cause, current: Mapping[str, str]) -> None:
    """Remove the clauses of a cause that are already shown as the current error of the node."""
    for error in current.values():
        place = _PLACE.fullmatch(error)
        if place is not None and place[1] == cause.place:
            for head in _clauses(place[2]):
                cause.clauses.pop(head, None)


def _clock(seconds: float) -> str:
    return time.strftime("%H:%M:%S", time.localtime(seconds))


EXAMPLE = "canopen-control status --watch"
RATE = 5.0  # Hz of the live table
PLAIN_RATE = 1.0  # Hz of samples that are printed line by line
_PROTOCOL = 2  # as in `rpc.messages.declare`, which is not imported; a test compares both
_COLUMNS = ("node", "NMT", "CiA 402", "joint", "target", "actual rad/s", "position rad", "age ms")

_EXPENDABLE = ("age ms", "NMT")  # columns that a narrow terminal hides first
_TRACKING = ("tracking error", "max", "RMS", "max since enable", "RMS since enable", "repeated", "skipped")

#: unit of a target by mode of operation, for the modes of `cia402.modes.INTERFACE_MODES`
_UNITS = {"PP": "rad", "CSP": "rad", "PV": "rad/s", "CSV": "rad/s", "TQ": "Nm", "CST": "Nm"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    from canopen_control.cli.support.parsers import add_robot_name

    parser.add_argument("--json", action="store_true", help="print everything as JSON")
    parser.add_argument("--watch", action="store_true", help="print a live table until Ctrl-C")
    add_robot_name(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    from canopen_control.client import RobotClient
    from canopen_control.rpc.messages.robot import GetStatus

    with RobotClient.connect(args.name) as robot:
        if args.watch:
            return _watch(robot, as_json=args.json)
        status = robot.ask(GetStatus())
    if args.json:
        print(json_text(status))
    else:
        _print_table(status)
    return 0


def run_plain(arguments: Sequence[str]) -> bool:
    """Run the verb without importing the modules for options and messages, which take most of the time.

    Return False without output if these modules are needed: for other arguments, another version of the robot, a true
    pose, or an unexpected answer.
    """
    match arguments:
        case []:
            name = None
        case ["--name", chosen] if not chosen.startswith("-"):
            name = chosen
        case _:
            return False
    status = request_plain(select_robot(name), "status")
    if status is None or getattr(status, "version", "") != __version__ or status.true_pose is not None:
        return False
    _print_table(_with_attributes(status))
    return True


def request_plain(robot: str, method: str, timeout: float = 10.0) -> SimpleNamespace | None:
    """Call a method without parameters and return the fields of the result; raise RemoteError without a reply.

    Return None for another protocol version, a refusal or invalid JSON: the typed client reports their cause.
    """
    label = f"robot {robot}"
    with LineClient(socket_path("robot", robot), timeout, label=label) as stream:
        greeting = _object_in(
            stream.receive(timeout), f"{label} does not answer; its process may be stopped or blocked"
        )
        hello = greeting.get("hello")
        if not isinstance(hello, dict) or hello.get("protocol") != _PROTOCOL:
            return None
        stream.send(json.dumps({"id": 1, "method": method, "params": {}}).encode() + b"\n", timeout)
        late = f"{label} did not answer {method!r} within {timeout:g} s"
        deadline = time.monotonic() + timeout
        while True:
            answer = _object_in(stream.receive(max(0.0, deadline - time.monotonic())), late)
            if answer.get("id") == 1 or "error" in answer or not answer:
                result = answer.get("result")
                return SimpleNamespace(**result) if isinstance(result, dict) else None


def _object_in(line: bytes | None, late: str) -> dict[str, object]:
    """Return the JSON object in a line, or {} if the line is not a JSON object.

    Raise RemoteError with the text `late` if `line` is None.
    """
    if line is None:
        raise RemoteError("Timeout", late)
    try:
        fields = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return fields if isinstance(fields, dict) else {}


def _with_attributes(status: Any) -> Any:  # noqa: ANN401 - a Status but for its class
    """Convert a plain status of this version: replace its dicts by objects with attributes."""
    status.active = [name for name, state in status.controllers.items() if state == "active"]
    status.cycle = SimpleNamespace(**status.cycle)
    status.nodes = {name: _node_of(node) for name, node in status.nodes.items()}
    status.joints = {name: _joint_of(joint) for name, joint in status.joints.items()}
    status.buses = {name: SimpleNamespace(**bus) for name, bus in status.buses.items()}
    status.boot = [SimpleNamespace(**step) for step in status.boot]
    status.events = [SimpleNamespace(**event) for event in status.events]
    return status


def _node_of(document: dict[str, object]) -> SimpleNamespace:
    node = SimpleNamespace(age=document["age_s"], **document)
    node.sdo = SimpleNamespace(**node.sdo)
    node.axes = [SimpleNamespace(state=axis["cia402_state"], **axis) for axis in node.axes]
    return node


def _joint_of(document: dict[str, object]) -> SimpleNamespace:
    joint = SimpleNamespace(**document)
    joint.tracking = joint.tracking and SimpleNamespace(**joint.tracking)
    return joint


def _print_table(status: Status) -> None:
    """Print the full status of a robot as text: table, errors, buses, boot, causes of warnings, version."""
    current = {name: line.strip() for name, line in _errors(status).items()}
    sync = [f"bus {name}: {bus.sync}" for name, bus in status.buses.items() if bus.sync]
    missing = [f"program {name}: {missing_program}" for name, missing_program in status.missing_programs.items()]
    details = [*sync, *missing, *_boot(status, current), *cause_lines(status.events, current), *_program(status)]
    print("\n".join(painted([*render(status), *([""] if details else []), *details])))


def render(state: Snapshot, width: int | None = None) -> list[str]:
    """Return a robot's state as lines of at most `width` columns: a summary, a row for each axis, and errors."""
    cycle = state.cycle
    head = f"{state.state}, cycle {cycle.count} of {1e3 * cycle.period_s:g} ms, {cycle.missed} missed"
    table = Table(_COLUMNS)
    for name, node in state.nodes.items():
        for axis in node.axes or (None,):
            table.add(_row(name, node, axis, None if axis is None else state.joints.get(axis.joint)))
    for name, joint in () if state.nodes else state.joints.items():
        table.add(("no drive", "-", "-", name, *_numbers(joint), "-"))  # mock hardware or a simulation
    # with one axis per node the name of the node is enough
    single_axis = bool(state.nodes) and all(len(node.axes) <= 1 for node in state.nodes.values())
    rows = table.lines(width, (*_EXPENDABLE, *(("joint",) if single_axis else ()), "position rad"))
    lines = [state.hint] if state.hint else []
    active = ", ".join(state.active) or "none"
    truth = [] if state.true_pose is None else [state.true_pose.words]
    above = _wrapped([f"{head}, active: {active}", *lines, *truth], width)
    below = _wrapped([*_errors(state).values(), *_unsupervised(state), *_void_outputs(state)], width)
    return [*above, *rows, *_tracking(state, width), *below]


def _wrapped(lines: list[str], width: int | None) -> list[str]:
    """Wrap lines to at most `width` columns, with indented continuation lines; None is no limit."""
    if width is None:
        return lines
    import textwrap

    return [part for line in lines for part in textwrap.wrap(line, width, subsequent_indent="    ")]


def _tracking(state: Snapshot, width: int | None) -> list[str]:
    """Return a table of the joints' tracking errors; empty before a joint has moved under command."""
    table = Table(_TRACKING)
    tracked = [(name, joint.tracking) for name, joint in state.joints.items() if joint.tracking is not None]
    for name, tracking in tracked:
        unit = "rad" if tracking.interface == "position" else "rad/s"
        errors = (
            tracking.error_max,
            tracking.error_rms,
            tracking.error_max_since_enable,
            tracking.error_rms_since_enable,
        )
        numbers = [f"{error:.2g} {unit}" for error in errors]
        table.add((name, *numbers, f"{tracking.repeated}", f"{tracking.skipped}"))
    return table.lines(width, ("max", "RMS")) if tracked else []


def _errors(state: Snapshot) -> dict[str, str]:
    """Return a line with the current error of each node that has one, by node name."""
    return {
        name: f"  {node.error}" if name in node.error else f"  node {node.node_id} ({name}): {node.error}"
        for name, node in state.nodes.items()
        if node.error
    }


def _unsupervised(state: Snapshot) -> list[str]:
    """Return lines about drives that would not stop if the robot's program ended."""
    return [
        f"  {_marked(name, node)}: NOTHING stops this drive when the robot's program ends (allow_unsupervised): "
        f"{node.unsupervised}"
        for name, node in state.nodes.items()
        if node.unsupervised
    ]


def _marked(name: str, node: NodeReading) -> str:
    """Return the name and the node-ID of a node for the table, with "!" if the drive is unsupervised."""
    return f"{name} ({node.node_id})" + (" !" if node.unsupervised else "")


def _void_outputs(state: Snapshot) -> list[str]:
    """Return lines about outputs whose command became void when their node was lost."""
    return [
        f"  node {node.node_id} ({name}): outputs void since the node was lost: {', '.join(node.void_outputs)}; "
        "command them again"
        for name, node in state.nodes.items()
        if node.void_outputs
    ]


def _row(name: str, node: NodeReading, axis: AxisReading | None, joint: JointReading | None) -> tuple[str, ...]:
    return (
        _marked(name, node),
        state_name(node.nmt_state),
        "-" if axis is None else state_name(axis.state),
        "-" if axis is None else axis.joint,
        *_numbers(joint, "" if axis is None else _UNITS.get(axis.mode or "", "")),
        "-" if node.age is None else f"{1e3 * node.age:.0f}",
    )


def _numbers(joint: JointReading | None, unit: str = "") -> tuple[str, ...]:
    if joint is None:
        return "-", "-", "-"
    target, *actual = map(_number, (joint.command, joint.velocity, joint.position))
    return (target if target == "-" else f"{target} {unit}".rstrip(), *actual)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _boot(status: Status, current: Mapping[str, str]) -> list[str]:
    """Return a line for each node: durations of the boot steps, their errors unless in `current`, SDO requests."""
    steps: dict[str, list[str]] = {}
    for step in status.boot:
        why = "" if str(step.error) in current.get(step.node, "") else f": {step.error}"
        failed = f" failed{why}" if step.error else ""
        steps.setdefault(step.node, []).append(f"{step.step} {1e3 * step.seconds:.1f} ms{failed}")
    return [f"boot of {node}: {', '.join(step)}{_traffic(status, node)}" for node, step in steps.items()]


def _program(status: Status) -> list[str]:
    """Return a line with the version and the build of the robot's program, or no line if unknown."""
    advice = f" ({TO_COMPILE})" if status.build == PURE else ""
    return [f"canopen_control {status.version}, {status.build}{advice}"] if status.version else []


def _traffic(status: Status, node: str) -> str:
    """Return the SDO request counts of a node since the robot started, as text."""
    if node not in status.nodes:
        return ""
    sdo = status.nodes[node].sdo
    return f"; SDO: {sdo.reads} read, {sdo.writes} written, {sdo.failed} failed"


def _watch(robot: RobotClient, *, as_json: bool) -> int:
    """Print samples until the robot or the user ends: as a live table on a terminal, line by line elsewhere."""
    from canopen_control.rpc.messages.robot import Subscribe
    from canopen_control.rpc.messages.state import RobotEvent, StateSample

    table = _LiveTable() if sys.stdout.isatty() and not as_json else None
    robot.ask(Subscribe(state_rate=PLAIN_RATE if table is None and not as_json else RATE, events=True))
    ended = False
    try:
        for message in robot.messages(None):
            if isinstance(message, RobotEvent):
                ended = ended or message.kind in ENDS
                if table is not None and not ended and is_printed(message.kind, notable=message.level != "info"):
                    table.add_event(with_token(message.text) if message.kind == "view" else message.text)
            elif isinstance(message, StateSample) and not (ended and table is not None):
                if table is not None:
                    table.draw(message)
                else:
                    print(json_line(message) if as_json else "\n".join(painted(render(message))), flush=True)
    except RemoteError as error:
        if error.kind != "BusClosed":
            raise
        if not ended:  # the robot's process was killed, so the last sample is outdated
            print(f"canopen-control: {error}", file=sys.stderr)
            return 1
    except KeyboardInterrupt:
        pass  # the end of a watch
    return 0


class _LiveTable:
    """Table that is redrawn in place on a terminal; events are printed above it and remain."""

    def __init__(self) -> None:
        self._height = 0  # rows from the first row of the table to the cursor
        self._size: os.terminal_size | None = None

    def draw(self, sample: StateSample) -> None:
        previous, self._size = self._size, _terminal_size()
        lines = _limited(render(sample, self._size.columns), self._size.lines - 1)
        up = f"\x1b[{self._height}A" if self._height else ""
        if previous is not None and previous != self._size:  # the terminal has moved the rows
            up = "\x1b[H\x1b[2J"
        print(up + "\x1b[K\n".join(painted(lines)) + "\x1b[K\n\x1b[J", end="", flush=True)
        self._height = len(lines)

    def add_event(self, text: str) -> None:
        """Print an event above the table; the next sample redraws the table."""
        import textwrap

        up = f"\x1b[{self._height}A" if self._height else ""
        line = textwrap.fill(text, _terminal_size().columns, subsequent_indent="    ")
        print(f"{up}\x1b[J{line}\n", end="", flush=True)
        self._height = 0


def _terminal_size() -> os.terminal_size:
    try:
        size = os.get_terminal_size(sys.stdout.fileno())
    except (OSError, ValueError):
        size = os.terminal_size((0, 0))
    return size if size.columns > 0 and size.lines > 1 else os.terminal_size((80, 24))


def _limited(lines: list[str], height: int) -> list[str]:
    """Return at most `height` lines; if lines are omitted, the last line states how many."""
    if len(lines) <= height:
        return lines
    return [
        *lines[: height - 1],
        f"... {len(lines) - height + 1} more lines: enlarge the terminal, or use canopen-control status",
    ]
