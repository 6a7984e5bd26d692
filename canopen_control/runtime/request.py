"""Something asked of axes that takes time: answered when it is reached, fails, or runs out of time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.hardware.joint import Action, Wish

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.hardware.joint import JointDrive

__all__ = ["AxisRequest"]


class AxisRequest:
    """`action` on `joints`; `done` is called once, with None or a sentence that names who did not do it and why."""

    def __init__(
        self, joints: Sequence[JointDrive], action: Action, deadline: int, done: Callable[[str | None], None]
    ) -> None:
        self._joints, self._action, self._deadline, self._done = joints, action, deadline, done
        self._cycles = 0

    def settle(self, now: int) -> bool:
        """Look whether it is over, once per cycle; the first look comes after the drives had a chance to answer."""
        self._cycles += 1
        late = [joint for joint in self._joints if not joint.reached(self._action)]
        if self._cycles > 1 and not late:
            self._done(None)
            return True
        refused = [joint for joint in late if self._refused(joint)]
        if self._cycles > 1 and (refused or now > self._deadline):
            self._done("; ".join(self._reason(joint) for joint in refused or late))
            return True
        return False

    def fail(self, reason: str) -> None:
        """End it without success."""
        self._done(reason)

    def _refused(self, joint: JointDrive) -> bool:
        """Whether waiting longer is of no use."""
        if self._action is Action.ENABLE:
            return joint.wish is not Wish.ON
        return self._action is Action.FAULT_RESET and not joint.machine.resetting

    def _reason(self, joint: JointDrive) -> str:
        node, state = joint.node, joint.state
        seen = "no statusword" if joint.statusword is None else f"statusword 0x{joint.statusword:04X}"
        name = "not there" if state is None else state.name.replace("_", " ")
        cause = f"; {node.error}" if node.error else ""
        return f"node {node.node_id} ({node.name}): {self._action.value} not reached, it is {name} ({seen}){cause}"
