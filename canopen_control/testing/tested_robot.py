"""Robot in virtual time for tests: commands, motion and events, faults of drives and buses.

Times are in s, positions and velocities of joints in SI units. Time advances only in `run`, `until`, `stopped_within`
and in the requests of a `session`; a test behaves identically in every run.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.commissioning.node_session import NodeSession, Transfers
from canopen_control.errors import ConfigError, DriveError, UnknownName, nearest
from canopen_control.frame import CanFrame, frames_of
from canopen_control.simulation.event_player import EventPlayer
from canopen_control.simulation.invariants import Invariants, user_rules
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.robot_under_test import RobotUnderTest, SimulationObserver
from canopen_control.simulation.served_simulation import ServedSimulation
from canopen_control.virtual.fault_table import find_fault
from canopen_control.virtual.quirks import parse_quirk
from canopen_control.virtual.scenario import ScenarioEvent

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from canopen_control.cia301.sdo_exchange import SdoRequest
    from canopen_control.master.event_log import Event
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.simulation.robot_under_test import SimulatedDrive


_S: Final = 1_000_000_000
_STEP_S: Final = 0.001
_BOOT_S: Final = 30.0
_STANDING: Final = 0.5  # counts/s
_STEP_NS: Final = 1_000_000
_NMT_NS: Final = 30_000_000_000  # for an NMT state, including a boot
_STATES: Final = {
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
    NmtCommand.RESET_NODE: NmtState.PRE_OPERATIONAL,
    NmtCommand.RESET_COMMUNICATION: NmtState.PRE_OPERATIONAL,
}


class _EventKeeper(SimulationObserver):
    def __init__(self, events: list[Event]) -> None:
        self._events = events

    def event(self, event: Event) -> None:
        self._events.append(event)


class TestedRobot:
    """Booted robot in virtual time; `events` are all events since the start.

    `quirks` maps the node-ID or name of a drive, or "all" for every drive, to the quirks that it has from power-on.
    """

    __test__ = False

    def __init__(
        self, setup: RobotSetup, seed: int = 0, *, quirks: Mapping[int | str, Sequence[str]] | None = None
    ) -> None:
        settings = {node: [parse_quirk(text).text for text in texts] for node, texts in (quirks or {}).items()}
        self.events: list[Event] = []
        self.simulated = RobotUnderTest(setup, seed)
        self.simulated.observers.append(_EventKeeper(self.events))
        self.player = EventPlayer(self.simulated)
        self._invariants = Invariants(self.simulated, self.player, motions_of(setup), user_rules())
        self._began_ns = self.simulated.now_ns
        self._served: ServedSimulation | None = None
        self._speed = 1.0
        self.drives = TestedDrives(self)
        self.bus = TestedBus(self)
        self.clock = TestedClock(self)
        for node, texts in settings.items():
            for drive in self.drives if node == "all" else (self.drives[node],):
                drive.start_with(texts)
        self.simulated.start()
        self.until(lambda: self.simulated.running, _BOOT_S)

    # -- time

    def run(self, seconds: float) -> None:
        """Advance the time by `seconds`; raise ControlError for a refused command (see `command`)."""
        if self._served is None:
            self.simulated.run_for(round(seconds * _S))
        else:
            self._served.run(round(seconds * _S), self._speed)
        if self.simulated.errors:
            raise self.simulated.errors[0]
        if self.player.mistakes:
            mistake = self.player.mistakes[0]
            self.player.mistakes.clear()
            raise mistake

    def serve(self, *, speed: float = 1.0, ros: Sequence[str] | None = None) -> None:
        """Accept other programs on the robot's socket; `run` then advances at `speed` times real time.

        With `ros` a bridge with these arguments connects ROS programs and publishes `/clock`.
        """
        self._served, self._speed = ServedSimulation(self.player), speed
        if ros is not None:
            self._served.start_bridge(ros)

    def until(self, condition: Callable[[], object], timeout: float = 10.0) -> float:
        """Advance the time until `condition` is true; return the elapsed s, or raise AssertionError after `timeout`."""
        passed = 0.0
        while not condition():
            if passed >= timeout:
                events = "; ".join(event.sentence for event in self.events[-3:])
                raise AssertionError(f"condition not met within {timeout:g} s; last events: {events or 'none'}")
            self.run(_STEP_S)
            passed += _STEP_S
        return passed

    def stopped_within(self, seconds: float) -> bool:
        """Advance the time until all shafts have stopped, by at most `seconds`; return whether they have."""
        remaining = round(seconds / _STEP_S)
        while self.moving and remaining > 0:
            self.run(_STEP_S)
            remaining -= 1
        return not self.moving

    # -- state

    @property
    def state(self) -> str:
        """State of the robot, such as "running", "disabled" or "fault"."""
        return self.simulated.core.state.value

    @property
    def moving(self) -> bool:
        """Whether the shaft of any drive turns."""
        return any(drive.moving for drive in self.drives)

    @property
    def breaches(self) -> list[str]:
        """Violated invariants, as sentences."""
        return [breach.sentence for breach in self._invariants.breaches]

    def velocity(self, joint: str) -> float:
        """Return the velocity of a joint as measured by the robot, in rad/s or m/s."""
        return self._state(joint, "velocity")

    def position(self, joint: str) -> float:
        """Return the position of a joint as measured by the robot, in rad or m."""
        return self._state(joint, "position")

    def _state(self, joint: str, quantity: str) -> float:
        joints = self.simulated.core.joints
        if joint not in joints:
            raise UnknownName(f"no joint {joint!r}{nearest(joint, joints)}")
        if (state := joints[joint].states.get(quantity)) is None:
            node = getattr(joints[joint], "node", None)
            where = "" if node is None else f" of {node.name}"
            raise UnknownName(f"joint {joint!r} has no {quantity}: no TPDO{where} carries it; `check` names the object")
        return state.value

    # -- commands

    def command(self, controller: str, *values: float, seconds: float | None = None) -> None:
        """Command a controller: once, or ten times a second for `seconds` from now on.

        `run` raises refusals, such as a wrong number of values or an inactive controller; a command while
        drives are disabled or STOP is latched causes only an event, because a test may be about that.
        """
        self._controller(controller)
        self.do("command", controller, values=values, seconds=seconds)

    def trajectory(self, controller: str, *positions: float, seconds: float) -> None:
        """Send a trajectory that moves all joints of a controller to `positions` in `seconds`.

        Refusals are raised as for `command`.
        """
        self._controller(controller)
        self.do("trajectory", controller, values=positions, seconds=seconds)

    def activate(self, controller: str) -> None:
        """Activate a controller, after deactivating conflicting controllers."""
        self._controller(controller)
        self.do("activate", controller)

    def enable(self) -> None:
        """Enable all drives."""
        self.do("axis", name="enable")

    def disable(self) -> None:
        """Disable all drives."""
        self.do("axis", name="disable")

    def reset_faults(self) -> None:
        """Reset the faults of all drives."""
        self.do("axis", name="fault-reset")

    def stop(self, *, latch: bool = False) -> None:
        """Stop with a ramp and disable the drives; with `latch` the stop stays latched until `release`."""
        self.do("latch" if latch else "stop")

    def release(self) -> None:
        """Release the latched stop."""
        self.do("release")

    def stall(self, seconds: float) -> None:
        """Block the robot's process for `seconds`."""
        self.do("stall", "master", seconds=seconds)

    def kill(self, seconds: float | None = None) -> None:
        """Kill the robot's process, and start a new one after `seconds` (None: never)."""
        self.do("kill", seconds=seconds)

    def do(
        self,
        kind: str,
        target: str = "",
        *,
        name: str = "",
        values: tuple[float, ...] = (),
        seconds: float | None = None,
    ) -> None:
        """Play a scenario event now; `kind` and the other arguments are those of a scenario step."""
        for_ns = None if seconds is None else round(seconds * _S)
        self.player.play(ScenarioEvent(0, kind, target, name, tuple(map(float, values)), for_ns))

    def session(self, node: int | str) -> NodeSession:
        """Return a session with a node for service jobs such as a backup; requests advance the time."""
        name, node_id = self.drives.place(node)
        od = self.simulated.core.node(name).od
        return NodeSession(SimulatedTransfers(self.simulated, node_id), node_id, od, name=name)

    def _controller(self, name: str) -> None:
        controllers = self.simulated.setup.controllers.controllers
        if name not in controllers:
            raise UnknownName(f"no controller {name!r}{nearest(name, controllers)}")

    def close(self) -> None:
        """Release the robot's resources."""
        if self._served is not None:
            self._served.close()
        self.simulated.close()


