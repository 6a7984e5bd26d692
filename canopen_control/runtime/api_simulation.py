"""The API's methods about a simulation: pause it, let it go on, step it, bring it back, let something happen in it.

The law of the file: only a robot without buses can be simulated so, since drives have a time of their own. What resumes
or resets takes every command back, so that what moves next was commanded since.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, get_args

from canopen_control.errors import ControlError
from canopen_control.master.event_log import Event
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.messages.drive import AddPayload, BlockJoint, PushRobot, WorldAct
from canopen_control.rpc.messages.simulation import (
    GetLaserScans,
    GetSimulation,
    PauseSimulation,
    ResetSimulation,
    Simulation,
    StepSimulation,
)
from canopen_control.runtime.status import simulated_seconds

if TYPE_CHECKING:
    from canopen_control.hardware.interfaces import HardwareComponent
    from canopen_control.rpc.messages.robot import RobotHello, RobotPush
    from canopen_control.rpc.server import Call, Server
    from canopen_control.runtime.core import RobotCore
    from canopen_control.runtime.robot_clock import RobotClock

__all__ = ["SimulationMethods"]

_HEAVIEST: Final = "the heaviest link"


class SimulationMethods:
    """Answers them on a server."""

    def __init__(self, robot: RobotCore, server: Server[RobotHello, RobotPush]) -> None:
        self._robot = robot
        server.answers(GetSimulation, self._get)
        server.answers(GetLaserScans, self._scan)
        server.answers(PauseSimulation, self._pause)
        server.answers(StepSimulation, self._step)
        server.answers(ResetSimulation, self._reset)
        for kind in get_args(WorldAct):
            server.answers(kind, self._act)

    def _clock(self) -> RobotClock:
        """Return the clock of the robot; ControlError if its time is not the simulation's."""
        robot = self._robot
        if robot.cycle.clock.simulated:
            return robot.cycle.clock
        on_bus = f"{robot.setup.name} has drives on a bus, whose time does not stand" if robot.buses else ""
        why = on_bus or f"nothing of {robot.setup.name} is simulated, its joints are mocked"
        raise ControlError(f"{why}; a simulation plugin without drives can be paused, stepped and reset")

    def _told(self) -> Simulation:
        robot, clock = self._robot, self._clock()
        seconds = simulated_seconds(robot) or 0.0
        period = robot.pacer.period_ns / 1e9
        return Simulation(seconds=seconds, paused=clock.paused, period=period, changeable=bool(self._worlds()))

    def _worlds(self) -> list[HardwareComponent]:
        """Return what physics moves: one at most."""
        return [component for component in self._robot.registry.components if component.changeable]

    def _get(self, call: Call[GetSimulation]) -> None:
        call.reply(self._told())

    def _scan(self, call: Call[GetLaserScans]) -> None:
        call.reply(tuple(scan for component in self._robot.registry.components for scan in component.scan()))

    def _pause(self, call: Call[PauseSimulation]) -> None:
        clock = self._clock()
        if call.request.paused and not clock.paused:
            clock.pause()
            self._tell("paused", f"the simulation was paused by {call.who}")
        elif clock.paused and not call.request.paused:
            self._robot.manager.running.forget(clock.now(), "the simulation was paused; command anew")
            clock.resume()
            self._tell(
                "resumed", f"the simulation goes on, {call.who} asked for it; commands from before are forgotten"
            )
        call.reply(self._told())

    def _step(self, call: Call[StepSimulation]) -> None:
        def done(error: str | None) -> None:
            if error is None:
                call.reply(self._told())
            else:
                call.refuse(ControlError(error))

        clock = self._clock()
        if not clock.paused:
            raise ControlError("the simulation is not paused, so that it cannot be stepped; pause it first")
        clock.step(call.request.steps, done)

    def _act(self, call: Call[Any]) -> None:
        """Let something happen in the world of a simulation plugin; a joint that is blocked has no drive to be told."""
        self._clock()
        worlds = self._worlds()
        if not worlds:
            name = self._robot.setup.name
            raise ControlError(f"simple motors move {name}; physics comes with pip install 'canopen-control[physics]'")
        for component in worlds:
            component.act(call.request)
        self._tell("world", f"{_told(call.request)}, {call.who} asked for it")
        call.reply(Done())

    def _reset(self, call: Call[ResetSimulation]) -> None:
        self._clock()
        robot, manager = self._robot, self._robot.manager
        for component in robot.registry.components:
            component.reset(call.request.keyframe)
        active = manager.active
        manager.switch(activate=active, deactivate=active)  # they hold and count from where the joints are now
        for name in manager.bases:
            manager.get(name).set_odometry(0.0, 0.0, 0.0)
        robot.truth.align()
        where = f"key frame {call.request.keyframe}" if call.request.keyframe else "where it began"
        self._tell("reset", f"the simulation was reset to {where} by {call.who}")
        call.reply(self._told())

    def _tell(self, kind: str, text: str) -> None:
        self._robot.report(Event(self._robot.reactor.now(), kind, "", text))


def _told(act: WorldAct) -> str:
    """Say what happens, as an event."""
    if isinstance(act, BlockJoint):
        return f"{act.joint} is {'blocked' if act.on else 'let go'}"
    if isinstance(act, AddPayload):
        return f"a payload of {act.mass:g} kg is put on {act.on or _HEAVIEST}"
    if isinstance(act, PushRobot):
        return f"{act.on or _HEAVIEST} is pushed with {', '.join(f'{each:g}' for each in act.force)} N"
    return f"the floor has a friction of {act.friction:g}"
