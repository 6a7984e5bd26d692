"""Robot in virtual time: the runtime, and one simulated process with a drive per node of bus.yml.

The classes are those of `run` and `drive`; only the bus and the clocks are simulated. The same seed and events give the
same frames and reports, to the nanosecond.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import struct
import tempfile
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Final

from mypy_extensions import mypyc_attr

from canopen_control.bus.channel import open_port
from canopen_control.bus.memory import provide
from canopen_control.errors import RobotConfigError
from canopen_control.od.eds import read_eds
from canopen_control.runtime.core import RobotCore, RobotState
from canopen_control.runtime.observer import RobotObserver
from canopen_control.runtime.setup import required_objects, unit_quirks
from canopen_control.simulation.simulated_floor import SimulatedFloor, open_floor
from canopen_control.simulation.simulated_wire import SimulatedWire
from canopen_control.simulation.virtual_time import Actor, Timing, VirtualTime
from canopen_control.virtual.control import NodeMethods
from canopen_control.virtual.device import NO_OBJECTS, make_device
from canopen_control.virtual.node_host import NodeHost

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from canopen_control.bus.port import Port
    from canopen_control.controllers.trajectory.goal import TrajectoryGoal
    from canopen_control.master.event_log import Event
    from canopen_control.od.model import Address, ObjectDictionary
    from canopen_control.personality import Personality
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.virtual.scenario import ScenarioEvent
    from canopen_control.virtual.virtual_node import VirtualNode


# SHA-256 of all frames and events of a simulation with their times; equal digests mean identical runs. The folder of
# the robot's files, which appears in notes, is excluded.


_HEAD: Final = struct.Struct("<q")
_ENOUGH: Final = 1 << 16


@mypyc_attr(allow_interpreted_subclasses=True)
class SimulationObserver:
    """Base class of observers of a simulated robot; all methods are optional, times are in ns."""

    def event(self, event: Event) -> None:
        """Handle an event reported by the robot."""

    def played(self, now: int, act: ScenarioEvent) -> None:
        """Handle the start of a scheduled event."""

    def requested(self, now: int, act: ScenarioEvent) -> None:
        """Handle a request sent by a client."""

    def applied(self, now: int, act: ScenarioEvent) -> None:
        """Handle a command accepted by the robot."""

    def goal(self, now: int, act: ScenarioEvent, goal: TrajectoryGoal) -> None:
        """Handle a goal accepted by the robot."""


class EventDigest:
    """SHA-256 over frames and events; `events` counts the events, `folders` are removed from their texts."""

    def __init__(self, folders: Iterable[str] = ()) -> None:
        self.events = 0
        self._folders = sorted({f"{folder}/" for folder in folders}, key=len, reverse=True)
        self._labels: dict[str, bytes] = {}
        self._sha256 = hashlib.sha256()
        self._waiting = bytearray()
        self._pack = _HEAD.pack

    def frame(self, now: int, label: str, record: bytes) -> None:
        waiting, name = self._waiting, self._labels.get(label)
        if name is None:
            name = self._labels[label] = label.encode()
        waiting += self._pack(now) + record + name
        if len(waiting) > _ENOUGH:
            self._sha256.update(waiting)
            waiting.clear()

    def event(self, event: Event) -> None:
        self.events += 1
        self._waiting += self._pack(event.time)
        sentence = event.sentence
        for folder in self._folders:
            sentence = sentence.replace(folder, "")
        self._waiting += f"{event.kind}\0{event.node}\0{sentence}\0".encode()

    @property
    def hex(self) -> str:
        self._sha256.update(self._waiting)
        self._waiting.clear()
        return self._sha256.hexdigest()


MASTER: Final = "master"
_LED_NS: Final = 20_000_000  # `run` starts the robot once its drives exist
_HOST: Final = Timing(latency_ns=30_000, jitter_ns=120_000, spike_ns=5_000_000)
_DRIVE: Final = Timing(latency_ns=10_000, jitter_ns=60_000)


@dataclass(frozen=True, slots=True)
class Timings:
    """Wake-up delays of host and drives, and the largest oscillator error in `ppm`.

    The actual delays and errors are drawn from the seed.
    """

    host: Timing = _HOST
    drive: Timing = _DRIVE
    ppm: float = 50.0


def dictionary_of(path: Path) -> ObjectDictionary:
    """Return the object dictionary of an EDS file, cached until the file changes."""
    return _dictionary(str(path), Path(path).stat().st_mtime_ns)


@functools.cache
def _dictionary(path: str, _changed: int) -> ObjectDictionary:
    return read_eds(path).od


class SimulatedDrive:
    """Virtual drive as a simulated process; `device` is None without supply.

    `quirks`, the personality `like` and the values `objects` in place of those of the EDS take effect at power-on.
    """

    def __init__(self, robot: RobotUnderTest, wire: SimulatedWire, node_id: int, eds: Path) -> None:
        self.node_id, self.wire = node_id, wire
        self.label = f"drive {node_id}"
        self.device: VirtualNode | None = None
        self.actor: Actor | None = None
        self.quirks: Sequence[str] = ()
        self.like: Personality | None = None
        self.objects: Mapping[Address, int] = NO_OBJECTS
        self._robot, self._eds, self._times = robot, eds, 0
        self._host: NodeHost | None = None
        self._port: Port | None = None
        self._methods: NodeMethods | None = None

    def power_on(self) -> None:
        """Switch the supply on, unless already on; the drive boots."""
        if self.device is not None:
            return
        floor = self._robot.floor
        plant = None if floor is None else floor.plants_of(self.node_id)
        od = dictionary_of(self._eds)
        self.device = make_device(
            od, self.node_id, plant=plant, quirks=self.quirks, like=self.like, objects=self.objects
        )
        self._times += 1
        self.actor = actor = self._robot.actor(self.label, self._robot.timings.drive, self._times)
        self.wire.members[self.label] = actor
        with provide(self.wire.name, self.wire):
            self._port = open_port(self.wire.channel, label=self.label)
        self._host = NodeHost(actor.reactor, self._port, [self.device])
        self._methods = NodeMethods(self._host, self.device)
        actor.arrived()

    def power_off(self) -> None:
        """Switch the supply off; the shaft stops at its position."""
        if self._host is None or self._port is None or self.actor is None:
            return
        self._host.close()
        self._port.close()
        self.actor.end()
        if self._robot.floor is not None and self.device is not None:
            self._robot.floor.release_joints(self.node_id, self.device)
        self.device = self.actor = self._host = self._port = self._methods = None

    def do(self, work: Callable[[NodeMethods], object]) -> None:
        """Execute a control request in the drive's process; without supply, the request is lost."""
        if self._methods is not None and self.actor is not None:
            self.actor.call(functools.partial(work, self._methods))


