"""Invariants of the runtime itself: the state told is the state that is, memory is bounded, the program has no error.

What a face of the robot claims (state, axes, velocities) is held against the wire and the shafts, and the STOP latch
against what clients have asked for, whoever has left or restarted since. Times in ns.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Final

from canopen_control.hardware.interfaces import TARGET
from canopen_control.runtime.core import RobotState

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from canopen_control.simulation.acts import Act
    from canopen_control.simulation.simulated_robot import SimulatedRobot
    from canopen_control.simulation.wire_view import NodeView, WireView

__all__ = ["ToldRules"]

_MS: Final = 1_000_000
_SECOND: Final = 1_000_000_000
_SOON_NS: Final = 400 * _MS  # in which what has happened is told
_FRESH_NS: Final = 100 * _MS
_MEMORY_NS: Final = 60 * _SECOND
_BLOCKS: Final = 60_000  # of memory, that a robot may have more than a while after its start


class ToldRules:
    """Holds the runtime's words against what is; `tell(rule, text)` takes breaches.

    `asked`, `taken` and `sampled` are called as time passes.
    """

    def __init__(self, robot: SimulatedRobot, views: Mapping[str, WireView], tell: Callable[[str, str], None]) -> None:
        self._robot, self._tell = robot, tell
        self._nodes = [node for view in views.values() for node in view.nodes.values()]
        self._wrong_since: dict[tuple[str, str], int] = {}  # what of whom
        self._names = {node.node_id: f"node {node.node_id}" for node in self._nodes}
        self._errors = 0
        self._blocks: int | None = None
        self._weigh_at = robot.now_ns + _MEMORY_NS
        self._latched: bool | None = False  # as clients have asked for it; None: nobody knows whether that was heard
        self._latch_asked = self._latch_heard = 0

    def asked(self, now: int, act: Act) -> None:
        """Take what a client asks for; a process that is stalled hears it when it goes on."""
        if act.kind in ("latch", "release"):
            self._latched = act.kind == "latch"
            self._latch_asked, self._latch_heard = now, max(now, self._robot.host.stalled_until)

    def taken(self, now: int, act: Act) -> None:
        """Judge a command that was taken: one all of whose drives have been off for a while must not be."""
        core = self._robot.core
        joints = [core.joints.get(each.joint) for each in core.manager.get(act.target).commands]
        moved = {joint.node.node_id for joint in joints if joint is not None}
        axes = [node for node in self._nodes if node.node_id in moved]
        if axes and all(_is_off(node, now) for node in axes):
            self._tell("command_taken", f"a command to {act.target} is taken, and its drives are off")

    def sampled(self, now: int) -> None:
        """Judge what is told now."""
        robot = self._robot
        for error in robot.errors[self._errors :]:
            self._tell("program_error", f"{type(error).__name__}: {error}")
        self._errors = len(robot.errors)
        if now >= self._weigh_at:
            self._weigh(now)
        if now <= self._latch_heard + _FRESH_NS and not (robot.up and robot.started_ns <= self._latch_asked):
            self._latched = None
        if not robot.up or now < robot.host.stalled_until:
            self._wrong_since.clear()
            return
        self._judge_latch(now)
        troubled = False
        for node in self._nodes:
            troubled = self._judge_state(node, now) or troubled
        for node in self._nodes:
            self._judge_axes(node, now, troubled=troubled)

    def _judge_latch(self, now: int) -> None:
        """Judge that STOP is latched from when a client has latched it until one releases it, and at no other time."""
        held, latched = self._robot.core.latch.held, self._latched
        if held is not latched or self._wrong_since:
            self._hold("STOP was latched by {}, and is not any more", "a client", latched is True and not held, now)
            self._hold("STOP is latched, and {} asked for it", "nobody", latched is False and held, now)

    def _judge_state(self, node: NodeView, now: int) -> bool:
        """Judge that RUNNING means that every node is there and no drive is in fault; return whether it is not so."""
        limit = node.timeout_ns
        silent = limit > 0 and node.alive_at > 0 and now - node.alive_at > limit
        fault = node.in_fault and now - node.status_at < _FRESH_NS
        if not (silent or fault or self._wrong_since):
            return False
        name, running = self._names[node.node_id], self._robot.core.state is RobotState.RUNNING
        self._hold("running, and {} is silent", name, running and silent, now)
        self._hold("running, and {} is in fault", name, running and fault, now)
        return silent or fault

    def _judge_axes(self, node: NodeView, now: int, *, troubled: bool) -> None:
        """Judge that an axis told as enabled shows it on the wire, and while RUNNING each that is claimed."""
        wrong = now - node.status_at < _FRESH_NS and not node.enabled
        if not (wrong or self._wrong_since):
            return
        for joint in self._robot.core.joints.values():
            if joint.node.node_id == node.node_id:
                told = wrong and joint.enabled
                self._hold("{} is told enabled, and its statusword says no", joint.joint, told, now)
                claimed = wrong and not troubled and not joint.axis.number and joint.claimed not in (None, TARGET)
                off = claimed and self._robot.core.state is RobotState.RUNNING
                self._hold("running, and {} is claimed by a controller and off", joint.joint, off, now)

    def _hold(self, text: str, who: str, wrong: bool, now: int) -> None:
        """Tell what has been wrong for longer than it takes to be told."""
        since, what = self._wrong_since, (text, who)
        if not wrong:
            if since:
                since.pop(what, None)
        elif now - since.setdefault(what, now) > _SOON_NS and since[what] >= 0:
            since[what] = 1 << 62  # once
            self._tell("state_told", text.format(who))

    def _weigh(self, now: int) -> None:
        blocks = sys.getallocatedblocks()
        self._weigh_at = now + _MEMORY_NS
        if self._blocks is None:
            self._blocks = blocks
        elif blocks - self._blocks > _BLOCKS:
            self._tell("memory", f"{blocks - self._blocks} blocks of memory more than after a minute")
            self._blocks = blocks


def _is_off(node: NodeView, now: int) -> bool:
    """Whether a drive shows that it is not enabled, and has for a while."""
    return not node.enabled and node.shown_enabled_at < now - _SOON_NS and now - node.status_at < _FRESH_NS