class SimulatedTransfers(Transfers):
    """SDO transfers and NMT commands for one node, through the robot's master in virtual time."""

    def __init__(self, robot: RobotUnderTest, node_id: int) -> None:
        self._robot, self._node_id = robot, node_id
        self._timeout_ns: int | None = None
        self._cancelled = False

    @property
    def _node(self) -> RemoteNode:
        return self._robot.core.node(str(self._node_id))

    def read(self, index: int, subindex: int, *, block: bool = False) -> bytes:
        node = self._node
        return self._ended(node.sdo.read(index, subindex, block=block, timeout_ns=self._timeout_ns)).data

    def write(self, index: int, subindex: int, data: bytes) -> None:
        self._ended(self._node.sdo.write(index, subindex, data, timeout_ns=self._timeout_ns))

    def _ended(self, request: SdoRequest) -> SdoRequest:
        self._cancelled = False
        self._robot.host.call(self._robot.core.bus_of(self._node).send_waiting)
        while not request.done:
            if self._cancelled:
                self._robot.host.call(partial(self._node.sdo.cancel_transfer, request))
            self._robot.run_for(_STEP_NS)
        if request.error is not None:
            raise request.error
        return request

    def set_timeout(self, seconds: float | None) -> None:
        self._timeout_ns = None if seconds is None else round(seconds * 1e9)

    def command(self, command: NmtCommand) -> None:
        """Send an NMT command through the robot; raise DriveError if the node does not reach the resulting state."""
        robot, node = self._robot, self._node
        robot.host.call(partial(node.command, command, robot.core.reactor.now()))
        robot.host.call(robot.core.bus_of(node).send_waiting)
        end = robot.now_ns + _NMT_NS
        robot.run_for(_STEP_NS)  # until the robot has processed the command
        while not (node.ready if command is NmtCommand.START else node.nmt_state is _STATES[command]):
            robot.run_for(_STEP_NS)
            if robot.now_ns > end:
                state = "silent" if node.nmt_state is None else node.nmt_state.text
                raise DriveError(f"node {self._node_id} is {state} after NMT {command.name.replace('_', ' ').lower()}")

    def nmt_state(self) -> NmtState | None:
        return self._node.nmt_state

    def taken_out(self) -> bool:
        return self._node.is_taken_out

    def progress(self) -> tuple[int, int | None]:
        return self._node.sdo.progress

    def cancel(self) -> None:
        """Cancel the transfer in progress; called by an observer during the transfer."""
        self._cancelled = True

    def pause(self, seconds: float) -> None:
        """Advance the virtual time by `seconds`."""
        self._robot.run_for(round(seconds * 1e9))

    def close(self) -> None:
        """Do nothing, since the node belongs to the robot."""


