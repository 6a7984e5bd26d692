"""Sources of the monitor: a running robot, or a bare bus.

A source never blocks the drawing. Only a robot accepts commands; on a bare bus nothing is ever sent. Frames of a
robot's buses are received only while they are shown, because on the robot's own computer every frame costs time.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar

from canopen_control.cia301.nmt import NmtState, state_of_byte
from canopen_control.cia402 import objects
from canopen_control.cia402.modes import TARGET_OBJECTS, OperationMode, mode_name
from canopen_control.cia402.state import decode_statusword
from canopen_control.client import RobotClient
from canopen_control.errors import CanopenError, ConfigError, RemoteError, without_node
from canopen_control.monitor.drive_objects import DriveObjects, WorkRun, work_words
from canopen_control.monitor.frame_tables import BusTap, FrameTable, TraceLog
from canopen_control.monitor.monitor_content import (
    Cell,
    LogLine,
    MonitorContent,
    Tone,
    age_cell,
    plain,
    sdo_cell,
    state_cell,
    tone_of,
)
from canopen_control.rpc.messages.health import ROBOT_STATES
from canopen_control.rpc.messages.robot import ROBOT, GetLayout, GetNodes, GetStatus, Subscribe
from canopen_control.rpc.messages.state import AxisReading, RobotEvent, StateSample
from canopen_control.rpc.quick_verbs import state_name
from canopen_control.trace.decoder import Mark
from canopen_control.trace.network_description import NetworkDescription, network_of_layout
from canopen_control.trace.values import statusword_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.layout import BusLayout
    from canopen_control.rpc.messages.robot import NodePlace
    from canopen_control.rpc.messages.state import JointReading, NodeReading
    from canopen_control.trace.decoder import DecodedFrame
    from canopen_control.trace.values import SignalValue


# Tables of a bare bus, from the frames that nodes send anyway: heartbeats, TPDOs, emergencies, SDO answers.
#
# Sans-IO, times in ns; nothing is sent. The expected interval of a node's frames is its longest silence so far, but at
# least `_SHORTEST_INTERVAL_NS`. After `_STALE` intervals without a frame a node is stale, after `_DEAD` intervals dead.


_SECOND: Final = 1_000_000_000
_SHORTEST_INTERVAL_NS: Final = 500_000_000  # smallest assumed interval between the frames of a node
_STALE, _DEAD = 2, 5  # intervals without a frame
_OWN: Final = ("hb", "emcy", "pdo", "sdo")  # services that a node sends itself
_LEVELS: Final = {Mark.ERROR: Tone.BAD, Mark.WARNING: Tone.WARN}
_LOGGED: Final = ("nmt", "hb", "emcy", "error", "lss")


@dataclass(slots=True)
class _Axis:
    """Last values of one axis, in device units."""

    statusword: int | None = None
    mode: int | None = None
    values: dict[int, int] = field(default_factory=dict)


@dataclass(slots=True)
class _Node:
    """Last values of one node; `longest_ns` is the longest silence of the node."""

    last_ns: int
    longest_ns: int = 0
    nmt: NmtState | None = None
    error: str = ""
    reads: int = 0
    writes: int = 0
    failed: int = 0
    axes: dict[int, _Axis] = field(default_factory=dict)


# column of the joint table -> object
_ACTUAL: Final = {
    "velocity": objects.VELOCITY_ACTUAL,
    "position": objects.POSITION_ACTUAL,
    "effort": objects.TORQUE_ACTUAL,
}
_VALUES: Final = frozenset((*_ACTUAL.values(), *(index for index, _ in TARGET_OBJECTS.values())))


class BusTable:
    """Tables of the nodes on a bus, compiled from decoded frames."""

    def __init__(self, network: NetworkDescription) -> None:
        self.network = network
        self._nodes: dict[int, _Node] = {}
        self._log: list[LogLine] = []
        self._emergencies: list[LogLine] = []

    def feed(self, decoded: DecodedFrame) -> None:
        """Update the tables with a decoded frame, whose time is in Unix ns."""
        if decoded.mark > Mark.PLAIN and decoded.service in _LOGGED:
            self._note(decoded)
        if decoded.node_id is None or decoded.service not in _OWN:
            return
        if self._from_node(decoded):
            node = self._update_node(decoded.node_id, decoded.time)
        else:
            node = self._nodes.get(decoded.node_id) or _Node(
                decoded.time
            )  # a node that has sent no frame is not stored
        self._take(node, decoded)

    def content(self, now: int, title: str, facts: tuple[str, ...]) -> MonitorContent:
        """Return the tables at the Unix time `now` in ns."""
        rows = sorted(self._nodes.items())
        state = Cell("listening", Tone.GOOD) if rows else Cell("receiving, no node seen", Tone.WARN)
        drives = {str(node_id): self._row(node_id, node, now) for node_id, node in rows}
        joints = {
            f"{node_id}/{number}": self._joint(node_id, number, axis)
            for node_id, node in rows
            for number, axis in sorted(node.axes.items())
            if axis.values
        }
        return MonitorContent(title, state, "", facts, drives, joints)

    def log(self) -> list[LogLine]:
        """Return the log lines since the last call."""
        lines, self._log = self._log, []
        return lines

    def emergencies(self) -> list[LogLine]:
        """Return the EMCY messages since the last call."""
        lines, self._emergencies = self._emergencies, []
        return lines

    # -- frames

    def _from_node(self, decoded: DecodedFrame) -> bool:
        """Whether the node sent the frame; frames sent to a node do not prove that it exists."""
        return not decoded.subject.startswith(("RPDO", "SDO request")) and "request" not in decoded.text

    def _update_node(self, node_id: int, time: int) -> _Node:
        node = self._nodes.get(node_id)
        if node is None:
            node = self._nodes[node_id] = _Node(time)
        silence = time - node.last_ns
        if node.longest_ns and silence > _DEAD * node.longest_ns:
            node.longest_ns = 0  # the node was off the bus: learn its interval again
        else:
            node.longest_ns = max(node.longest_ns, silence)
        node.last_ns = time
        return node

    def _take(self, node: _Node, decoded: DecodedFrame) -> None:
        if decoded.service == "hb" and len(decoded.data) == 1:
            self._heartbeat(node, decoded.data[0])
        elif decoded.service == "emcy":
            node.error = "" if decoded.fault is None or decoded.fault.is_over else decoded.fault.code_text
        elif decoded.service == "sdo":
            node.reads += decoded.text.startswith("read ") and decoded.subject == "SDO request"
            node.writes += decoded.text.startswith("write ") and decoded.subject == "SDO request"
            node.failed += decoded.mark is Mark.ERROR
        for value in decoded.values:
            _take_value(node, value)

    def _heartbeat(self, node: _Node, byte: int) -> None:
        state = state_of_byte(byte)
        if state is NmtState.INITIALISING:  # after a boot-up, earlier values are invalid
            node.axes.clear()
            node.error, state = "", NmtState.PRE_OPERATIONAL
        node.nmt = state or node.nmt

    def _note(self, decoded: DecodedFrame) -> None:
        sender = "" if decoded.node_id is None or decoded.service == "nmt" else f"{self._node_title(decoded.node_id)}: "
        text = f"{sender}{decoded.subject}: {decoded.text}"
        line = LogLine(decoded.time / _SECOND, text, _LEVELS.get(decoded.mark, Tone.PLAIN))
        self._log.append(line)
        if decoded.service == "emcy":
            self._emergencies.append(line)

    def _node_title(self, node_id: int) -> str:
        name = self.network.name_of(node_id)
        return f"node {node_id} ({name})" if name else f"node {node_id}"

    # -- rows

    def _row(self, node_id: int, node: _Node, now: int) -> tuple[Cell, ...]:
        name = self.network.name_of(node_id)
        axis = node.axes.get(0) or _Axis()
        interval = max(node.longest_ns, _SHORTEST_INTERVAL_NS) / _SECOND
        state = None if axis.statusword is None else decode_statusword(axis.statusword)
        return (
            plain(f"{name} ({node_id})" if name else f"node {node_id}"),
            _nmt_cell(node.nmt),
            state_cell(None if state is None else state.name),
            Cell(node.error, Tone.BAD if node.error else Tone.PLAIN),
            age_cell((now - node.last_ns) / _SECOND, stale=_STALE * interval, dead=_DEAD * interval),
            plain("-" if axis.mode is None else mode_name(axis.mode)),
            sdo_cell(node.reads, node.writes, node.failed),
            plain(_statusword_flags(axis.statusword, axis.mode)),
        )

    def _joint(self, node_id: int, number: int, axis: _Axis) -> tuple[Cell, ...]:
        name = self.network.name_of(node_id) or f"node {node_id}"
        title = f"{name} axis {number}" if number else name
        target, _ = TARGET_OBJECTS.get(axis.mode or 0, (-1, 0))
        values = (axis.values.get(index) for index in (target, *_ACTUAL.values()))
        return (plain(f"{title} (device units)"), *(plain("-" if value is None else str(value)) for value in values))


def _nmt_cell(state: NmtState | None) -> Cell:
    if state is None:
        return plain("-")
    return Cell(state_name(state.name), Tone.GOOD if state is NmtState.OPERATIONAL else Tone.IDLE)


def _statusword_flags(statusword: int | None, mode: int | None) -> str:
    """Return the statusword with its flags as text, without the state; "-" if unknown."""
    if statusword is None:
        return "-"
    number, _, rest = statusword_text(statusword, mode).partition(" ")
    _, _, flags = rest.partition(", ")
    return f"{number} {flags}".rstrip()


def _take_value(node: _Node, value: SignalValue) -> None:
    if not 0x6000 <= value.index < 0xA000 or not isinstance(value.value, int):
        return
    base, number = objects.axis_of(value.index)
    axis = node.axes.setdefault(number, _Axis())
    if base == objects.STATUSWORD:
        axis.statusword = value.value
    elif base == objects.MODES_OF_OPERATION_DISPLAY:
        axis.mode = value.value
    elif base in _VALUES:
        axis.values[base] = value.value


# Client of a running robot that reconnects; a thread receives the newest state and the events.
#
# Drawing never waits for the robot. An error is kept as a text, and the connection is tried again once a second. After
# the first connection, the client reconnects to that robot only.


A = TypeVar("A")
RATE: Final = 5.0  # Hz
AGAIN_S: Final = 1.0
_TIMEOUT_S: Final = 2.0  # for requests that the robot answers at once
_SILENCE_S: Final = 1.0  # without a sample the robot or its computer hangs
_KEPT_EVENTS: Final = 1000
_REPEATED: Final = 200  # newest events that are compared, so that none is reported twice


class RobotLink:
    """Connection to the robot `name` (None: the only running robot), which reconnects automatically.

    `why` is the reason why there is no connection, or "".
    """

    def __init__(self, name: str | None = None) -> None:
        self.name = name
        self.why = "not connected yet"
        self.layouts: Mapping[str, BusLayout] = {}
        self.places: Mapping[str, NodePlace] = {}
        self.state: StateSample | None = None
        self._events: deque[RobotEvent] = deque(maxlen=_KEPT_EVENTS)
        self._recent: deque[RobotEvent] = deque(maxlen=_REPEATED)
        self._last_message = 0.0
        self._connection: RobotClient | None = None  # set also before the first requests are answered
        self._robot: RobotClient | None = None
        self._closed = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, on_sample: Callable[[], None] = lambda: None) -> None:
        """Start the thread that connects; it calls `on_sample` for each sample."""
        self._thread = threading.Thread(target=self._run, args=(on_sample,), name="robot link", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Close the connection, even while it is being established, and wait for the thread."""
        self._closed.set()
        connection = self._connection
        if connection is not None:
            connection.close()
        if self._thread is not None and self._thread.is_alive():
            self._thread.join(_TIMEOUT_S)

    @property
    def connected(self) -> bool:
        """Whether a sample has arrived within the last `_SILENCE_S`."""
        return self.state is not None and time.monotonic() - self._last_message < _SILENCE_S

    def events(self) -> list[RobotEvent]:
        """Return the events since the last call."""
        events = []
        while self._events:
            events.append(self._events.popleft())
        return events

    def ask(self, request: Request[A], timeout: float) -> A:
        """Send a request and wait up to `timeout` seconds.

        Raise RemoteError on failure. Blocks.
        """
        robot = self._robot
        if robot is None:
            raise RemoteError("BusClosed", f"{ROBOT.of(type(request)).name} cannot reach the robot: {self.why}")
        return robot.ask(request, timeout)

    def _run(self, on_sample: Callable[[], None]) -> None:
        while not self._closed.is_set():
            try:
                with RobotClient.connect(self.name, timeout=_TIMEOUT_S) as robot:
                    self._connection = robot
                    if self._closed.is_set():  # before `close` could see the connection
                        return
                    self._begin(robot)
                    self._follow(robot, on_sample)
            except CanopenError as error:
                self.why = str(error)
            self._connection, self._robot, self.state = None, None, None
            self._closed.wait(AGAIN_S)

    def _begin(self, robot: RobotClient) -> None:
        self.name = robot.robot
        robot.ask(Subscribe(state_rate=RATE, events=True))
        self.layouts = robot.ask(GetLayout()).buses
        self.places = {place.name: place for place in robot.ask(GetNodes()).nodes}
        for event in robot.ask(GetStatus()).events:
            self._keep(event)
        self._robot, self.why = robot, ""

    def _follow(self, robot: RobotClient, on_sample: Callable[[], None]) -> None:
        while not self._closed.is_set():
            for message in robot.messages(_SILENCE_S):
                if isinstance(message, RobotEvent):
                    self._keep(message)
                elif isinstance(message, StateSample):
                    self.state, self._last_message, self.why = message, time.monotonic(), ""
                    on_sample()
            self.why = f"robot {self.name} sent nothing for {_SILENCE_S:g} s; its process may be stopped or blocked"

    def _keep(self, event: RobotEvent) -> None:
        """Store an event unless it is known already, because the stream repeats events of the status."""
        if event not in self._recent:
            self._recent.append(event)
            self._events.append(event)


