"""A schedule that aims a kind of trouble at a state: it leads the robot through the state and strikes as it is there.

What random schedules seldom meet, as a cable that is cut within the cycle in which an axis is released, is met so. How
a state is reached is in one table; states that no client leads to (homing, stops that drives do not obey) have no row.
"""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING, Final

from canopen_control.simulation.acts import KINDS, Act
from canopen_control.simulation.fault_coverage import BOOT, cells_of
from canopen_control.simulation.simulated_robot import MASTER
from canopen_control.simulation.state_coverage import DRIVE, NMT, POWER

if TYPE_CHECKING:
    from collections.abc import Container, Mapping, Sequence

    from canopen_control.simulation.fault_coverage import Cell
    from canopen_control.simulation.motions import Motion

__all__ = ["AIMED_NS", "aimed_schedule", "cells_to_aim_at"]

_MS: Final = 1_000_000
AIMED_NS: Final = 7_000 * _MS
"""How long such a schedule is simulated at least."""
_MOVES_NS: Final = 700 * _MS  # from when on the robot is commanded
_LEAD_NS: Final = 1500 * _MS  # when it is led towards the state
_BACK_NS: Final = 2500 * _MS  # when it is led out of it
_MENDED_NS: Final = 4_000 * _MS

_UP: Final = ("disable", _BACK_NS)
_WAYS: Final[Mapping[tuple[str, str], tuple[str, int]]] = {
    (POWER, "OFF"): ("disable", _LEAD_NS),
    (POWER, "RISING"): _UP,
    (POWER, "RELEASED"): _UP,
    (POWER, "ENABLED"): _UP,
    (POWER, "READY"): _UP,
    (POWER, "FOLLOWING"): ("", _LEAD_NS),
    (POWER, "HALTED"): ("halt", _LEAD_NS),
    (POWER, "BRAKING"): ("stop", _LEAD_NS),
    (POWER, "SETTLING"): ("stop", _LEAD_NS),
    (POWER, "DISABLING"): ("stop", _LEAD_NS),
    (POWER, "QUICK_STOPPING"): ("quick-stop", _LEAD_NS),
    (POWER, "QUICK_STOPPED"): ("quick-stop", _LEAD_NS),
    (DRIVE, "SWITCH_ON_DISABLED"): ("disable", _LEAD_NS),
    (DRIVE, "READY_TO_SWITCH_ON"): _UP,
    (DRIVE, "SWITCHED_ON"): _UP,
    (DRIVE, "OPERATION_ENABLED"): ("", _LEAD_NS),
    (DRIVE, "QUICK_STOP_ACTIVE"): ("quick-stop", _LEAD_NS),
    (DRIVE, "FAULT_REACTION_ACTIVE"): ("fault", _LEAD_NS),
    (DRIVE, "FAULT"): ("fault", _LEAD_NS),
    (NMT, "OPERATIONAL"): ("", _LEAD_NS),
    (NMT, "PRE_OPERATIONAL"): ("nmt 128", _LEAD_NS),
    (NMT, "STOPPED"): ("nmt 2", _LEAD_NS),
    (BOOT, "READY"): ("", _LEAD_NS),
    (BOOT, "BOOTING"): ("power", _LEAD_NS),
    (BOOT, "WAITING"): ("power", _LEAD_NS),
}
"""How a state is reached, and from when on it is waited for."""


def cells_to_aim_at(hit: Container[Cell], faults: Sequence[str], most: int) -> list[Cell]:
    """Return up to `most` cells that were not hit and can be aimed at, from all over the table."""
    empty = [cell for cell in cells_of(faults) if cell not in hit and cell[:2] in _WAYS]
    return [empty[number * len(empty) // most] for number in range(most)] if len(empty) > most else empty


def aimed_schedule(seed: int, cell: Cell, motions: Sequence[Motion], nodes: Sequence[int]) -> tuple[Act, ...]:
    """Return the acts that aim at a cell; the seed draws the node, the motion, and how long the trouble lasts."""
    machine, state, kind = cell
    draw = Random(f"{seed}/aimed").random
    way, armed = _WAYS[machine, state]
    node = str(nodes[int(draw() * len(nodes))])
    acts = [*_moves(motions, draw()), *_led(way, node), _strike(kind, f"{machine} {state}", node, armed, draw())]
    acts += [
        Act(_MENDED_NS, "axis", name="fault-reset"),
        Act(_MENDED_NS + 300 * _MS, "axis", name="enable"),
    ]
    return tuple(sorted(acts, key=lambda act: act.at_ns))


def _moves(motions: Sequence[Motion], drawn: float) -> list[Act]:
    """Command before and after, where there is something to command."""
    motion = next((each for each in motions if each.starts), None)
    if motion is None:
        return []
    values = tuple(round(low + (high - low) * (0.1 + 0.9 * drawn), 3) for low, high in motion.ranges)
    lasting = ((_MOVES_NS, _BACK_NS + 500 * _MS), (_MENDED_NS + 900 * _MS, AIMED_NS - 1000 * _MS))
    return [Act(at, motion.kind, motion.controller, values=values, for_ns=until - at) for at, until in lasting]


def _led(way: str, node: str) -> list[Act]:
    """Return what leads into a state, and out of it again."""
    again = [Act(_BACK_NS - 100 * _MS, "axis", name="fault-reset"), Act(_BACK_NS, "axis", name="enable")]
    if way in ("disable", "halt", "quick-stop"):
        return [Act(_LEAD_NS, "axis", name=way), *again]
    if way == "stop":
        return [Act(_LEAD_NS, "stop"), *again]
    if way == "fault":
        return [Act(_LEAD_NS, "fault", node, "drive_fault", for_ns=300 * _MS), *again]
    if way == "power":
        return [Act(_LEAD_NS, "power", node, for_ns=900 * _MS), *again]
    if way.startswith("nmt"):
        return [Act(_LEAD_NS, "frame", values=(0.0, float(way.split()[1]), float(node))), *again]
    return []


def _strike(kind: str, when: str, node: str, armed: int, drawn: float) -> Act:
    """Return the trouble, which waits for the state."""
    lasts = (50 + int(1000 * drawn)) * _MS
    if kind not in KINDS:
        return Act(armed, "fault", node, kind, for_ns=lasts, when=when)
    if kind == "frame":
        return Act(armed, kind, values=(0x580 + float(node), 128.0), when=when)
    target = {"node": node, "member": MASTER if drawn < 0.3 and kind != "power" else node}.get(KINDS[kind].target, "")
    values = (float(1 + int(3 * drawn)),) if KINDS[kind].values else ()
    return Act(armed, kind, target, values=values, for_ns=lasts, when=when)
