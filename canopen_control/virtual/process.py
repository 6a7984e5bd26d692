"""Virtual drives as an operating system process of their own, which knows nothing of any master.

It prints a line for each bus when its nodes are on it, then what happens to them, in words. SIGTERM and SIGINT end it
with exit code 0. When its parent dies (the lifeline breaks) it serves on until its drives stand still by their own
reaction to the missing master, five seconds at most. A channel that is only down is waited for; one that is gone is
opened again when it is back within three seconds, else BusClosed ends the process when it was the last one.
"""

from __future__ import annotations

import contextlib
import importlib
import signal
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Final, Literal

from canopen_control.bus.channel import open_port, parse_channel
from canopen_control.cia301.lss import UNCONFIGURED
from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID
from canopen_control.cia301.sdo_codec import ANSWER_BASE, INITIATE, REQUEST_BASE, UPLOAD
from canopen_control.errors import BusError, ConfigError
from canopen_control.frame import MAX_NODE_ID, CanFrame, frames_of, pack_records
from canopen_control.host.lifeline import lifeline_fd, report_ready
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import SocketInUse
from canopen_control.virtual.control import NodeControl
from canopen_control.virtual.device import make_devices
from canopen_control.virtual.node_events import NodeIdChanged, in_words
from canopen_control.virtual.nodehost import NodeHost
from canopen_control.virtual.plant import WORLD_NOTE
from canopen_control.virtual.worldfile import ShaftWorld
from canopen_control.yamlfile.convert import position
from canopen_control.yamlfile.node import Node  # noqa: TC001 - the type of a field is looked up at run time
from canopen_control.yamlfile.reader import load

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Mapping, Sequence
    from pathlib import Path

    from canopen_control.bus.port import BusEvent, Port
    from canopen_control.errors import BusClosed
    from canopen_control.virtual.plant import SharedWorld, World
    from canopen_control.virtual.scenario import Switching
    from canopen_control.virtual.virtual_node import VirtualNode
    from canopen_control.yamlfile.problems import Problems


# Asks on the bus whether node ids are free, before virtual drives take them.
#
# The question is an upload of 0x1000, which every node has; whoever answers it, or is heard with a heartbeat, holds the
# id.


PROBE_NS = 40_000_000  # how long a node that is there already may take to answer
_DEVICE_TYPE = INITIATE.pack(UPLOAD, 0x1000, 0)


class NodeIdTaken(BusError):
    """Another node answers with the id."""

    def __init__(self, node_id: int, channel: str) -> None:
        self.node_id = node_id
        super().__init__(f"node id {node_id} already answers on {channel}; choose another --node-id, or end that node")


class NodeIdCheck:
    """Asks whether `node_ids` are free on `port`, from the moment it is made.

    A node without an id (255) holds none: CiA 305 lets any number of them wait for theirs on one bus.
    """

    def __init__(self, reactor: Reactor, port: Port, node_ids: Sequence[int]) -> None:
        self._reactor, self._port = reactor, port
        node_ids = [node_id for node_id in node_ids if node_id != UNCONFIGURED]
        self._answers = {
            base + node_id: node_id for node_id in node_ids for base in (ANSWER_BASE, ERROR_CONTROL_COB_ID)
        }
        self._taken: int | None = None
        self._until = reactor.now() + PROBE_NS
        port.send(pack_records([CanFrame(REQUEST_BASE + node_id, _DEVICE_TYPE) for node_id in node_ids]))

    def finish(self) -> None:
        """Wait for what is left of the time; raise NodeIdTaken when somebody was heard."""
        self._reactor.add_reader(self._port, self._listen)
        self._reactor.run_until(lambda: self._taken is not None, max(0, self._until - self._reactor.now()))
        self._reactor.remove_reader(self._port)
        if self._taken is not None:
            raise NodeIdTaken(self._taken, self._port.channel)

    def _listen(self) -> None:
        for frame in frames_of(self._port.receive()):
            self._taken = self._answers.get(frame.can_id, self._taken)


# Starts the process of virtual drives quickly: the bus is asked first, everything else is imported while it answers.
#
# A node id that answers on the bus already is refused.