class TestedDrive:
    """Drive of a robot under test, in which faults can be injected."""

    __test__ = False

    def __init__(self, robot: TestedRobot, drive: SimulatedDrive) -> None:
        self._robot, self._drive = robot, drive

    @property
    def velocity(self) -> float:
        """Velocity of the fastest shaft of the drive in counts/s; 0 without supply."""
        device = self._drive.device
        return 0.0 if device is None else max((axis.mover.plant.velocity for axis in device.drives.values()), key=abs)

    @property
    def moving(self) -> bool:
        """Whether a shaft of the drive turns."""
        return abs(self.velocity) > _STANDING

    def fault(self, name: str, seconds: float | None = None) -> None:
        """Inject a fault for `seconds` (None: until `clear_fault`); raise ConfigError for an unknown fault."""
        find_fault(name)
        self._robot.do("fault", str(self._drive.node_id), name=name, seconds=seconds)

    def clear_fault(self, name: str) -> None:
        """Clear a fault; raise ConfigError for an unknown fault."""
        find_fault(name)
        self._robot.do("fault_off", str(self._drive.node_id), name=name)

    heal = clear_fault  # name up to version 0.2

    def start_with(self, quirks: Sequence[str]) -> None:
        """Add quirks that take effect at the next power-on of the drive."""
        self._drive.quirks = [*self._drive.quirks, *quirks]

    def quirk(self, text: str, seconds: float | None = None) -> None:
        """Enable a quirk ``NAME=VALUE@AXIS`` for `seconds` (None: permanently).

        Raise ConfigError for an unknown quirk.
        """
        parse_quirk(text)
        self._robot.do("quirk", str(self._drive.node_id), name=text, seconds=seconds)

    def quirk_off(self, text: str) -> None:
        """Disable a quirk; raise ConfigError for an unknown quirk."""
        parse_quirk(text)
        self._robot.do("quirk_off", str(self._drive.node_id), name=text)

    @property
    def quirks(self) -> list[str]:
        """Active quirks of the drive, as text."""
        device = self._drive.device
        return [] if device is None or device.quirks is None else device.quirks.active

    def power_off(self, seconds: float | None = None) -> None:
        """Switch off the supply of the drive for `seconds` (None: permanently)."""
        self._robot.do("power", str(self._drive.node_id), seconds=seconds)

    def cut(self, seconds: float | None = None) -> None:
        """Cut the CAN cable of the drive for `seconds` (None: permanently)."""
        self._robot.do("cut", str(self._drive.node_id), seconds=seconds)