# Tables of a running robot, from a state sample.


STALE_S: Final = 0.25
"""Age in s from which a node is shown as stale; a node that the robot has lost is shown as dead."""
_LEVEL_TONES: Final = {"warning": Tone.WARN, "error": Tone.BAD}
_NO_AXIS: Final = AxisReading("")


def content_of(robot: str, state: StateSample) -> MonitorContent:
    """Return the content of the screen for a state sample."""
    alarm = state.hint or ""
    if state.latched:
        alarm = f"STOP is latched by {state.latched_by}: nothing moves before it is released (key r)"
    return MonitorContent(
        robot,
        Cell(state.state, tone_of(ROBOT_STATES.get(state.state))),
        alarm,
        tuple(_facts(state)),
        dict(_drives(state)),
        {name: _joint(joint) for name, joint in state.joints.items()},
    )


def without_robot(robot: str, why: str) -> MonitorContent:
    """Return the content of the screen while the robot is not connected, with the reason."""
    return MonitorContent(robot, Cell("not connected", Tone.BAD), f"{why}. STOP cannot reach the robot; reconnecting")


def log_line(event: RobotEvent) -> LogLine:
    """Convert an event to a log line."""
    return LogLine(event.time, event.text, _LEVEL_TONES.get(event.level, Tone.PLAIN))