@dataclass(frozen=True, slots=True)
class Options:
    """What to start besides the nodes: files, and faults ``name`` or ``name@seconds``.

    `serial` is 0x1018:04, of several nodes the first one's; None: the node id. `others` are the EDS files of the nodes
    that have another one.
    """

    faults: Sequence[str] = ()
    serial: int | None = None
    store: Path | None = None
    scenario: Path | None = None
    plant: Path | None = None
    others: Mapping[int, Path] = field(default_factory=dict)


def run_drives(node_ids: Sequence[int], eds: Path, channel: str, options: Options, say: Callable[[str], None]) -> int:
    """Run the virtual devices of an EDS until told to end; return the exit code.

    Raises EdsError and ConfigError for what cannot be started, BusError for the channel.
    """
    label = f"drive {node_ids[0]}" if len(node_ids) == 1 else f"drives {node_ids[0]}-{node_ids[-1]}"
    with Reactor() as reactor:
        port = open_port(channel, label=label)
        try:
            check = NodeIdCheck(reactor, port, node_ids)
            from canopen_control.virtual.device import make_devices

            devices = make_devices(
                node_ids,
                eds,
                say,
                faults=options.faults,
                serial=options.serial,
                store=options.store,
                scenario=options.scenario,
                plant=options.plant,
                others=options.others,
            )
            check.finish()
            with contextlib.closing(devices.world):
                again = partial(reopen, channel, label)
                bus = BusNodes(port, devices.nodes, again, devices.timeline, devices.world)
                process = DriveProcess(reactor, [bus], say)
                return process.run()
        finally:
            port.close()


def reopen(channel: str, label: str) -> Port | None:
    """Open a channel that was gone, None where it is not back. A local bus is not started for it.

    It joins, for a hub that dies is still there to who looks whether it is, and gone to who then opens.
    """
    if parse_channel(channel).kind.in_process:
        return None
    try:
        return open_port(channel, label=label, join=True)
    except BusError:
        return None


# Virtual nodes on one bus, in a process of drives: their host, their control sockets, their log and their timeline.
#
# A bus that is gone is opened again when it is back within three seconds; else it is given up, and its nodes go on
# without one.


_MS = 1_000_000
REJOIN_NS = 3_000 * _MS
WINDOW_NS: Final = 10_000_000_000
_SAME_LINES = 10  # of one node, before they are summed
_RETRY_NS = 100 * _MS


def _never() -> None:
    return None


@dataclass(frozen=True)
class BusNodes:
    """Nodes for an opened port; `reopen` opens its channel again where it is back, else it returns None.

    `timeline` is played from the ready line on; `world` is what hangs on the axes.
    """

    port: Port
    nodes: Sequence[VirtualNode]
    reopen: Callable[[], Port | None] = field(default=_never)
    timeline: Sequence[Switching] = ()
    world: World | None = None


