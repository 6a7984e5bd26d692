"""Which kinds of trouble hit in which states: axis power, CiA 402, NMT and boot of the nodes that they hit.

A cell is a machine, a state of it and a kind of trouble (a fault of a drive by its name, or what happens to a supply, a
process or a bus). The states of axis power and boot are the robot's, those of CiA 402 and NMT the drive's own.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.nmt import NmtState
from canopen_control.cia402.state import State
from canopen_control.hardware.axis_power import AxisState
from canopen_control.master.remote_node import NodeState
from canopen_control.simulation.acts import KINDS
from canopen_control.simulation.state_coverage import DRIVE, NMT, POWER

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from canopen_control.simulation.acts import Act
    from canopen_control.simulation.simulated_robot import SimulatedRobot

__all__ = ["BOOT", "STATES", "Cell", "FaultCoverage", "cells_of", "cells_words", "is_met", "kind_of", "states_of"]

Cell = tuple[str, str, str]  # the machine, its state, the kind of trouble

BOOT: Final = "boot"
STATES: Final[Mapping[str, tuple[str, ...]]] = {
    POWER: tuple(each.name for each in AxisState),
    DRIVE: tuple(each.name for each in State),
    NMT: tuple(each.name for each in NmtState),
    BOOT: tuple(each.name for each in NodeState),
}
"""The states of each machine, in their order."""


def kind_of(act: Act) -> str:
    """Return the kind of a trouble: the fault's name, else what the act does."""
    return act.name or act.kind


def cells_of(faults: Sequence[str]) -> list[Cell]:
    """Return all cells, with these faults of drives; kind by kind within a state."""
    others = [name for name, kind in KINDS.items() if kind.breaks and name != "fault"]
    kinds = sorted({*faults, *others})
    return [(machine, state, kind) for machine, states in STATES.items() for state in states for kind in kinds]


def cells_words(hit: Iterable[Cell], faults: Sequence[str]) -> str:
    """Say of each machine how many of its cells were hit."""
    found, wanted = set(hit), cells_of(faults)
    counts = Counter(machine for machine, _, _ in wanted)
    hits = Counter(cell[0] for cell in wanted if cell in found)
    return ", ".join(f"{machine} {hits[machine]} of {total}" for machine, total in counts.items())


def states_of(robot: SimulatedRobot, node_id: int) -> Iterator[tuple[str, str]]:
    """Yield each machine of a node with its state now; of several axes each."""
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
            yield POWER, joint.power.state.name


def is_met(robot: SimulatedRobot, act: Act) -> bool:
    """Whether the state is there that an act waits for, of its node, or of any where it is about none."""
    nodes = [int(act.target)] if act.target.isdigit() else list(robot.drives)
    return not act.when or any(" ".join(each) == act.when for node_id in nodes for each in states_of(robot, node_id))


class FaultCoverage:
    """Counts the cells that troubles hit in `cells`; `troubled` hears each act that begins."""

    def __init__(self, robot: SimulatedRobot) -> None:
        self.cells: Counter[Cell] = Counter()
        self._robot = robot

    def troubled(self, act: Act) -> None:
        """Take an act; one that breaks nothing counts nowhere, one that hits many nodes once for each state."""
        if not KINDS[act.kind].breaks:
            return
        robot = self._robot
        hit = [int(act.target)] if act.target.isdigit() else list(robot.drives)
        self.cells.update({(*state, kind_of(act)) for node_id in hit for state in states_of(robot, node_id)})
