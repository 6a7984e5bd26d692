"""Player of a schedule on a simulated robot: client requests, and faults of drives, buses and processes.

Clients use the functions behind the runtime's API, and renew a command ten times a second; refusals are counted. Times
are in ns from the start.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

from canopen_control.bus.frame_router import DropRule
from canopen_control.controllers.trajectory.goal import TrajectoryGoal
from canopen_control.controllers.trajectory.point import JointTrajectory, Point
from canopen_control.errors import CanopenError, ControlError, NotEnabled
from canopen_control.frame import CanFrame
from canopen_control.hardware.axis_statechart import Action
from canopen_control.rpc.messages.drive import BlockJoint
from canopen_control.runtime.core import RobotCore
from canopen_control.simulation.fault_coverage import kind_of, state_reached
from canopen_control.simulation.robot_under_test import MASTER
from canopen_control.simulation.scenario_events import KINDS
from canopen_control.simulation.simulated_clients import SimulatedClients

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.simulation.robot_under_test import RobotUnderTest
    from canopen_control.simulation.simulated_wire import SimulatedWire
    from canopen_control.simulation.virtual_time import Actor
    from canopen_control.virtual.scenario import ScenarioEvent


SOURCE: Final = "simulate"
PUBLISH_NS: Final = 100_000_000
_CHECK_NS: Final = 1_000_000  # interval of checking the state that an event waits for
_BRIEFLY_NS: Final = 100_000_000
_COMMANDS: Final = frozenset({"command", "trajectory"})


class EventPlayer:
    """Player of scheduled events; `played` lists the started events, `refused` counts refused requests.

    `troubles` counts the faults by kind and by the state of the robot. The robot's `observers` are called. `torn`
    describes switches of controllers that were refused although they changed which controllers are active.
    """

    def __init__(self, robot: RobotUnderTest) -> None:
        self.robot = robot
        self.played: list[ScenarioEvent] = []
        self.refused = 0
        self.mistakes: list[ControlError] = []
        """Refusals of commands that are errors of the schedule, and not due to disabled drives or a latched STOP."""
        self._requested: set[int] = set()  # ids of events that have sent a request; all of them are in `played`
        self.troubles: Counter[tuple[str, str]] = Counter()
        self.torn: list[str] = []
        self.clients = SimulatedClients(robot)
        self._publishing: dict[str, int] = {}  # controller -> number of its newest publisher
        self._down = False

    def plan(self, acts: Iterable[ScenarioEvent]) -> None:
        """Schedule events relative to the current virtual time."""
        start = self.robot.time.now_ns
        for act in acts:
            self.robot.time.at(start + act.at_ns, partial(self.play, act))

    def play(self, act: ScenarioEvent) -> None:
        """Execute an event when the state in its `when` is reached, or at once without `when`."""
        if not state_reached(self.robot, act):
            self._later(_CHECK_NS, partial(self.play, act))
            return
        self.played.append(act)
        for observer in self.robot.observers:
            observer.played(self.robot.now_ns, act)
        if KINDS[act.kind].breaks:
            self.troubles[kind_of(act), self.robot.core.state.value] += 1
        _PLAY[act.kind](self, act)

    def requested(self, act: ScenarioEvent) -> None:
        """Notify the observers of a client request."""
        for observer in self.robot.observers:
            observer.requested(self.robot.now_ns, act)

    # -- drives

    def switch(self, act: ScenarioEvent) -> None:
        """Switch a fault or quirk of a drive, or set values of its plant; undo it after `for_ns`, if given."""
        self._ask_drive(act, on=True)
        if act.for_ns is not None:
            self._later(act.for_ns, partial(self._ask_drive, act, on=False))

    def _ask_drive(self, act: ScenarioEvent, *, on: bool) -> None:
        request = act.request(on=on)
        if request is not None:
            self.robot.drives[int(act.target)].do(lambda methods: methods.do(request))

    def power(self, act: ScenarioEvent) -> None:
        """Switch the supply of a drive off, and on again after `for_ns`, if given."""
        drive = self.robot.drives[int(act.target)]
        drive.power_off()
        if act.for_ns is not None:
            self._later(act.for_ns, drive.power_on)

    def world(self, act: ScenarioEvent) -> None:
        """Apply a disturbance to the physics world; a blocked joint is released after `for_ns`, if given."""
        floor, release = self.robot.floor, act.request(on=False)
        if floor is None or act.world is None:
            return
        floor.act(act.world)
        if act.for_ns is not None and isinstance(release, BlockJoint):
            self._later(act.for_ns, partial(floor.act, release))

    # -- processes

    def stall(self, act: ScenarioEvent) -> None:
        """Stall the process of the robot or of a drive for `for_ns`."""
        actor = self._actor(act.target)
        if actor is not None:
            actor.stall(act.for_ns or _BRIEFLY_NS)

    def kill(self, act: ScenarioEvent) -> None:
        """Kill the robot's process, and restart it after `for_ns`, if given."""
        if self._down:
            return
        self._down = True
        self.robot.kill()
        if act.for_ns is not None:
            self._later(act.for_ns, self._restart)

    def _restart(self) -> None:
        self._down = False
        self.robot.restart()

    def _actor(self, target: str) -> Actor | None:
        return self.robot.host if target == MASTER else self.robot.drives[int(target)].actor

    # -- buses

    def cut(self, act: ScenarioEvent) -> None:
        """Cut the cable of the robot or of a drive, and repair it after `for_ns`, if given."""
        for wire, label in self._members(act.target):
            wire.cut.add(label)
            if act.for_ns is not None:
                self._later(act.for_ns, partial(wire.cut.discard, label))

    def bus_off(self, act: ScenarioEvent) -> None:
        """Put the CAN controller of the robot or of a drive into bus-off for `for_ns`."""
        for wire, label in self._members(act.target):
            wire.bus_off(label, act.for_ns or _BRIEFLY_NS)

    def disturb_frames(self, act: ScenarioEvent) -> None:
        """Lose, double or disturb every n-th frame of a member or of all; n is the first value, 1 by default."""
        for wire, label in self._members(act.target):
            rules = {"lose": wire.lost, "double": wire.doubled, "disturb": wire.disturbed}[act.kind]
            rule = DropRule(label, every=int(act.values[0]) if act.values else 1)
            rules.append(rule)
            if act.for_ns is not None:
                self._later(act.for_ns, partial(rules.remove, rule))

    def frame(self, act: ScenarioEvent) -> None:
        """Send a frame with the identifier and data bytes in `values` on every bus."""
        can_id, *data = (int(value) for value in act.values)
        for wire in self.robot.wires.values():
            wire.inject(CanFrame(can_id, bytes(data)))

    def _members(self, target: str) -> list[tuple[SimulatedWire, str]]:
        if target == MASTER:
            return [(wire, MASTER) for wire in self.robot.wires.values()]
        if not target:
            return [(wire, "") for wire in self.robot.wires.values()]
        drive = self.robot.drives[int(target)]
        return [(drive.wire, drive.label)]

    # -- clients

    def command(self, act: ScenarioEvent) -> None:
        """Publish a command repeatedly for its duration; a newer command to the controller replaces it."""
        turn = self._publishing[act.target] = self._publishing.get(act.target, 0) + 1
        self._publish(act, turn, self.robot.now_ns + (act.for_ns or 0))

    def _publish(self, act: ScenarioEvent, turn: int, until_ns: int) -> None:
        if self._publishing[act.target] != turn:
            return
        self._ask(act, lambda core: self._command(core, act))
        if self.robot.now_ns + PUBLISH_NS < until_ns:
            self._later(PUBLISH_NS, lambda: self._publish(act, turn, until_ns))

    def _command(self, core: RobotCore, act: ScenarioEvent) -> None:
        core.command(act.target, act.values, SOURCE)
        for observer in self.robot.observers:
            observer.applied(self.robot.now_ns, act)

    def trajectory(self, act: ScenarioEvent) -> None:
        """Send a trajectory that ends at standstill."""
        joints = self.robot.core.manager.get(act.target).joints if act.target in self.robot.core.manager.states else ()
        width = len(act.values) // max(1, len(act.times))
        zeros = [0.0] * width
        if act.times:
            parts = [act.values[at : at + width] for at in range(0, len(act.values), max(1, width))]
            points = [Point(part, time=round(at * 1e9)) for part, at in zip(parts, act.times, strict=False)]
            points[-1].velocities = zeros
        else:
            points = [Point(act.values, zeros, time=act.for_ns or PUBLISH_NS)]
        self._ask(act, lambda core: self._send(core, act, TrajectoryGoal(JointTrajectory(joints, points))))

    def _send(self, core: RobotCore, act: ScenarioEvent, goal: TrajectoryGoal) -> None:
        core.send_goal(act.target, goal, SOURCE)
        for observer in self.robot.observers:
            observer.goal(self.robot.now_ns, act, goal)

    def cancel(self, act: ScenarioEvent) -> None:
        self._ask(act, lambda core: core.manager.follower(act.target).cancel_goal())

    # -- clients of the robot's socket

    def connect(self, act: ScenarioEvent) -> None:
        """Connect clients that send nothing, never read, or request the status; no effect while the robot is down."""
        if self._down or not self.robot.up:
            return
        if act.kind == "silent":
            self.clients.silent(int(act.values[0]) if act.values else 1, act.for_ns)
        elif act.kind == "deaf":
            self.clients.deaf(act.for_ns)
        else:
            self.clients.ask(act.for_ns)

    def dead_man(self, act: ScenarioEvent) -> None:
        """Send a command that ends with its client's connection, and disconnect after `for_ns`."""
        if self._down or not self.robot.up:
            return
        self.requested(replace(act, kind="command", name=act.kind))
        on_left = partial(self._left, act)
        self.clients.dead_man(act.target, act.values, act.for_ns or _BRIEFLY_NS, on_left)

    def _left(self, act: ScenarioEvent) -> None:
        self.requested(replace(act, kind="leave"))

    def stop(self, act: ScenarioEvent) -> None:
        self._ask(act, lambda core: core.stop(_ignore, by=SOURCE))

    def latch(self, act: ScenarioEvent) -> None:
        self._ask(act, lambda core: core.stop(_ignore, SOURCE, SOURCE))

    def release(self, act: ScenarioEvent) -> None:
        self._ask(act, lambda core: core.latch.release(SOURCE, core.reactor.now()))

    def axis(self, act: ScenarioEvent) -> None:
        self._ask(act, lambda core: core.axis(Action(act.name), act.target or "all", _ignore))

    def activate(self, act: ScenarioEvent) -> None:
        """Activate a controller and deactivate all other active controllers except broadcasters."""
        self._ask(act, lambda core: self._switch_whole(core, act, partial(self._switch_to, core, act.target)))

    def _switch_to(self, core: RobotCore, name: str) -> None:
        active = [controller for controller in core.manager.active if not core.manager.get(controller).is_broadcaster]
        core.switch(
            [name] if name not in active else [],
            [controller for controller in active if controller != name],
            strict=True,
        )

    def deactivate(self, act: ScenarioEvent) -> None:
        switch = partial(RobotCore.switch, activate=[], deactivate=[act.target], strict=False)
        self._ask(act, lambda core: self._switch_whole(core, act, partial(switch, core)))

    def _switch_whole(self, core: RobotCore, act: ScenarioEvent, switch: Callable[[], object]) -> None:
        """Switch controllers; record in `torn` a refusal that changed the active ones, unless an activation failed."""
        before = _active(core)
        try:
            switch()
        except CanopenError as error:
            # a failed activation ends the request; controllers stopped for it stay inactive
            if _active(core) != before and "could not be activated" not in str(error):
                self.torn.append(f"{act.kind} {act.target} was refused ({error}) but changed the active controllers")
            raise

    def _ask(self, act: ScenarioEvent, verb: Callable[[RobotCore], object]) -> None:
        """Send a client request to the robot; it is lost while the robot is down."""
        if self._down:
            return
        self.requested(act)
        core = self.robot.core

        def ask() -> None:
            first = id(act) not in self._requested
            self._requested.add(id(act))
            try:
                verb(core)
            except CanopenError as error:
                self.refused += 1
                off = isinstance(error, NotEnabled) or core.latch.held
                if first and act.kind in _COMMANDS and isinstance(error, ControlError) and not off:
                    self.mistakes.append(error)

        self.robot.host.call(ask)

    def _later(self, delay_ns: int, work: Callable[[], object]) -> None:
        self.robot.time.later(delay_ns, work)