class ServedBus:
    """Serves the nodes of one bus from `open` to `close`; `log` takes lines, `on_lost` is called when it is given up.

    `error` is why the bus is gone, None while it is there.
    """

    def __init__(
        self, reactor: Reactor, bus: BusNodes, log: Callable[[str], None], on_lost: Callable[[], object]
    ) -> None:
        self._reactor, self._bus, self._log, self._on_lost = reactor, bus, log, on_lost
        self.port, self.nodes, self.world = bus.port, list(bus.nodes), bus.world
        self._folded = FoldedLog(reactor, log)
        self._started_with = {node.node_id: node for node in self.nodes}
        self._controls: dict[VirtualNode, NodeControl] = {}
        self._host: NodeHost | None = None
        self._rejoin_until = 0
        self.error: BusClosed | None = None

    def open(self) -> None:
        """Begin to serve; NodeIdTaken where somebody serves such a node already."""
        self._host = NodeHost(
            self._reactor,
            self.port,
            self.nodes,
            on_event=self._on_event,
            on_bus_event=self._on_bus_event,
            on_closed=self._on_closed,
        )
        for node in self.nodes:
            try:
                self._controls[node] = NodeControl(self._host, node, self.world)
            except SocketInUse as error:
                if node.node_id != UNCONFIGURED:
                    raise NodeIdTaken(node.node_id, self.port.channel) from error
                self._controls[node] = NodeControl(self._host, node, self.world, with_socket=False)
                self._log("another drive without a node id has the control socket; this one gets one with its node id")

    def close(self) -> None:
        """Serve no more, and leave the bus."""
        if self._host is not None:
            self._host.close()
        for control in self._controls.values():
            control.close()
        self.port.close()

    def play_timeline(self) -> None:
        """Let what will happen begin now."""
        if self._bus.timeline:
            from canopen_control.virtual.scenario import Timeline  # with it comes YAML, which is slow to import

            Timeline(self._reactor, self._controls, self._started_with, self._log).plan(self._bus.timeline)

    def advance(self, now: int) -> None:
        """Bring all axes to `now`."""
        for node in self.nodes:
            node.advance_drives(now)

    @property
    def moving(self) -> bool:
        """Whether an axis moves."""
        return any(not drive.mover.standing for node in self.nodes for drive in node.drives.values())

    @property
    def ready_line(self) -> str:
        """Who is on which bus."""
        ids = [node.node_id for node in self.nodes]
        kind = "drive" if self.nodes[0].drives else "node"
        which = f"{kind} {ids[0]}" if len(ids) == 1 else f"{kind}s {', '.join(map(str, ids))}"
        name = self.nodes[0].name
        if ids == [UNCONFIGURED]:
            name += f", serial number {self.nodes[0].store.number(0x1018, 4)}"  # which LSS finds it by
        return f"{which} ({name}) ready on {self.port.channel}"

    # -- what happens

    def _on_event(self, node: VirtualNode, event: object) -> None:
        words = in_words(event)
        if words is None:
            return
        line = f"node {node.node_id}: {words}"
        self._folded.tell(line, line, _SAME_LINES)
        if node in self._controls:
            self._controls[node].push(words)
            if isinstance(event, NodeIdChanged) and self._host is not None:
                self._rename(self._host, node)

    def _rename(self, host: NodeHost, node: VirtualNode) -> None:
        """Let the control socket bear the node's new id."""
        self._controls[node].close()
        try:
            self._controls[node] = NodeControl(host, node, self.world)
        except SocketInUse:
            self._controls[node] = NodeControl(host, node, self.world, with_socket=False)
            self._log(f"node {node.node_id}: another virtual drive has this id; this one has no control socket")

    def _on_bus_event(self, event: BusEvent) -> None:
        """Tell what the controller reports: the first of its kind at once, those of the next seconds in sum."""
        self._folded.tell(event.kind, event.text, 1)

    def _on_closed(self, error: BusClosed) -> None:
        self.error = error
        self._log(str(error))
        self._rejoin_until = self._reactor.now() + (0 if self._bus.reopen is _never else REJOIN_NS)
        self._rejoin()

    def _rejoin(self) -> None:
        """Open the channel again as soon as it is back; give it up when that takes too long."""
        if self.error is None or self._host is None:
            return
        port = self._bus.reopen()
        if port is not None:
            self.port.close()
            self.port, self.error = port, None
            self._log(f"{port.channel} is back")
            self._host.rejoin(port)
        elif self._reactor.now() < self._rejoin_until:
            self._reactor.call_later(_RETRY_NS, self._rejoin)
        else:
            self._on_lost()


class FoldedLog:
    """A log without floods: of one `kind` the first `at_most` in 10 s, then the newest with how many there were."""

    def __init__(self, reactor: Reactor, write: Callable[[str], object]) -> None:
        self._reactor, self._write = reactor, write
        self._counts: dict[Hashable, int] = {}
        self._left_out: dict[Hashable, tuple[str, int]] = {}

    def tell(self, kind: Hashable, text: str, at_most: int) -> None:
        """Write a line, or count it where its kind has had as many as it may."""
        if not self._counts:
            self._reactor.call_later(WINDOW_NS, self._end_window)
        count = self._counts[kind] = self._counts.get(kind, 0) + 1
        if count <= at_most:
            self._write(text)
        else:
            self._left_out[kind] = (text, count - at_most)

    def _end_window(self) -> None:
        left_out, self._left_out = self._left_out, {}
        self._counts = {}
        for text, count in left_out.values():
            self._write(f"{text} ({count} more times in {WINDOW_NS // 1_000_000_000} s)")


