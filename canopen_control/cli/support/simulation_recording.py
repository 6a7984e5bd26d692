"""Recordings for `simulate`: writes a flight recording of a simulation, and reads a scenario from a recording.

A recording of a simulation has the format of a robot's flight recorder, but covers the whole simulation; times are
virtual times.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import ConfigError
from canopen_control.rpc.messages import robot as messages
from canopen_control.rpc.messages.robot import ROBOT, RequestSeen
from canopen_control.rpc.messages.samples import TrajectoryPoint
from canopen_control.rpc.messages.trajectory import SetTrajectory
from canopen_control.rpc.wire import Raw, text_of
from canopen_control.runtime.node_readings import event_message
from canopen_control.runtime.status import layout_message, state_sample, status_message
from canopen_control.simulation.recorded_scenario import RecordedRobot, scenario_of_recording
from canopen_control.simulation.robot_under_test import SimulationObserver
from canopen_control.trace.flight_file import (
    NO_FAULT,
    FlightMeta,
    KeptFrame,
    candump_lines,
    is_fault,
    is_flight_file,
    is_sum,
    read_flight,
    write_flight,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from canopen_control.master.event_log import Event
    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.state import RobotEvent
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.simulation.scenario_steps import Scenario
    from canopen_control.simulation.simulation_run import SimulationRun
    from canopen_control.virtual.scenario import ScenarioEvent


_SAMPLE_NS: Final = 100_000_000


def check_recording_name(path: Path) -> None:
    """Raise ConfigError if `path` is not the name of a flight recording, or cannot be written."""
    if not is_flight_file(path):
        raise ConfigError(f"--record {path}: a recording of a simulation is a flight recording, as {path.stem}.zip")
    if path.is_dir():
        raise ConfigError(f"--record {path}: this is a folder; give the name of a file in it")
    if not os.access(path.parent, os.W_OK):
        raise ConfigError(f"--record {path}: {path.parent} does not exist or is not writable; choose another folder")


class SimulationRecorder(SimulationObserver):
    """Observer that records a simulation from the beginning; call `write` at the end."""

    def __init__(self, simulation: SimulationRun) -> None:
        self._run, self._robot = simulation, simulation.robot
        self._frames: list[KeptFrame] = []
        self._events: list[RobotEvent] = []
        self._lines: list[bytes] = []
        self._requests: list[bytes] = []
        for number, wire in enumerate(self._robot.wires.values()):
            wire.listeners.append(self._recorder(number))
        self._robot.time.later(_SAMPLE_NS, self._sample)
        self._robot.observers.append(self)

    def _recorder(self, number: int) -> Callable[[int, str, bytes], object]:
        def record_frame(now: int, _label: str, record: bytes) -> None:
            self._frames.append(KeptFrame(now, number, record))

        return record_frame

    def _sample(self) -> None:
        if self._robot.up:
            self._lines.append(text_of(state_sample(self._robot.core)))
        self._robot.time.later(_SAMPLE_NS, self._sample)

    def event(self, event: Event) -> None:
        self._events.append(event_message(event, self._robot.core.wall_offset_ns))

    def requested(self, now: int, act: ScenarioEvent) -> None:
        """Record the client requests that correspond to a scenario event."""
        for request in _requests_of(act, self._robot.core.manager.states):
            method = ROBOT.of(type(request)).name
            self._requests.append(text_of(RequestSeen(now / 1e9, method, Raw(text_of(request)))))

    def write(self, path: Path) -> None:
        """Write the flight recording to `path`; raise ConfigError or DiskFull if that fails."""
        core = self._robot.core
        faults = [event for event in self._events if is_fault(event) and not is_sum(event)]
        meta = FlightMeta(
            robot=self._robot.setup.name,
            reason=faults[0] if faults else NO_FAULT,
            written=self._robot.now_ns / 1e9,
            begin=self._run.began_ns / 1e9,
            buses={name: wire.channel for name, wire in self._robot.wires.items()},
            layout=layout_message(core),
            status=status_message(core),
        )
        can = candump_lines(self._frames, list(self._robot.wires), 0)
        write_flight(path, meta, can, [text_of(event) for event in self._events], self._lines, self._requests)


def _requests_of(act: ScenarioEvent, active: Mapping[str, str]) -> list[Request[Any]]:
    """Return the requests with which a client causes a scenario event; [] if clients cannot cause it."""
    name, values = act.target, list(act.values)
    controllers = [name for name, state in active.items() if state == "active" and "broadcaster" not in name]
    if act.kind == "command":
        return [messages.CommandController(controller=name, values=values)]
    if act.kind == "trajectory":
        point = TrajectoryPoint(positions=values, time_from_start=(act.for_ns or _SAMPLE_NS) / 1e9)
        joints = [str(number) for number in range(len(values))]
        return [SetTrajectory(controller=name, joints=joints, points=[point])]
    if act.kind in ("stop", "latch"):
        return [messages.Stop(latch=act.kind == "latch")]
    if act.kind == "release":
        return [messages.Release()]
    if act.kind == "axis":
        return [messages.AxisRequest(action=act.name, node=name or "all")]
    if act.kind == "activate":
        return [messages.SwitchControllers(activate=(name,), deactivate=tuple(controllers))]
    return [messages.SwitchControllers(deactivate=(name,))] if act.kind == "deactivate" else []


def recorded_scenario(path: Path, setup: RobotSetup) -> Scenario:
    """Return the scenario of a flight recording, or of recorded frames if the robot has one bus."""
    if is_flight_file(path):
        file = read_flight(path)
        active = tuple(file.states[0].active) if file.states else ()
        return scenario_of_recording(RecordedRobot(file.frames, file.events, file.requests, active), setup)
    from canopen_control.bus.recordings import Recording

    if len(setup.buses) > 1:
        raise ConfigError(f"{path} contains one bus, and {setup.name} has {len(setup.buses)}; use a flight recording")
    [bus] = setup.buses
    recording = Recording(path)
    frames = [(now, bus, frame) for now, frame in recording]
    if problem := recording.mixture or recording.problem:
        raise ConfigError(problem)
    return scenario_of_recording(RecordedRobot(frames), setup)
