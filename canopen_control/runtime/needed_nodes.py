"""Nodes that move nothing and without which nothing may move: an I/O module that bus.yml calls required or mandatory.

The law of this file: a drive that is lost stops its group by itself (`hardware.system`). Of the other nodes only one of
which bus.yml says in so many words that the robot needs it (`required: true` or `mandatory: true`) stops axes when it
is lost, all of them, and no axis is enabled before it is back. Any other is told, and the axes go on. What is back
enables nothing: that is a user's word.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.errors import ControlError
from canopen_control.hardware.axis_power import Action
from canopen_control.master.event_log import Event, Level
from canopen_control.runtime.readiness import way_back

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.controllers.base import Controller
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.runtime.assembly import Assembly
    from canopen_control.runtime.latch import StopLatch

__all__ = ["NeededNodes"]

_RISING: Final = (Action.ENABLE, Action.HOME)


class NeededNodes:
    """Watches the nodes of a robot that it needs and that move none of its joints, beside the `latch` of STOP.

    `forget(now, why)` has every controller forget its command; the hooks `after_cycle` get one more where it has nodes.
    """

    def __init__(
        self,
        made: Assembly,
        latch: StopLatch,
        forget: Callable[[int, str], None],
        report: Callable[[Event], None],
        after_cycle: list[Callable[[int], None]],
    ) -> None:
        self._made, self._latch, self._forget, self._report = made, latch, forget, report
        moving = {joint.node.name for joint in made.joints.values()}
        self._nodes = [each for name, each in made.nodes.items() if name not in moving and each.config.boot.insists]
        self._ready = dict.fromkeys(self._nodes, False)
        if self._nodes:
            after_cycle.append(self.step)

    @property
    def hint(self) -> str | None:
        """What keeps every axis from moving, STOP first; None where nothing does."""
        missing = self._missing()
        if missing and self._latch.hint is None:
            return f"nothing moves while bus.yml requires {missing}: {way_back(self._absent)}"
        return self._latch.hint

    def check_action(self, action: Action) -> None:
        """Refuse what would move an axis while one of them is missing, or STOP is latched; ControlError."""
        self._latch.check_action(action)
        if action in _RISING:
            self._require(f"axis {action.value}")

    def check_controllers(self, controllers: Iterable[Controller]) -> None:
        """Refuse to activate controllers that command something, likewise; ControlError."""
        wanted = list(controllers)
        self._latch.check_controllers(wanted)
        for each in wanted:
            if each.command_interface_names():
                self._require(f"activating {each.name}")

    def step(self, now: int) -> None:
        """Stop all axes when one of them was lost; after every cycle."""
        for node in self._nodes:
            if node.ready is not self._ready[node]:
                self._ready[node] = node.ready
                if not node.ready:
                    self._stop(node, now)

    def _require(self, doing: str) -> None:
        if missing := self._missing():
            raise ControlError(f"{doing} is refused: bus.yml requires {missing}; {way_back(self._absent)}")

    @property
    def _absent(self) -> list[RemoteNode]:
        return [node for node in self._nodes if not node.ready]

    def _missing(self) -> str:
        """Return who is missing and why, "" where all are there."""
        return ", ".join(f"{each.who} ({each.error or 'it has not booted yet'})" for each in self._absent)

    def _stop(self, node: RemoteNode, now: int) -> None:
        moving = [joint for joint in self._made.joints.values() if joint.wanted]
        why = f"{node.who}, which bus.yml requires, was lost"
        self._forget(now, why)
        for system in self._made.systems:
            system.stop(now)
        for joint in moving:
            joint.stopped_by = f"stopped since {why}"
        if moving:
            names = ", ".join(joint.joint for joint in moving)
            text = f"stopping {names}: {why}; to go on when it is back: canopen-control axis enable all"
            self._report(Event(now, "stop", node.name, text, Level.ERROR))
