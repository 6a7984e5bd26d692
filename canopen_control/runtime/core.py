"""The robot in its one thread: buses, hardware, controllers, and the cycle that runs through them.

The law of this file: a cycle is read, update, write, on absolute deadlines, and no exception of a node, a controller or
a client ends it. Nothing moves before a controller is active; whatever ends the robot (a user, a signal, the end of its
time, a lost bus) ends it by the same stop: targets to zero, the drives' own ramps, disable, and only then the bus.
"""

from __future__ import annotations

import enum
import time
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.controllers.manager import ControllerManager
from canopen_control.errors import BusError, CanopenError, ControlError, UnknownName
from canopen_control.hardware.command_limits import CommandLimits
from canopen_control.hardware.interfaces import ERROR
from canopen_control.hardware.joint import Action
from canopen_control.hardware.wheels import WheelGeometry
from canopen_control.master.events import Event, EventLog, Level
from canopen_control.runtime.assembly import Assembly
from canopen_control.runtime.latch import StopLatch
from canopen_control.runtime.pacer import Pacer
from canopen_control.runtime.request import AxisRequest, ProbeReading, begin_action
from canopen_control.runtime.wanted import load_controller, prepare_controllers

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.hardware.interfaces import HardwareComponent
    from canopen_control.hardware.joint import JointDrive
    from canopen_control.host.reactor import Reactor
    from canopen_control.master.node import RemoteNode
    from canopen_control.runtime.bus import RobotBus
    from canopen_control.runtime.setup import RobotSetup

__all__ = ["RobotCore", "RobotState"]

STOP_TIMEOUT_NS: Final = 15_000_000_000  # a stop that takes longer is ended without the drives' consent, and says so
REQUEST_TIMEOUT_NS: Final = 12_000_000_000
_NEVER: Final = 1 << 62  # boot_time 0: wait for the nodes for ever


class RobotState(enum.Enum):
    """What the robot is doing as a whole."""

    STARTING = "starting"
    RUNNING = "running"
    FAULT = "fault"
    STOPPING = "stopping"
    STOPPED = "stopped"


_RUNNING: Final = RobotState.RUNNING  # for every cycle, see `hardware.interfaces.OK`


