"""Reader of scenario files with timed events for simulations; all errors are reported together.

    for: 20s
    seed: 7
    steps:
      - {at: 1s, do: command, target: robby_forward_controller, values: [5, 5], for: 3s}
      - {at: 2s, node: 3, fault: heartbeat_lost, for: 1s}    # as in the scenario of `drive`
      - {at: 4s, do: axis, name: enable}
      - {at: 6s, do: stall, target: master, for: 300ms}
      - {at: 8s, payload: {mass: 12}}                        # with physics only

`for` is the simulated time; `seed` determines wake-up delays of processes and frequency errors of oscillators. `do` is
one of the kinds of `scenario_events`, `target` its node-ID, `master` or controller. A step with `when`, such as `when:
axis power RAMPING_DOWN`, waits from its time on until its node, or any node, is in this state. Scenarios of `drive` are
valid too.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from canopen_control.duration import nanoseconds_of
from canopen_control.errors import ConfigError, nearest
from canopen_control.hardware.axis_statechart import AxisPhase
from canopen_control.rpc.messages.drive import AddPayload, BlockJoint, PushRobot
from canopen_control.simulation.fault_coverage import POWER, STATES
from canopen_control.simulation.robot_under_test import MASTER
from canopen_control.simulation.scenario_events import KINDS
from canopen_control.virtual.quirks import parse_quirk
from canopen_control.virtual.scenario import (
    ScenarioError,
    ScenarioEvent,
    ScenarioFile,
    ScenarioStep,
    nanoseconds_at,
    world_words,
)
from canopen_control.yamlfile.reader import load

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from canopen_control.rpc.messages.drive import WorldAct
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.yamlfile.node import Problem, Problems


ACTIONS: Final = ("enable", "disable", "halt", "quick-stop", "fault-reset")
_ACTION_KEYS: Final = "do, fault, quirk and plant (with --physics also payload, push, block and friction)"
_MOMENTS: Final = [f"{machine} {state}" for machine, states in STATES.items() for state in states]
# Names up to version 0.2, accepted with a warning: values of `do`, and states in `when`
_FORMER_KINDS: Final = {"heal": "fault_off"}
_FORMER_MOMENTS: Final = {
    f"{POWER} {former}": f"{POWER} {phase.name}"
    for former, phase in (
        ("OFF", AxisPhase.DISABLED),
        ("RISING", AxisPhase.SWITCHING_ON),
        ("RELEASED", AxisPhase.ENABLING),
        ("BRAKING", AxisPhase.RAMPING_DOWN),
        ("SETTLING", AxisPhase.AWAITING_STANDSTILL),
        ("ESCALATED", AxisPhase.FORCED_QUICK_STOP),
        ("VOLTAGE_OFF", AxisPhase.VOLTAGE_DISABLED),
        ("UNSTOPPED", AxisPhase.STOP_FAILED),
    )
}


@dataclass(frozen=True, slots=True)
class Scenario:
    """Contents of a scenario file; `duration_ns` and `seed` are None if the file does not set them."""

    acts: tuple[ScenarioEvent, ...]
    duration_ns: int | None = None
    seed: int | None = None
    warnings: tuple[str, ...] = ()


def read_scenario_steps(path: Path, setup: RobotSetup) -> Scenario:
    """Read a scenario file for a robot; ScenarioError lists all errors by line."""
    nodes = [node.node_id for bus in setup.joined.values() for node in bus.nodes.values()]
    controllers = list(setup.controllers.controllers)
    acts: list[ScenarioEvent] = []
    scenarios: list[Scenario] = []

    def check(file: ScenarioFile, _problems: Problems) -> None:
        for step in file.steps:
            acts.extend(_Checked(step, nodes, controllers, setup).acts())
        length = None if file.length is None else nanoseconds_at(file.here, file.length)
        if length == 0:
            file.here.error("for: a simulation of 0 s does nothing; write a time above 0, such as 20s")
        elif length is not None:
            _check_ends(file, length)
        scenarios.append(Scenario(tuple(sorted(acts, key=lambda act: act.at_ns)), length, file.seed))

    warnings: list[Problem] = []
    load(path, ScenarioFile, error=ScenarioError, check=check, warnings=warnings)
    return replace(scenarios[0], warnings=tuple(map(str, warnings)))


def _check_ends(file: ScenarioFile, length: int) -> None:
    """Report steps later than the end of the scenario."""
    for step in file.steps:
        with contextlib.suppress(ValueError):  # an invalid time is already reported
            if (at := nanoseconds_of(step.at)) > length:
                step.here.error(f"at: {at / 1e9:g} s is after the end of the scenario at {length / 1e9:g} s (for)")


class _Checked:
    """Step of a scenario file, checked for one robot."""

    def __init__(self, step: ScenarioStep, nodes: Sequence[int], controllers: Sequence[str], setup: RobotSetup) -> None:
        self._step, self._nodes, self._controllers, self._setup = step, nodes, controllers, setup

    def acts(self) -> Iterator[ScenarioEvent]:
        """Yield the step's events and report its errors."""
        step = self._step
        if happens := step.acts():
            yield from self._world(happens)
            return
        if step.do == "world" or not (step.do or step.fault or step.quirk or step.plant):
            step.here.error(f"a step needs one of {_ACTION_KEYS}")
            return
        kind = self._current("do", step.do, _FORMER_KINDS) or step.kind
        target = str(step.target if step.node is None else step.node)
        name = step.fault or step.quirk or step.name
        if kind not in KINDS:
            step.here.error(f"do: {kind!r} is not a kind of event{nearest(kind, KINDS)}")
            return
        self._check_target(kind, target)
        self._check_name(kind, name)
        values = step.values if KINDS[kind].values or not step.values else self._no("values", kind)
        lasts = step.for_ns
        if lasts is not None and not KINDS[kind].lasts:
            self._no("for", kind)
        if kind == "frame":
            self._check_frame()
        elif kind in ("lose", "double", "disturb") and values and not _is_count(values):
            step.here.error(f"values: {kind} needs one integer n of 1 or more, for every n-th frame")
        if step.times:
            self._check_times(kind)
        if kind == "plant":
            self._check_axis(step.axis)
        when = self._state_awaited()
        numbers, plant, times = tuple(values), tuple(step.plant.items()), tuple(step.times)
        yield ScenarioEvent(step.at_ns, kind, target, name, numbers, lasts, plant, step.axis, times, when)

    def _current(self, key: str, name: str, former: Mapping[str, str]) -> str:
        """Return the current name for a former name, with a warning; return other names unchanged."""
        if name in former:
            self._step.here.warning(f"{key}: {name} is now called {former[name]}; the former name is still accepted")
        return former.get(name, name)

    def _state_awaited(self) -> str:
        """Return the state in `when`, and report a name that is not a state."""
        when = self._current("when", self._step.when, _FORMER_MOMENTS)
        if when and when not in _MOMENTS:
            self._step.here.error(f"when: {when!r} is not a state{nearest(when, _MOMENTS)}")
        return when

    def _world(self, happens: Sequence[WorldAct]) -> Iterator[ScenarioEvent]:
        """Yield the physics disturbance of the step and report its errors, including a robot without physics."""
        step, setup = self._step, self._setup
        named = (
            step.node is not None or step.fault or step.quirk or step.plant or step.values or step.target or step.name
        )
        if len(happens) > 1 or named or step.do not in ("", "world"):
            step.here.error(
                "a step can have one of payload, push, block and friction, and besides only at, for and when"
            )
        if not setup.physics:
            step.here.error("payload, push, block and friction need a physics simulation: add --physics")
        lasts = step.for_ns
        if lasts is not None and not step.block:
            self._no("for", "payload, push and friction")
        when = self._state_awaited()
        for world_act in happens:
            self._check_part(world_act)
            yield ScenarioEvent(step.at_ns, "world", for_ns=lasts, when=when, world=world_act)

    def _check_part(self, world_act: WorldAct) -> None:
        """Report a disturbance of a link or joint that the robot does not have."""
        here, model = self._step.here, self._setup.description.model
        if isinstance(world_act, BlockJoint):
            joints = [joint.name for tag in self._setup.description.hardware for joint in tag.joints]
            if world_act.joint not in joints:
                here.error(f"block: no drive moves a joint {world_act.joint!r}{nearest(world_act.joint, joints)}")
        elif isinstance(world_act, AddPayload | PushRobot) and world_act.on and world_act.on not in model.links:
            here.error(f"on: the robot has no link {world_act.on!r}{nearest(world_act.on, list(model.links))}")

    def _no(self, key: str, kind: str) -> tuple[float, ...]:
        self._step.here.error(f"{key}: is not possible with {kind}")
        return ()

    def _check_target(self, kind: str, target: str) -> None:
        target_kind, here = KINDS[kind].target, self._step.here
        node_ids = [str(node_id) for node_id in self._nodes]
        if target_kind == "controller" and target not in self._controllers:
            here.error(f"target: the robot has no controller {target!r}{nearest(target, self._controllers)}")
        elif target_kind == "node" and target not in node_ids:
            here.error(f"{kind}: needs a node of this robot, not {target or 'none'}; available: {', '.join(node_ids)}")
        elif (
            target_kind == "member"
            and target not in (*node_ids, MASTER)
            and (target or kind in ("stall", "cut", "bus_off"))
        ):
            here.error(
                f"target: {target or 'none'} is not a member of a bus; available: {MASTER}, {', '.join(node_ids)}"
            )
        elif target_kind == "" and target and kind != "axis":
            here.error(f"target: is not possible with {kind}")

    def _check_name(self, kind: str, name: str) -> None:
        here = self._step.here
        if kind in ("fault", "fault_off"):
            self._step.check_name(name, None)
        elif kind in ("quirk", "quirk_off"):
            self._step.check_name(None, name)
            with contextlib.suppress(ConfigError):  # reported above
                self._check_axis(parse_quirk(name).axis)
        elif kind == "axis":
            if name not in ACTIONS:
                here.error(f"name: {name or 'none'} is not an action; available: {', '.join(ACTIONS)}")
        elif name:
            here.error(f"name: is not possible with {kind}")

    def _check_axis(self, axis: int | None) -> None:
        """Report an axis number that the step's node does not have."""
        plans = [plan for bus in self._setup.joined.values() for plan in bus.plans.values()]
        axes = next((len(plan.axes) for plan in plans if plan.node_id == self._step.node), None)
        if axis is not None and axes is not None and axis >= axes:
            available = ", ".join(map(str, range(axes))) or "none"
            self._step.here.error(f"node {self._step.node} has no axis {axis}; it has: {available}")

    def _check_times(self, kind: str) -> None:
        times = self._step.times
        if kind != "trajectory":
            self._no("times", kind)
        elif list(times) != sorted(set(times)) or times[0] <= 0 or len(self._step.values) % len(times):
            self._step.here.error(
                "times: write increasing times above 0 in s, one per point of the trajectory, and values for each point"
            )

    def _check_frame(self) -> None:
        values = self._step.values
        data = values[1:]
        legal = 1 <= len(values) <= 9 and 0 <= values[0] <= 0x7FF and all(0 <= byte <= 255 for byte in data)
        if not legal or any(byte != int(byte) for byte in values):
            self._step.here.error("values: a frame needs an identifier from 0 to 0x7FF and up to eight data bytes")