class RobotUnderTest:
    """Runtime, buses and drives with one virtual clock, idle until `start`.

    `core` is the runtime, `drives` contains the drives by node-ID, `wires` the buses by name. `started_ns` is the time
    at which the robot's process was last started, `up` whether it runs, `errors` the exceptions raised in its program.
    With `reports_virtual_time` clients are informed that the robot's time is simulated. `floor` is the physics world of
    the drives, from the file `world`. If `time` is given, several robots share it, and their creator sets `floor`.
    """

    def __init__(
        self,
        setup: RobotSetup,
        seed: int = 0,
        timings: Timings | None = None,
        *,
        world: Path | None = None,
        time: VirtualTime | None = None,
    ) -> None:
        self.seed = seed
        self.timings = Timings() if timings is None else timings
        self.time = VirtualTime() if time is None else time
        self.digest = EventDigest(str(path.parent) for path in setup.files.paths)
        self.errors: list[BaseException] = []
        self.started_ns = 0
        self.up = self.reports_virtual_time = False
        self.observers: list[SimulationObserver] = []
        self.setup = dataclasses.replace(setup, channels={name: f"memory:{name}" for name in setup.channels})
        self._ppm = Random(f"{seed}/ppm")
        self.wires = {
            name: SimulatedWire(self.time, name, bus.master.baudrate * 1000) for name, bus in setup.joined.items()
        }
        self.drives: dict[int, SimulatedDrive] = {}
        for name, bus in setup.joined.items():
            self.wires[name].listeners.append(self.digest.frame)
            for node in bus.nodes.values():
                if (other := self.drives.get(node.node_id)) is not None:
                    raise RobotConfigError(
                        f"{node.name} on bus {name} and a node on bus {other.wire.name} are both node {node.node_id}; "
                        "a simulation names drives by node-ID: to simulate this robot, give one another node-ID"
                    )
                eds = bus.eds_paths[node.name]
                drive = self.drives[node.node_id] = SimulatedDrive(self, self.wires[name], node.node_id, eds)
                drive.quirks = unit_quirks(bus, node.name)
                drive.objects = required_objects(bus, node.name)
        self.host: Actor
        self.core: RobotCore
        self._times = 0
        self._state = tempfile.TemporaryDirectory(prefix="canopen-control-")  # files that outlive the robot's process
        self._boot()
        self.floor: SimulatedFloor | None = None
        if setup.physics and time is None:
            self.floor = SimulatedFloor(open_floor(setup, self.core.joints, world), self.time, self.awake)

    # -- life of the robot

    @property
    def now_ns(self) -> int:
        return self.time.now_ns

    @property
    def frames(self) -> int:
        return sum(wire.frames for wire in self.wires.values())

    @property
    def running(self) -> bool:
        """Whether the robot has booted and has not stopped (state RUNNING, DISABLED or FAULT)."""
        return self.core.state in (RobotState.RUNNING, RobotState.DISABLED, RobotState.FAULT)

    def start(self) -> None:
        """Switch the drives on, then start the robot's process."""
        for drive in self.drives.values():
            drive.power_on()
        self._join()

    def kill(self) -> None:
        """End the robot's process, as SIGKILL would."""
        self.up = False
        self.core.observers.clear()
        self.core.close()
        self.host.end()

    def restart(self) -> None:
        self._boot()
        self._join()

    def run_for(self, duration_ns: int) -> None:
        self.time.run_until(self.time.now_ns + duration_ns)

    def close(self) -> None:
        """Shut down robot and drives, and delete the temporary files."""
        self.kill()
        for drive in self.drives.values():
            drive.power_off()
        self._state.cleanup()

    def actor(self, name: str, timing: Timing, times: int = 1) -> Actor:
        """Create a process in virtual time, with an oscillator error drawn from the seed."""
        limit = self.timings.ppm
        drawn = round(self._ppm.uniform(-limit, limit), 3)
        shared = self.setup.physics and name != MASTER  # the drives of one world share a clock
        timing = dataclasses.replace(timing, ppm=0.0 if shared else drawn)
        actor = Actor(self.time, name, timing, f"{self.seed}/{times}")
        actor.reactor.on_error = self.errors.append
        return actor

    def awake(self) -> Iterator[VirtualNode]:
        """Yield the devices with supply whose process is not stalled."""
        now = self.time.now_ns
        for drive in self.drives.values():
            if drive.device is not None and drive.actor is not None and now >= drive.actor.stalled_until:
                yield drive.device

    def _boot(self) -> None:
        self._times += 1
        self.host = self.actor(MASTER, self.timings.host, self._times)
        for wire in self.wires.values():
            wire.members[MASTER] = self.host
        self.core = RobotCore(self.setup, self.host.reactor)
        self.core.wall.fix(0)
        self.core.in_virtual_time = self.reports_virtual_time
        self.core.observers.append(_CoreObserver(self))
        self.core.latch.keep(Path(self._state.name) / "stop_latched")

    def _join(self) -> None:
        core, host = self.core, self.host
        self.started_ns, self.up = self.time.now_ns, True
        with self._buses():
            core.join()
        self.time.later(_LED_NS, lambda: host.call(core.start))

    @contextlib.contextmanager
    def _buses(self) -> Iterator[None]:
        with contextlib.ExitStack() as stack:
            for wire in self.wires.values():
                stack.enter_context(provide(wire.name, wire))
            yield


class _CoreObserver(RobotObserver):
    """Forwarder of the events of the robot's current process."""

    def __init__(self, robot: RobotUnderTest) -> None:
        self._robot = robot

    def event(self, event: Event) -> None:
        self._robot.digest.event(event)
        for observer in self._robot.observers:
            observer.event(event)
