"""Which edges of the state machines a simulation has walked: axis power, CiA 402, NMT; and which are left.

The rows of the axis power chart are counted where they are taken. The edges of CiA 402 and NMT are what a listener on
the wire sees from one statusword, or heartbeat, to the next: two steps between them are one that the diagram has not.
"""

from __future__ import annotations

from collections import Counter
from functools import partial
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.nmt import state_of_byte
from canopen_control.cia402.state import TRANSITIONS, decode_statusword
from canopen_control.hardware.axis_power import TABLE

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from canopen_control.hardware.axis_power import AxisState, Trigger
    from canopen_control.runtime.core import RobotCore
    from canopen_control.simulation.simulated_robot import SimulatedRobot
    from canopen_control.simulation.wire_view import WireView

__all__ = ["EDGES", "Edge", "StateCoverage", "coverage_words", "left_out"]

Edge = tuple[str, str, str]  # the machine, the state before, and the trigger or the state after

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
"""The edges that each machine has."""


class StateCoverage:
    """Counts the edges that a robot walks; call `sampled` now and then, since a robot that is restarted is another."""

    def __init__(self, robot: SimulatedRobot, views: Iterable[WireView]) -> None:
        self._robot, self._nodes = robot, [node for view in views for node in view.nodes.values()]
        self._core: RobotCore | None = None
        self._rows: Counter[tuple[AxisState, Trigger]] = Counter()
        self.sampled()

    def sampled(self) -> None:
        """Listen to the axes of the robot that runs now."""
        core = self._robot.core
        if core is not self._core:
            self._core = core
            for joint in core.joints.values():
                joint.power.on_row = partial(self._take, self._rows)

    @staticmethod
    def _take(rows: Counter[tuple[AxisState, Trigger]], state: AxisState, trigger: Trigger) -> None:
        rows[state, trigger] += 1

    @property
    def walked(self) -> dict[Edge, int]:
        """How often each edge was walked, those that no diagram has included."""
        found: Counter[Edge] = Counter()
        for (state, trigger), count in self._rows.items():
            found[POWER, state.name, trigger.name] += count
        for node in self._nodes:
            for (before, after), count in node.drive_edges.items():
                found[DRIVE, _drive_state(before), _drive_state(after)] += count
            for (before, after), count in node.nmt_edges.items():
                found[NMT, _nmt_state(before), _nmt_state(after)] += count
        return dict(sorted(found.items()))


def coverage_words(walked: Mapping[Edge, int]) -> str:
    """Say of each machine how many of its edges were walked."""
    counts = ((machine, sum(edge in walked for edge in edges), len(edges)) for machine, edges in EDGES.items())
    return ", ".join(f"{machine} {count} of {total}" for machine, count, total in counts)


def left_out(walked: Mapping[Edge, int]) -> list[Edge]:
    """Return the edges that were not walked, in order."""
    return sorted(edge for edges in EDGES.values() for edge in edges if edge not in walked)


def _drive_state(word: int) -> str:
    state = decode_statusword(word)
    return "unknown" if state is None else state.name


def _nmt_state(byte: int) -> str:
    state = state_of_byte(byte)
    return "unknown" if state is None else state.name
