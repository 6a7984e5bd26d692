"""Scenarios: timed faults, quirks and disturbances in a YAML file, and their player.

Times count from the drives' ready line. All errors in the file are reported at once, with their lines, before anything
runs. A step is executed by the node's control, like a request of a client; a step that fails is reported, and the
others continue.

    steps:
      - {at: 5s, node: 3, fault: heartbeat_lost}              # switched on for good
      - {at: 8s, node: 3, fault: heartbeat_lost, state: off}
      - {at: 500ms, node: 2, fault: silent, for: 2s}          # switched on, and off again after 2 s
      - {at: 9s, node: 3, quirk: brake_delay=0.5@1}           # a quirk of a drive; state: off ends it
      - {at: 12s, node: 3, plant: {stalled: 1, external: -300}}
      - {at: 14s, payload: {mass: 12}}                        # with physics only
      - {at: 16s, block: left_wheel_joint, for: 2s}

`node` may be left out if the process has one node; `axis` selects the plant of an axis (default 0). Times are 1h, 5min,
5s, 500ms, or a number of seconds. The format is that of `simulate --scenario`, whose further keys need a robot; `for`
and `seed` of the file are not used here.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from canopen_control.duration import nanoseconds_of
from canopen_control.errors import ConfigError
from canopen_control.rpc.messages.drive import (
    AddPayload,
    BlockJoint,
    PushRobot,
    SetGrip,
    SetPlant,
    SwitchFault,
    SwitchQuirk,
)
from canopen_control.virtual.fault_table import find_fault
from canopen_control.virtual.quirks import parse_quirk
from canopen_control.yamlfile.convert import position, setting
from canopen_control.yamlfile.node import Node  # noqa: TC001 - the type of a field is looked up at run time
from canopen_control.yamlfile.reader import load

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from pathlib import Path

    from canopen_control.host.reactor import Reactor
    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.drive import WorldAct
    from canopen_control.virtual.control import NodeControl
    from canopen_control.virtual.virtual_node import VirtualNode
    from canopen_control.yamlfile.node import Problems


# Disturbances of a world with physics in YAML: the keys payload, push, block and friction of a step.
#
# These keys are the same in a scenario of drives and in a world file; the messages are those of the control socket of a
# drive, see `rpc.messages.drive`. Lengths are in m, masses in kg, forces in N.


@dataclass(frozen=True)
class Payload:
    """Keys of a payload on a link in a scenario step; see `AddPayload`."""

    mass: float
    on: str = ""
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Push:
    """Keys of a push on a link in a scenario step; see `PushRobot`."""

    force: tuple[float, float, float]
    on: str = ""
    seconds: float = setting(0.2, low=1e-3)


def world_words(act: WorldAct) -> list[tuple[str, str]]:
    """Return the keys with which a scenario step describes a disturbance, each with its value as text."""
    if isinstance(act, BlockJoint):
        return [("block", act.joint)]
    if isinstance(act, SetGrip):
        return [("friction", f"{act.friction:g}")]
    numbers = {"mass": f"{act.mass:g}"} if isinstance(act, AddPayload) else {"force": _list(act.force)}
    if act.on:
        numbers["on"] = act.on
    if isinstance(act, AddPayload):
        numbers["position"] = _list(act.position)
    else:
        numbers["seconds"] = f"{act.seconds:g}"
    text = f"{{{', '.join(f'{key}: {value}' for key, value in numbers.items())}}}"
    return [("payload" if isinstance(act, AddPayload) else "push", text)]


def _list(numbers: Iterable[float]) -> str:
    return f"[{', '.join(f'{number:g}' for number in numbers)}]"


@dataclass(frozen=True, kw_only=True)
class WorldEvent:
    """Keys of a scenario step that disturbs the world: payload, push, blocked joint and friction."""

    payload: Payload | None = None
    push: Push | None = None
    block: str = ""
    friction: float | None = setting(None, low=0.0, high=10.0)

    def acts(self) -> list[WorldAct]:
        """Return the disturbances of the step as messages."""
        acts: list[WorldAct] = []
        if self.payload is not None:
            acts.append(AddPayload(mass=self.payload.mass, on=self.payload.on, position=self.payload.position))
        if self.push is not None:
            acts.append(PushRobot(force=self.push.force, on=self.push.on, seconds=self.push.seconds))
        if self.friction is not None:
            acts.append(SetGrip(friction=self.friction))
        if self.block:
            acts.append(BlockJoint(joint=self.block))
        return acts


@dataclass(frozen=True, slots=True)
class ScenarioEvent:
    """Event of a schedule, `at_ns` after the start; `for_ns` None means unlimited or instantaneous.

    `kind` is a key of `simulation.scenario_events.KINDS`; drives alone can play the kinds that have a `request`.
    `target` is a node-ID, `master`, or a controller; `name` is the name of a fault, a quirk or an action, `world` a
    disturbance of the physics world. `times` are the times in s of the points of a trajectory, whose values are
    concatenated; empty for one point. `when` is a state machine and a state, such as "axis power RAMPING_DOWN": the
    event waits until its node, or any node, is in this state.
    """

    at_ns: int
    kind: str
    target: str = ""
    name: str = ""
    values: tuple[float, ...] = ()
    for_ns: int | None = None
    plant: tuple[tuple[str, float], ...] = ()
    axis: int = 0
    times: tuple[float, ...] = ()
    when: str = ""
    world: WorldAct | None = None

    @property
    def words(self) -> str:
        world = "" if self.world is None else " ".join(f"{key} {value}" for key, value in world_words(self.world))
        text = " ".join(word for word in (self.kind, self.target, self.name, world) if word)
        values = " ".join(f"{word:g}" for word in self.values)
        lasts = f" for {self.for_ns / 1e9:g} s" if self.for_ns is not None else ""
        when = f", as soon as {self.when}" if self.when else ""
        return f"{self.at_ns / 1e9:.3f} s: {text}{f' {values}' if values else ''}{lasts}{when}"

    def request(self, *, on: bool = True) -> Request[Any] | None:
        """Return the event as a request to a drive, with `on` False its end after `for_ns`; None for other kinds."""
        if self.kind in ("fault", "fault_off"):
            return SwitchFault(name=self.name, on=on and self.kind == "fault")
        if self.kind in ("quirk", "quirk_off"):
            return SwitchQuirk(quirk=self.name, on=on and self.kind == "quirk")
        if self.kind == "plant":
            return SetPlant(numbers=dict(self.plant), axis=self.axis)
        if on:
            return self.world
        return BlockJoint(joint=self.world.joint, on=False) if isinstance(self.world, BlockJoint) else None


class ScenarioError(ConfigError):
    """Error in a scenario file."""


@dataclass(frozen=True)
class ScenarioStep(WorldEvent):
    """Entry of `steps` in a scenario file.

    `do`, `target`, `name`, `values`, `times` and `when` are used only in simulations of robots.
    """

    at: float | str
    do: str = ""
    target: str | int = ""
    name: str = ""
    values: tuple[float, ...] = ()
    length: float | str | None = setting(None, key="for")
    node: int | None = None
    fault: str = ""
    quirk: str = ""
    state: bool = True
    axis: int = setting(0, low=0, high=7)
    times: tuple[float, ...] = ()
    when: str = ""
    plant: dict[str, float] = setting(factory=dict)
    here: Node = position()  # noqa: RUF009 - makes a field

    @property
    def at_ns(self) -> int:
        """Time of the step in ns; an invalid text is reported as an error of the file."""
        return nanoseconds_at(self.here, self.at)

    @property
    def for_ns(self) -> int | None:
        """Duration in ns, or None if not given; an invalid text is reported as an error of the file."""
        return None if self.length is None else nanoseconds_at(self.here, self.length)

    @property
    def kind(self) -> str:
        """Kind of the event of a step without `do`: plant, quirk, quirk_off, fault or fault_off."""
        if self.plant:
            return "plant"
        if self.quirk:
            return "quirk" if self.state else "quirk_off"
        return "fault" if self.state else "fault_off"

    def check_name(self, fault: str | None, quirk: str | None) -> None:
        """Report an unknown fault or quirk as an error of the file."""
        if fault is not None or quirk is not None:
            try:
                find_fault(fault) if fault is not None else parse_quirk(quirk or "")
            except ConfigError as error:
                self.here.error(str(error))


@dataclass(frozen=True)
class ScenarioFile:
    """Contents of a scenario file; `for` and `seed` are used only in simulations of robots."""

    steps: list[ScenarioStep]
    length: float | str | None = setting(None, key="for")
    seed: int | None = setting(None, low=0)
    here: Node = position()  # noqa: RUF009 - makes a field


def nanoseconds_at(here: Node, value: float | str) -> int:
    """Return a time in ns; for an invalid text, report an error at `here` and return 1."""
    try:
        return nanoseconds_of(value)
    except ValueError as error:
        here.error(str(error))
        return 1


def read_scenario(path: Path, node_ids: Sequence[int]) -> list[ScenarioEvent]:
    """Return the events of a scenario file in order of time; ScenarioError lists all errors by line."""
    events: list[ScenarioEvent] = []

    def check(file: ScenarioFile, _problems: Problems) -> None:
        for step in file.steps:
            events.extend(_events(step, node_ids))

    load(path, ScenarioFile, error=ScenarioError, check=check)
    return sorted(events, key=lambda event: event.at_ns)


def _events(step: ScenarioStep, node_ids: Sequence[int]) -> list[ScenarioEvent]:
    others = ("do", "target", "name", "values", "times", "when")
    if keys := [key for key in others if getattr(step, key) not in ("", ())]:
        step.here.error(f"{', '.join(keys)}: only for a whole robot; use: canopen-control simulate")
    if step.acts():
        return _world_events(step, node_ids)
    node_id = step.node if step.node is not None else node_ids[0]
    if step.node is None and len(node_ids) > 1:
        step.here.error(f"node is missing; choose one of {', '.join(map(str, node_ids))}")
    elif node_id not in node_ids:
        step.here.error(f"node {node_id} is not in this process; choose one of {', '.join(map(str, node_ids))}")
    if not step.do and sum(map(bool, (step.fault, step.quirk, step.plant))) != 1:
        step.here.error("a step needs exactly one of fault, quirk, plant, or an event in the world")
    step.check_name(step.fault or None, step.quirk or None)
    if step.length is not None and (step.plant or not step.state):
        step.here.error("for: is possible only with a fault or quirk that is switched on")
    name, plant = step.fault or step.quirk, tuple(step.plant.items())
    return [ScenarioEvent(step.at_ns, step.kind, str(node_id), name, (), step.for_ns, plant, step.axis)]


def _world_events(step: ScenarioStep, node_ids: Sequence[int]) -> list[ScenarioEvent]:
    """Return the events of a step that disturbs the world; the first node of the process receives them."""
    acts = step.acts()
    if len(acts) > 1 or step.fault or step.quirk or step.plant or step.node is not None:
        step.here.error("a step has one of payload, push, block and friction, and then no node, fault, quirk or plant")
    if step.length is not None and not step.block:
        step.here.error("for: is possible only with block, or with a fault or quirk that is switched on")
    at_ns, for_ns, target = step.at_ns, step.for_ns, str(node_ids[0])
    return [ScenarioEvent(at_ns, "world", target, for_ns=for_ns, world=act) for act in acts]


class Timeline:
    """Player of scenario events on the nodes of one process; times count from its creation.

    `controls` is read when a step is due; `report` receives a sentence about each step that fails.
    """

    def __init__(
        self,
        reactor: Reactor,
        controls: Mapping[VirtualNode, NodeControl],
        started_with: Mapping[int, VirtualNode],
        report: Callable[[str], None],
    ) -> None:
        self._reactor, self._controls, self._nodes, self._report = reactor, controls, started_with, report
        self._start = reactor.now()

    def plan(self, events: Sequence[ScenarioEvent]) -> None:
        """Schedule the beginning and the end of each event on the reactor."""
        for event in events:
            at_ns = self._start + event.at_ns
            self._reactor.call_at(at_ns, partial(self._play, event))
            if event.for_ns is not None:
                self._reactor.call_at(at_ns + event.for_ns, partial(self._play, event, on=False))

    def _play(self, event: ScenarioEvent, *, on: bool = True) -> None:
        request = event.request(on=on)
        try:
            if request is not None:
                self._controls[self._nodes[int(event.target)]].do(request)
        except ConfigError as error:
            self._report(f"node {event.target}: scenario: {error}")