def _active(core: RobotCore) -> set[str]:
    return {name for name, state in core.manager.states.items() if state == "active"}


def _ignore(_reason: str | None) -> None:
    pass


_PLAY: Final[dict[str, Callable[[EventPlayer, ScenarioEvent], None]]] = {
    **dict.fromkeys(("fault", "fault_off", "quirk", "quirk_off", "plant"), EventPlayer.switch),
    "world": EventPlayer.world,
    "power": EventPlayer.power,
    "stall": EventPlayer.stall,
    "kill": EventPlayer.kill,
    "cut": EventPlayer.cut,
    "bus_off": EventPlayer.bus_off,
    **dict.fromkeys(("lose", "double", "disturb"), EventPlayer.disturb_frames),
    "frame": EventPlayer.frame,
    "command": EventPlayer.command,
    "trajectory": EventPlayer.trajectory,
    "cancel": EventPlayer.cancel,
    **dict.fromkeys(("silent", "deaf", "ask"), EventPlayer.connect),
    "dead_man": EventPlayer.dead_man,
    "stop": EventPlayer.stop,
    "latch": EventPlayer.latch,
    "release": EventPlayer.release,
    "axis": EventPlayer.axis,
    "activate": EventPlayer.activate,
    "deactivate": EventPlayer.deactivate,
}
