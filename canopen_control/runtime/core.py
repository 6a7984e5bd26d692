"""Core of a running robot in one thread: buses, hardware components, controllers, and the control cycle.

No exception of a node, a controller or a client ends the cycle (`RobotCycle`). Nothing moves before a controller is
active. A user, a signal, and the end of the requested duration end the robot by the same stop: targets go to zero, the
drives ramp down by themselves and are disabled, and only then are the buses closed. After the loss of a bus its drives
stop by their heartbeat consumers; the drives of the other buses ramp down as at any other end.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.nmt import NmtState
from canopen_control.controllers.command_limits import CommandLimits
from canopen_control.controllers.manager import ControllerManager
from canopen_control.errors import BusError, CanopenError, ControlError
from canopen_control.hardware.axis_statechart import Action, merge_base_groups
from canopen_control.master.event_log import Event, EventLog, Level
from canopen_control.runtime.assembly import Assembly
from canopen_control.runtime.axis_request import (
    EXCLUSIVE_ACTIONS,
    PendingAxisRequest,
    ProbeReading,
    axes_of,
    begin_action,
    find_node,
    whole_bases,
    without_target,
)
from canopen_control.runtime.enable_status import (
    DriveEnableStatus,
    claimed_off,
    cost_of_skipping,
    disable_unready,
    enable_hint,
    in_fault,
    no_target,
    startup_complete,
    stop_summary,
    why_not_started,
)
from canopen_control.runtime.ground_truth import TruePoseTracker
from canopen_control.runtime.mandatory_nodes import MandatoryNodes
from canopen_control.runtime.node_readings import EventReadings, NodeReadings
from canopen_control.runtime.pacer import Pacer
from canopen_control.runtime.robot_bus import RobotBus
from canopen_control.runtime.robot_clock import WallClock, step_words
from canopen_control.runtime.robot_cycle import CycledRobot, RobotCycle
from canopen_control.runtime.startup_controllers import prepare_controllers, require_active, switch_controllers
from canopen_control.runtime.stop_latch import MOVING_ACTIONS, StopLatch
from canopen_control.urdf.robot_model import WheelGeometry

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from canopen_control.controllers.command_timeout import CommandSender
    from canopen_control.controllers.manager import AnyGoal
    from canopen_control.hardware.joint import JointDrive
    from canopen_control.host.reactor import Reactor
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.runtime.observer import RobotObserver
    from canopen_control.runtime.setup import RobotSetup


STOP_TIMEOUT_NS: Final = 15_000_000_000  # a longer stop ends without confirmation by the drives, with an event
REQUEST_TIMEOUT_NS: Final = 12_000_000_000
_NEVER: Final = 1 << 62  # boot_time 0: wait for the nodes forever


class RobotState(enum.Enum):
    """State of a robot; DISABLED means that drives claimed by a controller wait to be enabled."""

    STARTING = "starting"
    RUNNING = "running"
    DISABLED = "disabled"
    FAULT = "fault"
    STOPPING = "stopping"
    STOPPED = "stopped"


class RobotCore(CycledRobot):
    """Running robot between its bus ports and the API; `failure` is the error text of a failed run, else None.

    `observers` are called in order. `in_virtual_time` is set, and reported to clients, if the robot's clock is
    the clock of a simulation.
    """

    def __init__(self, setup: RobotSetup, reactor: Reactor) -> None:
        self.setup, self.reactor = setup, reactor
        self.events = EventLog()
        self.recent_events = EventReadings(self.events)
        self.failure: str | None = None
        self.has_run = False
        self.observers: list[RobotObserver] = []
        self.wall = WallClock(reactor.now, follows=not reactor.clock.is_manual)  # Unix time
        self.in_virtual_time = False
        self.commander: str | None = None
        self.missing_programs: Mapping[str, str] = {}
        """Helper programs that have ended unexpectedly, such as the web page, with the consequence of each."""
        self.latch = StopLatch(self.report)
        self.truth = TruePoseTracker()  # true poses of the bases in a simulation
        self.pacer = Pacer(reactor, setup.cycle_ns)
        self.pacer.phase.behind_ns = setup.phase_ns
        assembly = Assembly(setup, reactor, self.report, self._on_bus_lost, self.pacer.lead)
        self.registry, self.buses, self.nodes = assembly.registry, assembly.buses, assembly.nodes
        self.sensed = assembly.sensed  # worlds that provide values of simulated sensors
        self.joints, self.systems, self._bus_by_node = assembly.joints, assembly.systems, assembly.bus_by_node
        self.manager = ControllerManager(
            self.registry,
            setup.update_rate,
            cycle=setup.cycle_ns / 1e9,
            joints=setup.description.movable_joints,
            geometry=WheelGeometry(setup.description.model),
            description=setup.description.joints,
            enable_status=DriveEnableStatus(self.joints),
        )
        self.cycle = RobotCycle(self.pacer, assembly, self.manager, reactor, self)
        self.pacer.on_edge = self.cycle.step
        self._phase = RobotState.STARTING
        self.advances = True
        self._booted = self._activated = self._was_latched = False
        self._deadline = self._stopping_until = 0
        self._requests: list[PendingAxisRequest] = []
        if setup.controllers.manager.enforce_command_limits:
            self.manager.limiter = CommandLimits(setup.description, self.registry)
        prepare_controllers(setup, self.manager, self.registry)
        self.manager.observe(self)
        self.node_readings = NodeReadings(self.nodes, self._bus_by_node, self.joints.values(), self.systems)
        self.mandatory_nodes = MandatoryNodes(
            assembly, self.latch, self.manager.running.forget, self.report, self.observers
        )

    # ------------------------------------------------------------------------------------------- start and end

    @property
    def state(self) -> RobotState:
        """State of the robot; FAULT while it runs with a fault as defined by `in_fault`."""
        return self._state(self._waiting())

    @property
    def hint(self) -> str | None:
        """Advice if the robot does not start or does not follow commands, else None."""
        return self._hint(self._waiting())

    @property
    def state_and_hint(self) -> tuple[RobotState, str | None]:
        """State and hint together, so that the drives are evaluated only once."""
        waiting = self._waiting()
        return self._state(waiting), self._hint(waiting)

    def _waiting(self) -> list[JointDrive]:
        return claimed_off(self.joints.values()) if self._phase is RobotState.RUNNING else []

    def _state(self, waiting: list[JointDrive]) -> RobotState:
        if self._phase is not RobotState.RUNNING:
            return self._phase
        if in_fault(self.nodes.values(), self.joints.values()):
            return RobotState.FAULT
        return RobotState.DISABLED if waiting else RobotState.RUNNING

    def _hint(self, waiting: list[JointDrive]) -> str | None:
        if self._phase is RobotState.STARTING:  # STOP delays the start
            return self.latch.hint or self._boot_error() or self._silent_hint()
        if self._phase is not RobotState.RUNNING:
            return None
        return self.mandatory_nodes.hint or enable_hint(waiting)

    def _boot_error(self) -> str | None:
        """Return the error of a required node that is not ready, or None."""
        errors = (node.error for node in self.nodes.values() if node.config.required and not node.ready)
        return next((error for error in errors if error), None)

    def _silent_hint(self) -> str | None:
        """Return a sentence about OPERATIONAL drives that have not sent a statusword, or None."""
        silent = [
            joint.node.name
            for joint in self.joints.values()
            if joint.statusword is None and self.nodes[joint.node.name].nmt_state is NmtState.OPERATIONAL
        ]
        if not silent:
            return None
        names = ", ".join(dict.fromkeys(silent))
        if not any(bus.config.master.sync_period for bus in self.buses.values()):
            return f"no TPDO with the statusword of {names} was received: no SYNC is sent; set sync_period in bus.yml"
        return f"no TPDO with the statusword of {names} was received; see: canopen-control trace --service pdo"

    def join(self) -> None:
        """Open the bus channels before `start`, to record boot-up messages of the nodes.

        Raise BusError if that fails.
        """
        self._with_buses(RobotBus.join)

    def has_heard(self, names: Iterable[str]) -> bool:
        """Whether all these nodes have sent a boot-up message since `join`."""
        nodes = [self.nodes[name] for name in names]
        return all(node.node_id in self.bus_of(node).booted_up for node in nodes)

    def start(self) -> None:
        """Open the buses if necessary, boot the nodes and start the cycle.

        Raise BusError if a channel cannot be opened.
        """
        if self._phase is not RobotState.STARTING:
            return  # the robot was shut down before the start
        self._with_buses(RobotBus.open)
        if self.failure is not None:
            return  # a bus was lost again, which has been reported
        now = self.reactor.now()
        for kind, level, text in self.setup.notices:
            self.report(Event(now, kind, "", text, level))
        for bus in self.buses.values():
            bus.network.start(now)
            bus.send_waiting()
        times = [bus.master.boot_time for bus in self.setup.buses.values()]
        self._deadline = now + max(times, default=0) * 1_000_000 if all(times) else _NEVER
        self.pacer.start()

    def _with_buses(self, method: Callable[[RobotBus], None]) -> None:
        """Call a method of every bus; close the robot if one call fails."""
        try:
            for bus in self.buses.values():
                method(bus)
        except BaseException:
            self.close()
            raise

    def shutdown(self, why: str) -> None:
        """Start to end the run: ramp to standstill, disable the drives, leave the buses; a second call does nothing."""
        if self._phase in (RobotState.STOPPING, RobotState.STOPPED):
            return
        now = self.reactor.now()
        self.report(Event(now, "stopping", "", f"stopping: {why}"))
        self._phase, self.advances = RobotState.STOPPING, True
        self._stopping_until = now + STOP_TIMEOUT_NS
        self.manager.running.forget(self.cycle.clock.now(), f"the robot is stopping ({why})")
        self._release_all(now)
        if not self.pacer.running:  # the cycle has not started, so it cannot finish the stop
            self._end("was stopped before it started")

    def close(self) -> None:
        """Stop the cycle and close the buses at once, without stopping the drives; pending requests fail."""
        self.pacer.stop()
        self.cycle.clock.end()
        for bus in self.buses.values():
            bus.close()
        for request in self._requests:
            request.fail("the robot has stopped")
        self._requests.clear()
        self._phase, self.advances = RobotState.STOPPED, False

    # ------------------------------------------------------------------------------------------- commands

    def report(self, event: Event) -> None:
        """Report an event to all observers; repetitions are counted and summarised."""
        self._notify(self.events.add(event))

    def _notify(self, events: Iterable[Event]) -> None:
        for event in events:
            for observer in self.observers:
                observer.event(event)

    def command(
        self,
        controller: str,
        values: Sequence[float] | Mapping[str, float],
        source: str,
        stamp: float | None = None,
        *,
        holder: object = None,
        sender: CommandSender | None = None,
    ) -> dict[str, str]:
        """Pass a command to a controller; raise ControlError if STOP is latched or the controller refuses the command.

        `stamp` is the creation time in Unix s. The command ends when `client_disconnected` is called with the `holder`;
        without a holder it ends only by its timeout. Return why joints do not follow the command, by joint name.
        """
        self._refuse_while_stopping("a command to", controller)
        self.latch.refuse("a command to", controller)
        self._require_active(controller, source)
        created_at, now = None if stamp is None else self.made_at(stamp), self.cycle.clock.now()
        idle = self.manager.command(controller, values, now, created_at, source=source, holder=holder, sender=sender)
        self.commander = source
        return idle

    @property
    def wall_offset_ns(self) -> int:
        """Offset from the reactor's time to Unix time in ns."""
        return self.wall.offset_ns

    def time_of(self, unix: float) -> int:
        """Convert Unix time in s to the robot's clock, in ns."""
        self._report_clock_step(self.wall.follow())
        return self.cycle.clock.of(round(unix * 1e9) - self.wall_offset_ns)

    def made_at(self, stamp: float) -> int:
        """Convert the Unix time stamp of a command, in s, to the robot's clock, in ns."""
        self._report_clock_step(self.wall.follow())
        return self.cycle.clock.of(self.wall.made_at(round(stamp * 1e9)))

    def _report_clock_step(self, moved: int) -> None:
        if moved:
            self.report(Event(self.reactor.now(), "clock_step", "", step_words(moved), Level.WARNING))

    def send_goal(
        self, controller: str, goal: AnyGoal, source: str, *, holder: object = None, sender: CommandSender | None = None
    ) -> None:
        """Pass a goal to a controller; the goal ends when the client `holder` disconnects.

        Raise ControlError if refused.
        """
        self._refuse_while_stopping("a goal to", controller)
        self.latch.refuse("a goal to", controller)
        self._require_active(controller, source)
        self.manager.send_goal(controller, goal, self.cycle.clock.now(), source=source, holder=holder, sender=sender)
        self.commander = source

    def _refuse_while_stopping(self, *request: str) -> None:
        """Raise ControlError while the robot stops: an enabled drive would keep the stop from completing."""
        if self._phase in (RobotState.STOPPING, RobotState.STOPPED):
            raise ControlError(f"{' '.join(request)} is refused: the robot is stopping")

    def _require_active(self, controller: str, source: str) -> None:
        """Raise ControlError for an inactive controller, and report the refusal as an event."""
        try:
            require_active(self.setup, self.manager, controller)
        except ControlError as error:
            self.manager.report_refusal(controller, error, source)
            raise

    def client_disconnected(self, holder: object, why: str = "is gone") -> None:
        """End commands and actions of a disconnected client; `why` completes the event text about the client."""
        self.manager.running.client_disconnected(holder, why)
        now = self.reactor.now()
        for names in filter(None, [request.abandon(holder, now) for request in self._requests]):
            text = f"the client that enables or homes {', '.join(names)} {why}, so its drives are stopped and disabled"
            self.report(Event(now, "commander_gone", "", text, Level.WARNING))

    def switch(self, activate: Sequence[str], deactivate: Sequence[str], *, strict: bool) -> None:
        """Switch controllers; new ones are loaded and configured first. ControlError, before any change, if refused."""
        if activate:
            self._refuse_while_stopping("activating", ", ".join(activate))
        switch_controllers(
            self.setup, self.manager, activate, deactivate, strict=strict, check=self.mandatory_nodes.check_controllers
        )

    def stop(self, done: Callable[[str | None], None], latched_by: str | None = None, by: str = "a client") -> None:
        """Ramp all drives to standstill, then disable them; call `done(error)` when this has succeeded or failed.

        `latched_by` names the client that latches STOP (see `StopLatch`), None for a stop without a latch; `by` names
        the client in the events of the commands that end.
        """
        now = self.reactor.now()
        if latched_by is None:
            self.report(Event(now, "stop", "", "stop was commanded", Level.WARNING))
        else:
            self.latch.hold(latched_by, now)
        self.manager.running.forget(self.cycle.clock.now(), f"stop was commanded by {latched_by or by}")
        for system in self.systems:
            system.stop(now)
        self._requests.append(
            PendingAxisRequest(tuple(self.joints.values()), Action.DISABLE, now + STOP_TIMEOUT_NS, done)
        )

    def axis(
        self,
        action: Action,
        name: str,
        done: Callable[[str | None], None],
        *,
        joint: str | None = None,
        method: int | None = None,
        mode: str | None = None,
        holder: object = None,
    ) -> str:
        """Start an action on the axes of a node or of "all"; `done(error)` is called when it has ended.

        Raise ControlError if the action is refused. The action includes all axes of a base; returns a text that names
        the added axes, and the axes that "all" cannot enable, or "". `joint` selects one of several axes of a node.
        `method` is the homing method (None: the method in 0x6098), `mode` the mode of operation by name or number.
        An unfinished enabling or homing ends when `client_disconnected` is called with its `holder`.
        """
        now = self.reactor.now()
        if action in MOVING_ACTIONS:
            self._refuse_while_stopping("axis", action.value)
        self.mandatory_nodes.check_action(action)
        axes, omitted = without_target(axes_of(self.nodes, self.joints.values(), name, joint), action, name)
        joints, together = whole_bases(axes, action)
        extra_ns = begin_action(action, joints, self.systems, now, method=method, mode=mode)
        if action in EXCLUSIVE_ACTIONS:
            self.manager.running.exclude([joint_drive.joint for joint_drive in joints], self.cycle.clock.now())
        deadline = now + REQUEST_TIMEOUT_NS + extra_ns
        self._requests.append(PendingAxisRequest(joints, action, deadline, done, holder))
        if together:
            self.report(Event(now, "together", "", together))
        return "; ".join(filter(None, [together, no_target(omitted) if omitted else ""]))

    def touch_probe(self, name: str, done: Callable[[dict[str, int] | str], None]) -> None:
        """Read the touch probes of a node's first axis; `done` receives the values by name, or an error text."""
        ProbeReading(axes_of(self.nodes, self.joints.values(), name)[0].axis, done)

    def node(self, name: str) -> RemoteNode:
        """Return the node with this name or node-ID; raise UnknownName if it does not exist."""
        return find_node(self.nodes, name)

    def bus_of(self, node: RemoteNode) -> RobotBus:
        """Return the bus of a node."""
        return self._bus_by_node[node.name]

    # ------------------------------------------------------------------------------------------- cycle

    def after_cycle(self, now: int) -> None:
        pacer, manager, wall = self.pacer, self.manager, self.wall
        if now >= wall.next_follow and (moved := wall.follow_if_due(now)):
            self._report_clock_step(moved)
        if self._requests:
            self._requests = [request for request in self._requests if not request.settle(now)]
        if pacer.missed != pacer.reported and (missed := pacer.newly_missed(now)):
            lateness, cost = pacer.late_max / 1e6, cost_of_skipping(self.joints.values())
            text = f"a cycle was missed (maximum lateness {lateness:.0f} ms){cost}; is the computer busy?"
            self.report(Event(now, "cycle_missed", "", text, Level.WARNING, count=missed))
        for event in manager.events() if manager.new_events else ():
            level = _CONTROLLER_LEVELS.get(event.kind, Level.WARNING)
            self.report(Event(now, event.kind, "", event.text, level, controller=event.controller))
        if now >= self.events.due:
            self._notify(self.events.tick(now))
        for observer in self.observers:
            observer.after_cycle(now)

    def advance(self, now: int) -> None:
        if self._phase is RobotState.STARTING:
            self._advance_start(now)
        elif self._phase is RobotState.STOPPING:
            self._advance_stop(now)

    def _advance_start(self, now: int) -> None:
        """Activate the controllers once all required nodes are ready, then report that the robot runs.

        The run fails if a required node is not ready in time.
        """
        missing = [node for node in self.nodes.values() if node.config.required and not node.ready]
        self._was_latched |= self.latch.held
        if not missing and not self._booted:
            self._booted = True
            for observer in self.observers:
                observer.booted()
        if not missing and not self._activated and not self.latch.held:
            self._activated = True
            self._deadline = now + REQUEST_TIMEOUT_NS
            self._activate()
            for system in self.systems if self._was_latched else ():
                system.stop(now)  # releasing STOP must not enable drives
        elif self._activated and (startup_complete(self.nodes.values(), self.joints.values()) or now > self._deadline):
            self._phase, self.advances = RobotState.RUNNING, False
            self.report(Event(now, "running", "", f"{self.setup.name} runs: {self.setup.runs}"))
            self.has_run = True
            for observer in self.observers:
                observer.running()
        elif missing and now > self._deadline:
            self.fail(why_not_started(self.buses.values(), [(self.bus_of(node), node) for node in missing]))

    def _advance_stop(self, now: int) -> None:
        """End the run when all drives have stopped, or after `STOP_TIMEOUT_NS`."""
        late = now > self._stopping_until
        asked, waits = disable_unready(self.nodes.values(), now)
        for bus in {self.bus_of(node) for node in asked}:
            bus.send_waiting()
        if not late and (waits or not all(system.stopped for system in self.systems)):
            return
        if late:
            self.report(Event(now, "stop_timeout", "", "the drives did not confirm the stop in time", Level.ERROR))
        # before the NMT reset clears the statuswords
        how, powered = stop_summary(self.joints.values(), self.nodes.values())
        if late or powered:
            first = "the drives did not confirm the stop in time; " if late else ""
            self.failure = self.failure or f"{first}{how}; check the drives before you approach the robot"
        else:
            self._requests = [request for request in self._requests if not request.confirm_stop()]
        for bus in self.buses.values():
            bus.release_nodes(powered)
        self._end(f"has stopped, {how}" if how else "has stopped")

    def end_without_cycle(self) -> None:
        if self._phase is RobotState.STOPPING:
            self._end("has ended without a confirmation of the stop; check the drives before you approach the robot")

    def _end(self, how: str) -> None:
        self._notify(self.events.flush())
        self.report(Event(self.reactor.now(), "stopped", "", f"{self.setup.name} {how}"))
        self.close()
        self._notify_stopped()

    def _notify_stopped(self) -> None:
        for observer in self.observers:
            observer.stopped()

    def _activate(self) -> None:
        """Activate the hardware components, then load, configure and activate the initial controllers."""
        try:
            for component in self.registry.components:
                component.configure()
                component.activate()
            self.switch(self.setup.to_activate, (), strict=True)
        except CanopenError as error:
            self.fail(str(error))

    def fail(self, text: str) -> None:
        self.failure = self.failure or text
        self.report(Event(self.reactor.now(), "failed", "", text, Level.ERROR))
        self.shutdown("the run failed")

    def controllers_switched(self) -> None:
        """Update the stop groups of the active base controllers; stop a base that is only partly enabled."""
        merge_base_groups(self.joints.values(), self.manager.bases, self.reactor.now())
        for system in self.systems:
            system.refresh_groups()

    def _release_all(self, now: int) -> None:
        try:
            self.manager.switch(deactivate=self.manager.active, strict=False)
        except CanopenError as error:
            self.report(Event(now, "error", "", str(error), Level.ERROR))
        for system in self.systems:
            system.stop(now)

    def _on_bus_lost(self, error: BusError) -> None:
        """End the run after a bus was lost: stop the drives of the other buses; those of this bus stop on their own."""
        self.failure = self.failure or str(error)
        if self.pacer.running and any(bus.port is not None for bus in self.buses.values()):
            self.reactor.call_soon(self._stop_without_bus)
            return
        self.close()
        self.reactor.call_soon(self._notify_stopped)

    def _stop_without_bus(self) -> None:
        for bus in self.buses.values():
            if bus.port is None:
                bus.network.bus_failed(f"bus {bus.name} was lost", self.reactor.now())
        self.shutdown(f"a bus was lost: {self.failure}")


_CONTROLLER_LEVELS = {"error": Level.ERROR, **dict.fromkeys(("activated", "deactivated", "parameter_set"), Level.INFO)}
