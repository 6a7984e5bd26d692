"""Nodes without axes whose loss must stop the robot, such as an I/O module that bus.yml calls required or mandatory.

The loss of a drive stops the drive's stop group (`hardware.system`). The loss of another node stops axes only if
bus.yml declares the node necessary (`required: true` or `mandatory: true`); then all axes are stopped, and no axis
can be enabled before the node has returned. The loss of any other node is only reported. The return of a node
enables nothing: enabling needs a user's command.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.errors import ControlError
from canopen_control.master.event_log import Event, Level
from canopen_control.runtime.enable_status import return_hint
from canopen_control.runtime.observer import RobotObserver
from canopen_control.runtime.stop_latch import MOVING_ACTIONS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.controllers.base import Controller
    from canopen_control.hardware.axis_statechart import Action
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.runtime.assembly import Assembly
    from canopen_control.runtime.stop_latch import StopLatch


class MandatoryNodes(RobotObserver):
    """Monitor that stops all axes when a mandatory node without a joint is lost; also applies the STOP `latch`.

    `forget(now, why)` clears the commands of all controllers. The monitor adds itself to the robot's `observers` if
    there are such nodes.
    """

    def __init__(
        self,
        assembly: Assembly,
        latch: StopLatch,
        forget: Callable[[int, str], None],
        report: Callable[[Event], None],
        observers: list[RobotObserver],
    ) -> None:
        self._assembly, self._latch, self._forget, self._report = assembly, latch, forget, report
        moving = {joint.node.name for joint in assembly.joints.values()}
        self._nodes = [node for name, node in assembly.nodes.items() if name not in moving and node.config.boot.insists]
        self._ready = dict.fromkeys(self._nodes, False)
        if self._nodes:
            observers.append(self)

    @property
    def hint(self) -> str | None:
        """Reason why no axis may move (STOP latch or missing mandatory nodes), or None if motion is allowed."""
        missing = self._missing()
        if missing and self._latch.hint is None:
            return f"nothing moves while bus.yml requires {missing}: {return_hint(self._absent)}"
        return self._latch.hint

    def check_action(self, action: Action) -> None:
        """Raise ControlError for enabling or homing while a mandatory node is missing or STOP is latched."""
        self._latch.check_action(action)
        if action in MOVING_ACTIONS:
            self._require(f"axis {action.value}")

    def check_controllers(self, controllers: Iterable[Controller]) -> None:
        """Raise ControlError for controllers with command interfaces while a node is missing or STOP is latched."""
        names = list(controllers)
        self._latch.check_controllers(names)
        for name in names:
            if name.command_interface_names():
                self._require(f"activating {name.name}")

    def after_cycle(self, now: int) -> None:
        for node in self._nodes:
            if node.ready is not self._ready[node]:
                self._ready[node] = node.ready
                if not node.ready:
                    self._stop(node, now)

    def _require(self, doing: str) -> None:
        if missing := self._missing():
            raise ControlError(f"{doing} is refused: bus.yml requires {missing}; {return_hint(self._absent)}")

    @property
    def _absent(self) -> list[RemoteNode]:
        return [node for node in self._nodes if not node.ready]

    def _missing(self) -> str:
        """Return the missing mandatory nodes with the reasons, or "" if all are ready."""
        return ", ".join(f"{node.label} ({node.reason or 'it has not booted yet'})" for node in self._absent)

    def _stop(self, node: RemoteNode, now: int) -> None:
        moving = [joint for joint in self._assembly.joints.values() if joint.enable_requested]
        why = f"{node.label}, which bus.yml requires, was lost"
        self._forget(now, why)
        for system in self._assembly.systems:
            system.stop(now)
        for joint in moving:
            joint.stopped_by = f"stopped since {why}"
        if moving:
            names = ", ".join(joint.joint for joint in moving)
            text = f"stopping {names}: {why}; to continue after its return: canopen-control axis enable all"
            self._report(Event(now, "stop", node.name, text, Level.ERROR))