def is_emergency(event: RobotEvent) -> bool:
    """Whether an event reports an emergency or its end."""
    return event.kind in ("emcy", "emcy_reset")


def _facts(state: StateSample) -> Iterator[str]:
    cycle = state.cycle
    yield f"cycle {1e3 * cycle.period_s:g} ms, {cycle.missed} missed"
    yield f"work {1e3 * cycle.work_s:.2f} ms, at most {1e3 * cycle.work_max_s:.2f}"
    yield f"late at most {1e3 * cycle.late_max_s:.2f} ms"
    for bus, load in state.load.items():
        if load is not None:
            yield f"bus {bus} {100 * load:.1f} %"
    if not state.nodes:
        yield "no CANopen drives"
    yield f"active: {', '.join(state.active) or 'no controller'}"


def _drives(state: StateSample) -> Iterator[tuple[str, tuple[Cell, ...]]]:
    for name, node in state.nodes.items():
        axes = node.axes or (_NO_AXIS,)
        for number, axis in enumerate(axes):
            yield name if number == 0 else f"{name}/{axis.axis}", _drive(name, node, axis, several=len(axes) > 1)


def _drive(name: str, node: NodeReading, axis: AxisReading, *, several: bool) -> tuple[Cell, ...]:
    title = f"{name} ({node.node_id})" + (f" axis {axis.axis}" if several else "")
    dead = 0.0 if node.nmt_state is None else float("inf")
    error = without_node(axis.error or node.error or "", node.node_id, name)  # the row names the node
    return (
        plain(title),
        _nmt(node),
        state_cell(axis.state),
        Cell(error, Tone.BAD if error else Tone.PLAIN),
        age_cell(node.age, stale=STALE_S, dead=dead),
        plain(axis.mode or "-"),
        sdo_cell(node.sdo.reads, node.sdo.writes, node.sdo.failed),
        plain(_statusword_flags(axis.statusword, OperationMode.__members__.get(axis.mode or ""))),
    )


