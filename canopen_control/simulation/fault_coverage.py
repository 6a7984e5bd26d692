"""Coverage of state transitions, and of faults by state, for axis power, CiA 402, NMT and the boot of nodes.

A cell is a state machine, one of its states, and a kind of fault (the name of a drive's fault, or a fault of a supply,
process or bus). The states of axis power and boot are those of the robot, the states of CiA 402 and NMT those of the
drive.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.nmt import NmtState, state_of_byte
from canopen_control.cia402.state import TRANSITIONS, State, decode_statusword
from canopen_control.hardware.axis_statechart import TABLE, AxisPhase
from canopen_control.master.remote_node import NodeState
from canopen_control.simulation.scenario_events import KINDS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from canopen_control.hardware.axis_statechart import PhaseTrigger
    from canopen_control.runtime.core import RobotCore
    from canopen_control.simulation.robot_under_test import RobotUnderTest
    from canopen_control.simulation.wire_view import WireView
    from canopen_control.virtual.scenario import ScenarioEvent


# Transitions of the state machines axis power, CiA 402 and NMT. Those of the axis power chart are counted when they
# fire. Those of CiA 402 and NMT are differences between two consecutive statuswords or heartbeats on the bus: two fast
# steps appear as one transition that is not in the diagram.


Edge = tuple[str, str, str]  # machine, previous state, trigger or next state

POWER, DRIVE, NMT = "axis power", "CiA 402", "NMT"
_BOOT, _STOPPED, _OPERATIONAL, _PRE = "INITIALISING", "STOPPED", "OPERATIONAL", "PRE_OPERATIONAL"
_UP: Final = (_PRE, _OPERATIONAL, _STOPPED)

EDGES: Final[Mapping[str, frozenset[Edge]]] = {
    POWER: frozenset((POWER, state.name, trigger.name) for state, rows in TABLE.items() for trigger in rows),
    DRIVE: frozenset((DRIVE, source.name, row.target.name) for row in TRANSITIONS for source in row.sources),
    NMT: frozenset(
        (NMT, before, after)
        for before in (_BOOT, *_UP)
        for after in (_BOOT, *_UP)
        if before != after and (before != _BOOT or after == _PRE)
    ),
}
"""All transitions of each state machine."""


class _RowCounter:
    """Counter of the statechart transitions that the axes apply."""

    def __init__(self) -> None:
        self.counts: Counter[tuple[AxisPhase, PhaseTrigger]] = Counter()

    def row_taken(self, state: AxisPhase, trigger: PhaseTrigger) -> None:
        self.counts[state, trigger] += 1


class StateCoverage:
    """Counter of a robot's state transitions."""

    def __init__(self, robot: RobotUnderTest, views: Iterable[WireView]) -> None:
        self._robot, self._nodes = robot, [node for view in views for node in view.nodes.values()]
        self._core: RobotCore | None = None
        self._rows = _RowCounter()
        self.on_sample()

    def on_sample(self) -> None:
        """Observe the axes of the robot's current core; a restart of the robot creates a new core."""
        core = self._robot.core
        if core is not self._core:
            self._core = core
            for joint in core.joints.values():
                joint.statechart.observer = self._rows

    @property
    def walked(self) -> dict[Edge, int]:
        """Number of occurrences of each transition, including transitions that are in no diagram."""
        total: Counter[Edge] = Counter()
        for (state, trigger), count in self._rows.counts.items():
            total[POWER, state.name, trigger.name] += count
        for node in self._nodes:
            for (before, after), count in node.drive_edges.items():
                total[DRIVE, _drive_state(before), _drive_state(after)] += count
            for (before, after), count in node.nmt_edges.items():
                total[NMT, _nmt_state(before), _nmt_state(after)] += count
        return dict(sorted(total.items()))


def coverage_words(walked: Mapping[Edge, int]) -> str:
    """Return the number of covered transitions of each state machine as text."""
    counts = ((machine, sum(edge in walked for edge in edges), len(edges)) for machine, edges in EDGES.items())
    return ", ".join(f"{machine} {count} of {total}" for machine, count, total in counts)


def left_out(walked: Mapping[Edge, int]) -> list[Edge]:
    """Return the uncovered transitions, sorted."""
    return sorted(edge for edges in EDGES.values() for edge in edges if edge not in walked)


def _drive_state(word: int) -> str:
    state = decode_statusword(word)
    return "unknown" if state is None else state.name


def _nmt_state(byte: int) -> str:
    state = state_of_byte(byte)
    return "unknown" if state is None else state.name


Cell = tuple[str, str, str]  # machine, state, kind of fault

BOOT: Final = "boot"
STATES: Final[Mapping[str, tuple[str, ...]]] = {
    POWER: tuple(phase.name for phase in AxisPhase),
    DRIVE: tuple(state.name for state in State),
    NMT: tuple(state.name for state in NmtState),
    BOOT: tuple(state.name for state in NodeState),
}
"""States of each state machine, in order."""


def kind_of(act: ScenarioEvent) -> str:
    """Return the kind of a fault event: the name of its fault, if any, else the event kind."""
    return act.name or act.kind


def cells_of(faults: Sequence[str]) -> list[Cell]:
    """Return all cells, with the given faults of drives and all other kinds of faults, in order."""
    names = [name for name, kind in KINDS.items() if kind.breaks and name != "fault"]
    kinds = sorted({*faults, *names})
    return [(machine, state, kind) for machine, states in STATES.items() for state in states for kind in kinds]


def cells_words(hit: Iterable[Cell], faults: Sequence[str]) -> str:
    """Return the number of covered cells of each state machine as text."""
    hit_cells, all_cells = set(hit), cells_of(faults)
    counts = Counter(machine for machine, _, _ in all_cells)
    hits = Counter(cell[0] for cell in all_cells if cell in hit_cells)
    return ", ".join(f"{machine} {hits[machine]} of {total}" for machine, total in counts.items())


def states_of(robot: RobotUnderTest, node_id: int) -> Iterator[tuple[str, str]]:
    """Yield the name and the current state of each state machine of a node and of its axes."""
    device = robot.drives[node_id].device
    if device is not None:
        yield NMT, device.nmt.state.name
        for drive in device.drives.values():
            yield DRIVE, drive.state.name
    if not robot.up:
        return
    for node in robot.core.nodes.values():
        if node.node_id == node_id:
            yield BOOT, node.state.name
    for joint in robot.core.joints.values():
        if joint.node.node_id == node_id:
            yield POWER, joint.statechart.state.name


def state_reached(robot: RobotUnderTest, act: ScenarioEvent) -> bool:
    """Whether the event's node (any node if none is named) is in the state `when`; True without `when`."""
    nodes = [int(act.target)] if act.target.isdigit() else list(robot.drives)
    return not act.when or any(
        " ".join(machine_state) == act.when for node_id in nodes for machine_state in states_of(robot, node_id)
    )


class FaultCoverage:
    """Counter of the cells (pairs of state and fault) that occurred."""

    def __init__(self, robot: RobotUnderTest) -> None:
        self.cells: Counter[Cell] = Counter()
        self._robot = robot

    def on_event(self, act: ScenarioEvent) -> None:
        """Count each cell of a fault once, however many nodes are affected; ignore events other than faults."""
        if not KINDS[act.kind].breaks:
            return
        robot = self._robot
        hit = [int(act.target)] if act.target.isdigit() else list(robot.drives)
        self.cells.update({(*state, kind_of(act)) for node_id in hit for state in states_of(robot, node_id)})