def _is_count(values: Sequence[float]) -> bool:
    return len(values) == 1 and math.isfinite(values[0]) and values[0] >= 1 and values[0] == int(values[0])


def scenario_text(acts: Iterable[ScenarioEvent], *, seed: int, duration_ns: int, note: str = "") -> str:
    """Return the events as the text of a scenario file."""
    head = f"# {note}\n" if note else ""
    lines = "".join(f"  - {_line(act)}\n" for act in acts)
    return f"{head}for: {_seconds(duration_ns)}\nseed: {seed}\nsteps:{f'{chr(10)}{lines}' if lines else ' []'}"


def _line(act: ScenarioEvent) -> str:
    words = {"at": _seconds(act.at_ns), "do": act.kind, "target": act.target, "name": act.name}
    if act.values:
        words["values"] = f"[{', '.join(f'{value:g}' for value in act.values)}]"
    if act.times:
        words["times"] = f"[{', '.join(f'{time:g}' for time in act.times)}]"
    if act.for_ns is not None:
        words["for"] = _seconds(act.for_ns)
    if act.world is not None:
        words.update(world_words(act.world))
    if act.plant:
        words["plant"] = f"{{{', '.join(f'{name}: {value!r}' for name, value in act.plant)}}}"
    if act.when:
        words["when"] = act.when
    if act.axis:
        words["axis"] = str(act.axis)
    return f"{{{', '.join(f'{key}: {value}' for key, value in words.items() if value != '')}}}"


def _seconds(time_ns: int) -> str:
    return f"{time_ns // 1_000_000}ms" if time_ns % 1_000_000 == 0 else f"{time_ns / 1e9:.9f}s"