def _nmt(node: NodeReading) -> Cell:
    if node.nmt_state is None:
        return Cell("lost" if node.age is not None else "missing", Tone.BAD)
    return Cell(state_name(node.nmt_state), Tone.GOOD if node.ready else Tone.WARN)


def _joint(joint: JointReading) -> tuple[Cell, ...]:
    values = (joint.command, joint.velocity, joint.position, joint.effort)
    return (plain(joint.name), *(plain("-" if value is None else f"{value:.3f}") for value in values))


SOURCE: Final = "monitor"
TIMEOUT_S: Final = 20.0  # for a stop or an enable, which include ramps


class LiveRobot:
    """Source for a running robot: uses its API, and its buses if other processes can receive their frames.

    `taps` listen on the buses; `frames` and `trace` contain the received frames.
    """

    can_command = True

    def __init__(self, name: str | None = None) -> None:
        self.frames, self.trace = FrameTable(), TraceLog()
        self.taps: list[BusTap] = []
        self._link = RobotLink(name)
        self._layouts: Mapping[str, BusLayout] = {}
        self._networks: list[NetworkDescription] = []
        self._listening = False
        self._emergencies: list[LogLine] = []
        self._objects = DriveObjects(SOURCE)

    @property
    def network(self) -> NetworkDescription:
        """Description of the nodes on the buses, for the filter."""
        nodes = {node_id: node for network in self._networks for node_id, node in network.nodes.items()}
        master = self._networks[0].master_node_id if self._networks else None
        return NetworkDescription(nodes=nodes, master_node_id=master)

    def start(self, on_sample: Callable[[], None] = lambda: None) -> None:
        """Start the connection, which calls `on_sample` on its thread for each sample of the robot."""
        self._link.start(on_sample)

    def close(self) -> None:
        self._objects.leave()
        self._link.close()
        for tap in self.taps:
            tap.close()

    def listen(self, on: bool) -> None:
        """Start or stop receiving the frames of the robot's buses."""
        if on is not self._listening:
            self._listening = on
            self._tap()

    def tick(self) -> None:
        """If frames are shown, open the robot's buses when they become known, and reopen a lost bus."""
        if self._link.layouts is not self._layouts:
            self._layouts = self._link.layouts
            self._networks = [network_of_layout(layout) for layout in self._layouts.values()]
            self._tap()
        for tap in self.taps:
            tap.tick(time.monotonic_ns())

    def choose(self, node: str) -> DriveObjects:
        """Select a node and return its objects."""
        self._objects.choose(self._link.name or "", self._link.places.get(node))
        return self._objects

    def content(self) -> MonitorContent:
        state = self._link.state
        if state is None or not self._link.connected:
            return without_robot(self._link.name or "robot", self._link.why or "no answer")
        return content_of(str(self._link.name), state)

    def log(self) -> list[LogLine]:
        """Return the log lines since the last call."""
        events = self._link.events()
        self._emergencies += [log_line(event) for event in events if is_emergency(event)]
        return [log_line(event) for event in events]

    def emergencies(self) -> list[LogLine]:
        """Return the emergencies among the events that `log` has returned since the last call."""
        emergencies, self._emergencies = self._emergencies, []
        return emergencies

    def command(self, request: Request[Any]) -> None:
        """Send a request and wait; raise RemoteError on failure. Blocks."""
        self._link.ask(request, TIMEOUT_S)

    def begin(self, title: str, text: str, node: str) -> WorkRun:
        """Start a command on a node with the text of the input line; raise CanopenError if it cannot be started."""
        return WorkRun(work_words(title, text, node, self._link.name or ""))

    def _tap(self) -> None:
        """Close the buses, then open the robot's current buses if frames are shown."""
        for tap in self.taps:
            tap.close()
        owner, networks = self._link.name or "", self._networks if self._listening else []
        self.taps = [BusTap(network, self._take, owner=owner) for network in networks]

    def _take(self, decoded: DecodedFrame) -> None:
        self.frames.add(decoded)
        self.trace.add(decoded)