class TestedDrives:
    """Drives of a robot under test, by node-ID or by name in bus.yml."""

    __test__ = False

    def __init__(self, robot: TestedRobot) -> None:
        buses = robot.simulated.setup.buses.values()
        self._ids = {node.name: node.node_id for bus in buses for node in bus.nodes.values()}
        self._drives = {number: TestedDrive(robot, drive) for number, drive in robot.simulated.drives.items()}

    def __getitem__(self, node: int | str) -> TestedDrive:
        return self._drives[self.place(node)[1]]

    def place(self, node: int | str) -> tuple[str, int]:
        """Return name and node-ID of a drive; raise UnknownName if it does not exist."""
        for name, number in self._ids.items():
            if node in (name, number) and number in self._drives:
                return name, number
        names = ", ".join(f"{name} ({number})" for name, number in self._ids.items())
        raise UnknownName(f"no drive {node!r}; available: {names}")

    def __iter__(self) -> Iterator[TestedDrive]:
        return iter(self._drives.values())

    def __len__(self) -> int:
        return len(self._drives)


class TestedBus:
    """Buses of a robot under test; `frames` are (time in s, sender, frame) of all traffic since the start."""

    __test__ = False

    def __init__(self, robot: TestedRobot) -> None:
        self.frames: list[tuple[float, str, CanFrame]] = []
        self._robot = robot
        for wire in robot.simulated.wires.values():
            wire.listeners.append(self._record)

    def _record(self, now: int, label: str, record: bytes) -> None:
        self.frames += [(self._robot.clock.at(now), label, frame) for frame in frames_of(record)]

    def lose(self, every: int = 1, seconds: float | None = None) -> None:
        """Lose every n-th frame (n: `every`) for `seconds` (None: permanently)."""
        self._tamper("lose", every, seconds)

    def double(self, every: int = 1, seconds: float | None = None) -> None:
        """Send every n-th frame (n: `every`) twice for `seconds` (None: permanently)."""
        self._tamper("double", every, seconds)

    def disturb(self, every: int = 1, seconds: float | None = None) -> None:
        """Disturb and repeat every n-th frame (n: `every`) for `seconds` (None: permanently)."""
        self._tamper("disturb", every, seconds)

    def send(self, can_id: int, data: bytes = b"") -> None:
        """Send a frame from a device that is not part of the robot."""
        self._robot.do("frame", values=(can_id, *data))

    def _tamper(self, kind: str, every: int, seconds: float | None) -> None:
        if every < 1:
            raise ConfigError(f"every {every}: give 1 for every frame, 2 for every second frame")
        self._robot.do(kind, values=(every,), seconds=seconds)


class TestedClock:
    """Virtual clock of a robot under test, in s since the start."""

    __test__ = False

    def __init__(self, robot: TestedRobot) -> None:
        self._robot, self._began_ns = robot, robot.simulated.now_ns

    @property
    def now(self) -> float:
        """Current virtual time in s since the start."""
        return self.at(self._robot.simulated.now_ns)

    def at(self, now_ns: int) -> float:
        """Convert a simulation time in ns to s since the start."""
        return (now_ns - self._began_ns) / _S

    def run(self, seconds: float) -> None:
        """Advance the virtual time by `seconds`."""
        self._robot.run(seconds)