STANDSTILL_NS = 5_000 * _MS
_LOOK_NS = 20 * _MS


class DriveProcess:
    """The nodes of one process on the opened ports of their buses; `say` takes the lines of the log."""

    def __init__(self, reactor: Reactor, buses: Sequence[BusNodes], say: Callable[[str], None]) -> None:
        self._reactor, self._say = reactor, say
        self._buses: list[ServedBus] = []
        for bus in buses:
            log = partial(self._log, f"{bus.port.channel}: " if len(buses) > 1 else "")
            self._buses.append(ServedBus(reactor, bus, log, self._on_lost))
        self._early: list[str] | None = []  # what happened before the ready line
        self._started = reactor.now()
        self._lifeline = lifeline_fd()
        self._standstill_until: int | None = None
        self._ended = False  # also when that came before the loop that it ends
        self._lost: BusClosed | None = None

    def run(self) -> int:
        """Serve until a signal, or the parent's end; return the exit code. Raises BusClosed, or NodeIdTaken."""
        self._reactor.handle_signals({signal.SIGTERM: self._end, signal.SIGINT: self._end})
        try:
            for bus in self._buses:
                bus.open()
            self._serve()
        finally:
            for bus in self._buses:
                bus.close()
        if self._lost is not None:
            raise self._lost
        return 0

    def _serve(self) -> None:
        if self._lifeline is not None:
            self._reactor.add_reader(self._lifeline, self._on_orphaned)
        self._reactor.run_for(0)  # the boot-up messages are out before anybody reads the line
        for bus in self._buses:
            self._say(bus.ready_line)
        report_ready()
        for line in self._early or ():
            self._say(line)
        self._early = None
        for bus in self._buses:
            bus.play_timeline()
        self._plan_to_keep_up()
        if not self._ended:
            self._reactor.run()

    def _end(self) -> None:
        self._lost = None
        self._leave()

    def _leave(self) -> None:
        self._ended = True
        self._reactor.stop()

    @property
    def _worlds(self) -> list[World]:
        return [bus.world for bus in self._buses if bus.world is not None]

    def _plan_to_keep_up(self) -> None:
        periods = [world.period_ns for world in self._worlds if world.period_ns is not None]
        if periods:
            self._reactor.call_later(min(periods), self._keep_up)

    def _keep_up(self) -> None:
        """Bring all axes to the present, for a world that wants to know them."""
        self._advance()
        for world in self._worlds:
            if isinstance(world, ShaftWorld):
                world.publish()
        self._plan_to_keep_up()

    def _advance(self) -> None:
        now = self._reactor.now()
        for bus in self._buses:
            bus.advance(now)

    # -- what happens

    def _log(self, where: str, text: str) -> None:
        line = f"{(self._reactor.now() - self._started) * 1e-9:9.3f} {where}{text}"
        if self._early is None:
            self._say(line)
        else:
            self._early.append(line)

    def _on_lost(self) -> None:
        """End when the last bus is gone for good."""
        errors = [bus.error for bus in self._buses]
        if all(error is not None for error in errors):
            self._lost = errors[0]
            self._leave()

    def _on_orphaned(self) -> None:
        """Wait for the drives' own reaction to a missing master, then end."""
        if self._lifeline is not None:
            self._reactor.remove_reader(self._lifeline)
        self._log("", "the parent process is gone; ending when the drives stand still")
        self._standstill_until = self._reactor.now() + STANDSTILL_NS
        self._look_for_standstill()

    def _look_for_standstill(self) -> None:
        self._advance()
        if any(bus.moving for bus in self._buses) and self._reactor.now() < (self._standstill_until or 0):
            self._reactor.call_later(_LOOK_NS, self._look_for_standstill)
        else:
            self._leave()


# Virtual drives on several buses in one process and one world: a robot with several buses, or several robots.
#
# The file says which nodes are on which bus, and what of the world each robot is, by plant files of one engine:
#
#  |  engine: mujoco
#  |  world: hall.yml                    # of several robots: where each begins; a robot alone has it in its plant file
#  |  robots:
#  |    robby1:
#  |      plant: robby1/physics.yml
#  |      buses:
#  |        can: {channel: "local:robby1", nodes: {"2": TMCM-1270.eds, "3": TMCM-1270.eds}}
#
# The bus `can` is the main one of a robot, whose axes have no bus in the plant file. Paths are those beside the file.