class BusSource:
    """Source for a bare bus, on which nothing is sent."""

    can_command = False

    def __init__(self, network: NetworkDescription, *, owner: str = "") -> None:
        self.frames, self.trace = FrameTable(), TraceLog()
        self.network = network
        self._table = BusTable(network)
        self._tap = BusTap(network, self._take, owner=owner)
        self.taps = [self._tap]

    def start(self, on_sample: Callable[[], None] = lambda: None) -> None:
        """Do nothing, because `tick` opens the bus."""

    def listen(self, on: bool) -> None:
        """Do nothing, because this source always listens."""

    def close(self) -> None:
        self._tap.close()

    def tick(self) -> None:
        self._tap.tick(time.monotonic_ns())

    def choose(self, node: str) -> None:  # noqa: ARG002 - as in every source
        """Return None, because reading objects would require sending."""
        return

    def content(self) -> MonitorContent:
        load = self._tap.meter.load
        facts = [
            f"{self.network.bitrate // 1000} kbit/s",
            "bus load -" if load is None else f"bus load {100 * load:.1f} %",
        ]
        return self._table.content(time.time_ns(), f"{self.network.channel} (listening only)", tuple(facts))

    def log(self) -> list[LogLine]:
        return self._table.log()

    def emergencies(self) -> list[LogLine]:
        return self._table.emergencies()

    def command(self, request: Request[Any]) -> None:
        """Raise RemoteError, because this source never sends."""
        raise RemoteError(
            "LocalProtocolError", f"{ROBOT.of(type(request)).name}: this monitor only listens on {self.network.channel}"
        )

    def begin(self, title: str, text: str, node: str) -> WorkRun:  # noqa: ARG002 - as in every source
        """Raise ConfigError, because this source never sends."""
        raise ConfigError(f"{title}: this monitor only listens on {self.network.channel}")

    def _take(self, decoded: DecodedFrame) -> None:
        self._table.feed(decoded)
        self.frames.add(decoded)
        self.trace.add(decoded)


ScreenSource: TypeAlias = LiveRobot | BusSource
