"""What will happen to the nodes of a process, on its clock.

The law of this file: a step goes through the node's control, as if somebody had asked for it there; one that cannot be
done is told, and the others go on.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.host.reactor import Reactor
    from canopen_control.virtual.control import NodeControl
    from canopen_control.virtual.node import VirtualNode

__all__ = ["Switching", "Timeline"]


@dataclass(frozen=True, slots=True)
class Switching:
    """What happens `at_ns` after the start: a fault goes on or off, or numbers of a plant are set."""

    at_ns: int
    node_id: int
    fault: str = ""
    on: bool = True
    axis: int = 0
    plant: tuple[tuple[str, float], ...] = ()


class Timeline:
    """Plays switchings on the nodes of one process through their control; starts when it is made.

    `controls` is looked at when a step is due; `say` takes what could not be done, in a sentence.
    """

    def __init__(
        self,
        reactor: Reactor,
        controls: Mapping[VirtualNode, NodeControl],
        started_with: Mapping[int, VirtualNode],
        say: Callable[[str], None],
    ) -> None:
        self._reactor, self._controls, self._nodes, self._say = reactor, controls, started_with, say
        self._start = reactor.now()

    def plan(self, switchings: Sequence[Switching]) -> None:
        """Put all on the clock."""
        for each in switchings:
            self._reactor.call_at(self._start + each.at_ns, partial(self._play, each))

    def _play(self, switching: Switching) -> None:
        control = self._controls[self._nodes[switching.node_id]]
        try:
            if switching.fault:
                control.serve("fault", {"name": switching.fault, "on": switching.on})
            else:
                control.serve("plant", {"axis": switching.axis, **dict(switching.plant)})
        except ConfigError as error:
            self._say(f"node {switching.node_id}: scenario: {error}")