MAIN: Final = "can"
"""The name of the main bus of a robot."""
_ENGINES: Final = {"mujoco": "canopen_control.physics.engine"}  # imported only when a file asks for it

# ruff: noqa: RUF009 - `position` makes a field


class GroupError(ConfigError):
    """A file of several buses holds mistakes."""


@dataclass(frozen=True)
class BusFile:
    """One bus: its channel, and the EDS files by node ids."""

    channel: str
    nodes: dict[str, str]
    here: Node = position()


@dataclass(frozen=True)
class RobotFile:
    """One robot: its plant file, and its buses by name."""

    plant: str
    buses: dict[str, BusFile]
    here: Node = position()


@dataclass(frozen=True)
class BusGroup:
    """The file as a whole."""

    robots: dict[str, RobotFile]
    engine: Literal["mujoco"] = "mujoco"
    world: str = ""
    here: Node = position()


def read_group(path: Path) -> BusGroup:
    """Return the file; GroupError with every mistake and its line."""
    return load(path, BusGroup, error=GroupError, check=_check)


def _check(file: BusGroup, _problems: Problems) -> None:
    if not file.robots:
        file.here.error("robots: name one at least")
    if len(file.robots) > 1 and not file.world:
        file.here.error("world: say in which file it stands where each robot begins")
    channels = set[str]()
    for _, _, bus in _buses(file):
        if bus.channel in channels or not bus.nodes:
            bus.here.error("a bus has a channel of its own, and nodes")
        channels.add(bus.channel)
        for text in bus.nodes:
            if not text.isdigit() or not 1 <= int(text) <= MAX_NODE_ID:
                bus.here.error(f"{text!r} is no node id: 1 to {MAX_NODE_ID}")


def run_group(path: Path, say: Callable[[str], None]) -> int:
    """Run the drives of a file until told to end; return the exit code.

    Raises EdsError and ConfigError for what cannot be started, BusError for a channel.
    """
    file = read_group(path)
    with Reactor() as reactor, contextlib.ExitStack() as cleanup:
        waiting = []
        for _, _, bus in _buses(file):
            label = f"drives {', '.join(bus.nodes)}"
            port = open_port(bus.channel, label=label)
            cleanup.callback(port.close)
            waiting.append((port, label, NodeIdCheck(reactor, port, [int(each) for each in bus.nodes])))
        world = cleanup.enter_context(contextlib.closing(open_world(file, path)))
        for note in world.notes:
            say(f"{WORLD_NOTE}{note}")
        made = []
        for (name, bus_name, bus), (port, label, check) in zip(_buses(file), waiting, strict=True):
            side = world.side(name if file.world else "", "" if bus_name == MAIN else bus_name)
            made.append(_nodes(bus, path, port, label, side, say))
            check.finish()
        return DriveProcess(reactor, made, say).run()


def _buses(file: BusGroup) -> list[tuple[str, str, BusFile]]:
    return [(name, each, bus) for name, robot in file.robots.items() for each, bus in robot.buses.items()]


def _nodes(bus: BusFile, path: Path, port: Port, label: str, world: World, say: Callable[[str], None]) -> BusNodes:
    """Return the nodes of a bus on their side of the world."""
    others = {int(node): path.parent / eds for node, eds in bus.nodes.items()}
    devices = make_devices(list(others), next(iter(others.values())), say, others=others, world=world)
    return BusNodes(port, devices.nodes, partial(reopen, bus.channel, label), world=world)


def open_world(file: BusGroup, path: Path) -> SharedWorld:
    """Return the world that all share; `path` is that of the file."""
    engine = importlib.import_module(_ENGINES[file.engine])
    plants: Mapping[str, Path] = {name: path.parent / robot.plant for name, robot in file.robots.items()}
    if not file.world:
        alone: SharedWorld = engine.make(next(iter(plants.values())))
        return alone
    shared: SharedWorld = engine.make_shared(plants, path.parent / file.world)
    return shared
