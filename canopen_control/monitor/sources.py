"""Where the monitor's content comes from: a running robot, or a bare bus.

The law of the file: a source never blocks who draws. Only a robot takes commands; on a bare bus nothing is ever sent.
A robot's buses are listened to while somebody looks at frames: on the robot's own computer every frame costs time.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Final, Protocol

from canopen_control.errors import ConfigError, RemoteError
from canopen_control.monitor.bus_rows import BusTable
from canopen_control.monitor.drive_objects import DriveObjects
from canopen_control.monitor.drive_work import WorkRun, work_words
from canopen_control.monitor.frame_tables import FrameTable, TraceLog
from canopen_control.monitor.robot_link import RobotLink
from canopen_control.monitor.robot_rows import content_of, is_emergency, log_line, without_robot
from canopen_control.monitor.tap import BusTap
from canopen_control.rpc.messages.robot import ROBOT
from canopen_control.trace.network_description import NetworkDescription, network_of_layout

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from canopen_control.monitor.monitor_content import LogLine, MonitorContent
    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.layout import BusLayout
    from canopen_control.trace.decoder import DecodedFrame

__all__ = ["SOURCE", "BusSource", "RobotSource", "Source"]

SOURCE: Final = "monitor"
TIMEOUT_S: Final = 20.0  # of a stop or an enable: the drives take their ramps


class Source(Protocol):
    """What the screen needs; `frames` and `trace` are those of the buses it listens to, which are `taps`."""

    can_command: bool
    frames: FrameTable
    trace: TraceLog
    taps: list[BusTap]

    @property
    def network(self) -> NetworkDescription:
        """Who is on the bus, for the filter's words."""
        ...

    def start(self, on_sample: Callable[[], None]) -> None:
        """Begin; `on_sample` is called, from any thread, when a new sample of the robot has come."""

    def close(self) -> None:
        """End."""

    def tick(self) -> None:
        """Do what is due; called a few times a second."""

    def listen(self, wanted: bool) -> None:
        """Frames are looked at from now on, or not any more."""

    def choose(self, node: str) -> DriveObjects | None:
        """Return the objects of a node, which are looked at from now on; None where nothing can be read."""

    def content(self) -> MonitorContent:
        """Return how it is now."""

    def log(self) -> list[LogLine]:
        """Return what happened since the last call."""

    def emergencies(self) -> list[LogLine]:
        """Return the emergencies since the last call."""

    def command(self, request: Request[Any]) -> None:
        """Ask the robot and wait; RemoteError. For threads that may wait."""

    def begin(self, what: str, text: str, node: str) -> WorkRun:
        """Begin a verb of `drive_work` on a node, with the line that was filled in; CanopenError where it cannot be."""
        ...


class RobotSource:
    """A running robot: its API, and its buses where somebody else can listen."""

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
        """All nodes of all buses: a filter names nodes whatever bus they are on."""
        nodes = {node_id: node for network in self._networks for node_id, node in network.nodes.items()}
        master = self._networks[0].master_node_id if self._networks else None
        return NetworkDescription(nodes=nodes, master_node_id=master)

    def start(self, on_sample: Callable[[], None] = lambda: None) -> None:
        """Look for the robot."""
        self._link.on_sample = on_sample
        self._link.start()

    def close(self) -> None:
        """Leave robot and buses."""
        self._objects.leave()
        self._link.close()
        for tap in self.taps:
            tap.close()

    def listen(self, wanted: bool) -> None:
        """Open its buses, or leave them."""
        if wanted is not self._listening:
            self._listening = wanted
            self._tap()

    def tick(self) -> None:
        """Listen to the robot's buses as soon as it has told which they are, where that is wanted."""
        if self._link.layouts is not self._layouts:
            self._layouts = self._link.layouts
            self._networks = [network_of_layout(each) for each in self._layouts.values()]
            self._tap()
        for tap in self.taps:
            tap.tick(time.monotonic_ns())

    def choose(self, node: str) -> DriveObjects:
        """Look at the objects of a node."""
        self._objects.choose(self._link.name or "", self._link.places.get(node))
        return self._objects

    def content(self) -> MonitorContent:
        """Return the newest sample."""
        state = self._link.state
        if state is None or not self._link.connected:
            return without_robot(self._link.name or "robot", self._link.why or "no answer")
        return content_of(str(self._link.name), state)

    def log(self) -> list[LogLine]:
        """Return the events since the last call."""
        events = self._link.events()
        self._emergencies += [log_line(event) for event in events if is_emergency(event)]
        return [log_line(event) for event in events]

    def emergencies(self) -> list[LogLine]:
        """Return the emergencies among what `log` has returned."""
        found, self._emergencies = self._emergencies, []
        return found

    def command(self, request: Request[Any]) -> None:
        """Ask the robot."""
        self._link.ask(request, TIMEOUT_S)

    def begin(self, what: str, text: str, node: str) -> WorkRun:
        """Begin it through the running robot."""
        return WorkRun(work_words(what, text, node, self._link.name or ""))

    def _tap(self) -> None:
        """Listen to the buses of a robot that was found, or has come back, perhaps with others; or not any more."""
        for tap in self.taps:
            tap.close()
        owner, networks = self._link.name or "", self._networks if self._listening else []
        self.taps = [BusTap(network, self._take, owner=owner) for network in networks]

    def _take(self, decoded: DecodedFrame) -> None:
        self.frames.add(decoded)
        self.trace.add(decoded)


class BusSource:
    """A bare bus that is only listened to."""

    can_command = False

    def __init__(self, network: NetworkDescription, *, owner: str = "") -> None:
        self.frames, self.trace = FrameTable(), TraceLog()
        self.network = network
        self._table = BusTable(network)
        self._tap = BusTap(network, self._take, owner=owner)
        self.taps = [self._tap]

    def start(self, on_sample: Callable[[], None] = lambda: None) -> None:
        """Do nothing: `tick` opens the bus, and its frames are all there is."""

    def listen(self, wanted: bool) -> None:
        """Do nothing: it always listens."""

    def close(self) -> None:
        """Leave the bus."""
        self._tap.close()

    def tick(self) -> None:
        """Open the bus, again where it went."""
        self._tap.tick(time.monotonic_ns())

    def choose(self, node: str) -> None:  # noqa: ARG002 - as every source has it
        """Return nothing: to read objects is to send."""
        return

    def content(self) -> MonitorContent:
        """Return what the nodes have said."""
        load = self._tap.meter.load
        facts = [
            f"{self.network.bitrate // 1000} kbit/s",
            "bus load -" if load is None else f"bus load {100 * load:.1f} %",
        ]
        return self._table.content(time.time_ns(), f"{self.network.channel} (listening only)", tuple(facts))

    def log(self) -> list[LogLine]:
        """Return what happened since the last call."""
        return self._table.log()

    def emergencies(self) -> list[LogLine]:
        """Return the emergencies since the last call."""
        return self._table.emergencies()

    def command(self, request: Request[Any]) -> None:
        """Refuse: this source never sends."""
        raise RemoteError(
            "LocalProtocolError", f"{ROBOT.of(type(request)).name}: this monitor only listens on {self.network.channel}"
        )

    def begin(self, what: str, text: str, node: str) -> WorkRun:  # noqa: ARG002 - as every source has it
        """Refuse, likewise."""
        raise ConfigError(f"{what}: this monitor only listens on {self.network.channel}")

    def _take(self, decoded: DecodedFrame) -> None:
        self._table.feed(decoded)
        self.frames.add(decoded)
        self.trace.add(decoded)