class RobotCore:
    """Everything between the ports and the API; `failure` says why the run failed.

    `on_running` and `on_stopped` are called once each, `on_event` with every event, `after_cycle` after every cycle;
    `sent_at` is when the newest cycle's frames had left.
    """

    def __init__(self, setup: RobotSetup, reactor: Reactor) -> None:
        self.setup, self.reactor = setup, reactor
        self.events = EventLog()
        self.failure: str | None = None
        self.on_event: Callable[[Event], None] | None = None
        self.on_running: Callable[[], None] | None = None
        self.on_stopped: Callable[[], None] | None = None
        self.after_cycle: list[Callable[[int], None]] = []
        self.wall_offset_ns = time.time_ns() - reactor.now()
        self.commander: str | None = None
        self.sent_at = 0
        self.latch = StopLatch(self.report)
        self.pacer = Pacer(reactor, setup.cycle_ns, self._step)
        self._period = setup.cycle_ns / 1e9
        made = Assembly(setup, reactor, self.report, self._on_bus_lost, self.pacer.lead)
        self.registry, self.buses, self.nodes = made.registry, made.buses, made.nodes
        self.joints, self.systems, self._bus_by_node = made.joints, made.systems, made.bus_by_node
        self.manager = ControllerManager(
            self.registry,
            setup.controllers.update_rate,
            joints=setup.description.movable_joints,
            geometry=WheelGeometry(setup.description),
        )
        self._phase = RobotState.STARTING
        self._activated = False
        self._missed = self._tell_missed_at = 0
        self._deadline = 0
        self._stopping_until = 0
        self._requests: list[AxisRequest] = []
        if setup.controllers.manager.enforce_command_limits:
            self.manager.limiter = CommandLimits(setup.description, self.registry)
        prepare_controllers(setup, self.manager, self.registry)

    # ------------------------------------------------------------------------------------------- life

    @property
    def state(self) -> RobotState:
        """The state of the robot; FAULT while running and a node is missing or a drive is in fault."""
        if self._phase is RobotState.RUNNING and self._in_fault():
            return RobotState.FAULT
        return self._phase

    def start(self) -> None:
        """Open the buses and begin; raises BusError when a channel cannot be opened."""
        now = self.reactor.now()
        try:
            for bus in self.buses.values():
                bus.open()
        except BaseException:
            self.close()
            raise
        for note in self.setup.notes:
            self.report(Event(now, "note", "", note))
        for bus in self.buses.values():
            bus.network.start(now)
            bus.send_waiting()
        times = [bus.master.boot_time for bus in self.setup.buses.values()]
        self._deadline = now + max(times, default=0) * 1_000_000 if all(times) else _NEVER
        self.pacer.start()

    def shutdown(self, why: str) -> None:
        """Begin the end: ramp to zero, disable, leave the buses; a second call does nothing."""
        if self._phase in (RobotState.STOPPING, RobotState.STOPPED):
            return
        now = self.reactor.now()
        self.report(Event(now, "stopping", "", f"stopping: {why}"))
        self._phase = RobotState.STOPPING
        self._stopping_until = now + STOP_TIMEOUT_NS
        self._release_all(now)

    def close(self) -> None:
        """Leave everything at once; for the end, or after a failed start."""
        self.pacer.stop()
        for bus in self.buses.values():
            bus.close()
        for request in self._requests:
            request.fail("the robot has stopped")
        self._requests.clear()
        self._phase = RobotState.STOPPED

    # ------------------------------------------------------------------------------------------- verbs

    def report(self, event: Event) -> None:
        """Tell everyone who listens."""
        self.events.add(event)
        if self.on_event is not None:
            self.on_event(event)

    def command(self, controller: str, values: Sequence[float], source: str, stamp: float | None = None) -> None:
        """Hand a command to a controller; `stamp` is when it was made, in Unix seconds. Raises ControlError."""
        self.latch.refuse("a command to", controller)
        made = None if stamp is None else round(stamp * 1e9) - self.wall_offset_ns
        self.manager.command(controller, values, self.reactor.now(), made)
        self.commander = source

    def switch(self, activate: Sequence[str], deactivate: Sequence[str], *, strict: bool) -> None:
        """Switch controllers, loading and configuring those that are not; raises ControlError."""
        loaded = self.manager.states
        for name in activate:
            if name not in loaded:
                load_controller(self.setup, self.manager, name)
        self.latch.check_controllers(self.manager.get(name) for name in activate)
        self.manager.switch(activate=activate, deactivate=deactivate, strict=strict)

    def stop(self, done: Callable[[str | None], None], latched_by: str | None = None) -> None:
        """Ramp to zero and disable; `done(error)` when no drive moves under power any more.

        `latched_by` latches it as well, see runtime/latch.py.
        """
        now = self.reactor.now()
        if latched_by is None:
            self.report(Event(now, "stop", "", "stop was commanded", Level.WARNING))
        else:
            self.latch.hold(latched_by, self.manager.running, now)
        for system in self.systems:
            system.stop(now)
        self._requests.append(AxisRequest(tuple(self.joints.values()), Action.DISABLE, now + STOP_TIMEOUT_NS, done))

    def axis(
        self,
        action: Action,
        name: str,
        done: Callable[[str | None], None],
        *,
        joint: str | None = None,
        method: int | None = None,
        mode: str | None = None,
    ) -> None:
        """Do something to the axes of a node, or of "all"; `done(error)` when it is reached. Raises ControlError.

        `joint` is the one that is meant, of a node with several axes.
        `method` is the homing method (None: what 0x6098 holds), `mode` the mode of operation by name or number.
        """
        now = self.reactor.now()
        self.latch.check_action(action)
        joints = self._axes_of(name, joint)
        patience = begin_action(action, joints, self.systems, now, method=method, mode=mode)
        self._requests.append(AxisRequest(joints, action, now + REQUEST_TIMEOUT_NS + patience, done))

    def touch_probe(self, name: str, done: Callable[[dict[str, int] | str], None]) -> None:
        """Read what the touch probes of a node caught; `done` gets the values by name, or a sentence."""
        ProbeReading(self._axes_of(name)[0].axis, done)

    def node(self, name: str) -> RemoteNode:
        """Return a node by its name or node id; raises UnknownName."""
        for node in self.nodes.values():
            if name in (node.name, str(node.node_id)):
                return node
        known = ", ".join(f"{node.name} ({node.node_id})" for node in self.nodes.values()) or "none"
        raise UnknownName(f"no node {name!r}; there are: {known}")

    def bus_of(self, node: RemoteNode) -> RobotBus:
        """Return the bus a node is on."""
        return self._bus_by_node[node.name]

    # ------------------------------------------------------------------------------------------- cycle

    def _cycle(self, now: int) -> None:
        """Do a cycle with all that has come; for those who do not leave the ports to the reactor."""
        for bus in self.buses.values():
            bus.receive()
        self._step(now)

    def _step(self, now: int) -> None:
        """Do a cycle; the reactor serves the ports in every turn and before its timers, so all that came is read."""
        period, components = self._period, self.registry.components
        for component in components:
            if component.read(now, period) is ERROR:
                self._component_failed(component, "read", now)
        if self._phase is not _RUNNING:
            self._advance(now)
        self.manager.update(now, period)
        for component in components:
            if component.write(now, period) is ERROR:
                self._component_failed(component, "write", now)
        for bus in self.buses.values():
            bus.send_cycle(now)
        self.sent_at = self.reactor.now()
        self.manager.broadcast(now, period)
        self._supervise(now)
        self._after(now)

    def _supervise(self, now: int) -> None:
        """Let time pass for what acts in the next cycle: heartbeats, time-outs, what is looked at now and then."""
        for bus in self.buses.values():
            bus.tick(now)
        for system in self.systems:
            system.supervise(now)

    def _component_failed(self, component: HardwareComponent, verb: str, now: int) -> None:
        self.manager.deactivate_using(component, f"{component.name} reported an error on {verb}", now)

    def _after(self, now: int) -> None:
        """Tell what the cycle, whose frames are on their way, has brought."""
        if self._requests:
            self._requests = [request for request in self._requests if not request.settle(now)]
        if self.pacer.missed != self._missed and now >= self._tell_missed_at:
            self._tell_missed(now)
        for event in self.manager.events():
            self.report(Event(now, event.kind, "", event.text, _CONTROLLER_LEVELS.get(event.kind, Level.WARNING)))
        for hook in self.after_cycle:
            hook(now)

    def _tell_missed(self, now: int) -> None:
        """Tell, at most once a second, that cycles and their SYNCs were left out because this process came late."""
        missed, self._missed = self.pacer.missed - self._missed, self.pacer.missed
        self._tell_missed_at = now + 1_000_000_000
        cycles = "1 cycle" if missed == 1 else f"{missed} cycles"
        text = f"{cycles} left out, {self.pacer.late_max / 1e6:.0f} ms late at worst; is the machine busy?"
        self.report(Event(now, "sync_overrun", "", text, Level.WARNING))

    def _advance(self, now: int) -> None:
        """Take the next step of starting or stopping."""
        if self._phase is RobotState.STARTING:
            self._advance_start(now)
        elif self._phase is RobotState.STOPPING:
            self._advance_stop(now)

    def _advance_start(self, now: int) -> None:
        missing = [node for node in self.nodes.values() if node.config.required and not node.ready]
        if not missing and not self._activated and not self.latch.held:
            self._activated = True
            self._deadline = now + REQUEST_TIMEOUT_NS
            self._activate()
        elif self._activated and (self._settled() or now > self._deadline):
            self._phase = RobotState.RUNNING
            self.report(Event(now, "running", "", f"{self.setup.name} runs: {', '.join(self.setup.wanted)}"))
            if self.on_running is not None:
                self.on_running()
        elif missing and now > self._deadline:
            self._fail(self._why_silent() or "; ".join(self._why_missing(node) for node in missing))

    def _why_silent(self) -> str:
        """Say that nobody is there at all, where not one frame has come from any bus."""
        silent = [bus for bus in self.buses.values() if bus.port is not None and bus.port.stats.rx == 0]
        return "; ".join(
            f"nobody answers on {bus.channel}: not one frame came from {', '.join(bus.config.nodes)} "
            f"within {bus.config.master.boot_time / 1000:g} s; are the drives there, powered, "
            f"and set to {bus.config.master.baudrate} kbit/s?"
            for bus in (silent if len(silent) == len(self.buses) else ())
        )

    def _why_missing(self, node: RemoteNode) -> str:
        if node.error and node.error.startswith(f"node {node.node_id}"):
            return node.error
        seconds = self.bus_of(node).config.master.boot_time / 1000
        reason = node.error or f"not operational within {seconds:g} s; its boot got as far as {node.boot_step!r}"
        return f"{node.who}: {reason}"

    def _advance_stop(self, now: int) -> None:
        late = now > self._stopping_until
        if not late and not all(system.stopped for system in self.systems):
            return
        if late:
            self.report(Event(now, "stop_timeout", "", "the drives did not confirm the stop in time", Level.ERROR))
        for bus in self.buses.values():
            # Back to the stored communication settings: the drives then no longer wait for this master's heartbeat.
            for node in bus.network.nodes.values():
                if node.config.reset_communication:  # a keep-alive node is left as it is
                    bus.network.send_nmt(NmtCommand.RESET_COMMUNICATION, node.node_id)
            bus.send_waiting()
        self.report(Event(now, "stopped", "", f"{self.setup.name} has stopped, its drives are disabled"))
        self.close()
        if self.on_stopped is not None:
            self.on_stopped()

    def _activate(self) -> None:
        """Do what the spawners of the tutorial do: load, configure and activate, broadcasters first."""
        try:
            for component in self.registry.components:
                component.configure()
                component.activate()
            self.switch(self.setup.wanted, (), strict=True)
        except CanopenError as error:
            self._fail(str(error))

    def _fail(self, text: str) -> None:
        self.failure = self.failure or text
        self.report(Event(self.reactor.now(), "failed", "", text, Level.ERROR))
        self.shutdown("the run failed")

    def _release_all(self, now: int) -> None:
        try:
            self.manager.switch(deactivate=self.manager.active, strict=False)
        except CanopenError as error:
            self.report(Event(now, "error", "", str(error), Level.ERROR))
        for system in self.systems:
            system.stop(now)

    def _settled(self) -> bool:
        """Whether no drive is on its way to be enabled any more: it is, or it has a reason not to be."""
        claimed = [joint for joint in self.joints.values() if joint.claimed is not None]
        waits = any(_is_absent(joint.node) for joint in claimed)  # and with it all that move together
        return waits or self._in_fault() or all(joint.enabled or not joint.wanted for joint in claimed)

    def _in_fault(self) -> bool:
        return any(not node.ready or node.stale for node in self.nodes.values() if node.config.required) or any(
            joint.machine.fault for joint in self.joints.values()
        )

    def _axes_of(self, name: str, only: str | None = None) -> tuple[JointDrive, ...]:
        if name == "all":
            joints = tuple(self.joints.values())
        else:
            node = self.node(name)
            joints = tuple(joint for joint in self.joints.values() if joint.node is node)
            if not joints:
                raise ControlError(f"{node.who} drives no joint of the description")
        if only is None:
            return joints
        meant = tuple(joint for joint in joints if joint.joint == only)
        if not meant:
            known = ", ".join(joint.joint for joint in joints) or "none"
            raise UnknownName(f"{name} has no joint {only!r}; there are: {known}")
        return meant

    def _on_bus_lost(self, error: BusError) -> None:
        """End the run: a bus that is gone carries no stop, the drives stop when our heartbeat is missing."""
        self.failure = self.failure or str(error)
        self.close()
        if self.on_stopped is not None:
            self.reactor.call_soon(self.on_stopped)


def _is_absent(node: RemoteNode) -> bool:
    """Whether a node is not there and need not be."""
    return not node.ready and not node.config.required


_CONTROLLER_LEVELS = {"activated": Level.INFO, "deactivated": Level.INFO, "error": Level.ERROR}
