"""Motion check of an enabled axis, ten times a second: detects standstill and motion away from the target.

Positions are compared in counts. A drive that is enabled and takes its set-points from another source, or whose brake
is still shut, stands; one whose feedback is mirrored moves away from its target. An axis that stands at a limit of its
own (statusword bit 11), or is halted, has a reason that is reported elsewhere. Where set-points of a position mode go
on without an axis that has not moved since its enable, it is late: it would leap to them when its brake has lifted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia402.state import INTERNAL_LIMIT
from canopen_control.hardware.feedback import STANDSTILL
from canopen_control.hardware.joint_events import WRONG_LOOKS
from canopen_control.hardware.joint_targets import VelocityTarget
from canopen_control.urdf.joint_element import POSITION

if TYPE_CHECKING:
    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.hardware.axis import AxisProcessData
    from canopen_control.hardware.joint_targets import ModeTarget


STANDING_LOOKS: Final = 15  # of a tenth of a second each
_LATE_LOOKS: Final = 2
_WAY: Final = 0.02  # rad or m: a smaller distance to the target asks for no motion
_STEP: Final = STANDSTILL / 10  # rad or m in one look


class MotionWatch:
    """Motion check of one axis. `stands`, `late` and `turns_away` are True once, when detected.

    `unmoved`: set-points have left an axis that has not moved since its enable.
    """

    def __init__(self, axis: AxisProcessData, machine: DriveMachine) -> None:
        self._axis, self._machine = axis, machine
        self.stands = self.late = self.turns_away = False
        self._standing = self._away = 0
        self._moved = False  # since its enable
        self._still: int | None = None  # the position of the last look that saw a motion
        self._rest: int | None = None  # where the present motion began
        self._last = 0
        self._right = False  # the present motion has led towards its target

    def look(self, target: ModeTarget | None, enabled: bool) -> None:
        """Compare the target sent with the motion since the last check."""
        self.stands = self.late = self.turns_away = False
        position = self._axis.position
        if not enabled or target is None or position is None or not position.fresh or self._machine.halted:
            self._standing = self._away = 0
            self._still = self._rest = None
            self._moved = self._moved and enabled
            return
        here = self._axis.raw_position + self._axis.unwrap.offset
        step, self._last = here - self._last, here
        scale = abs(self._axis.scale.pos_to_dev)
        self._look_standing(target, here, scale)
        if target.interface == POSITION and self._rest is not None:
            self._look_direction(self._way(target), here, step, scale)
        else:
            self._away = 0
            self._rest = here

    @property
    def unmoved(self) -> bool:
        """Whether an axis with position set-points has not moved since its enable."""
        return not self._moved and self._standing > 0

    def _way(self, target: ModeTarget) -> int:
        """Return the counts from the position to the target, within half a turn of the counter."""
        raw: int = target.output.value
        return (raw - self._axis.raw_position + (1 << 31)) % (1 << 32) - (1 << 31)

    def _asks(self, target: ModeTarget, scale: float) -> bool:
        """Whether the target requires a motion large enough to be measured."""
        if target.interface == POSITION:
            return abs(self._way(target)) > _WAY * scale
        return isinstance(target, VelocityTarget) and abs(target.output.value / target.factor()) > STANDSTILL

    def _look_standing(self, target: ModeTarget, here: int, scale: float) -> None:
        limited = self._axis.limits.blocked != 0 or bool((self._machine.statusword or 0) & INTERNAL_LIMIT)
        moved = self._still is None or abs(here - self._still) > max(1.0, _STEP * scale)
        if moved:
            self._moved = self._moved or self._still is not None
            self._still = here
        self._standing = 0 if moved or limited or not self._asks(target, scale) else self._standing + 1
        self.stands = self._standing == STANDING_LOOKS
        cyclic = target.tracks and target.interface == POSITION
        self.late = cyclic and not self._moved and self._standing == _LATE_LOOKS

    def _look_direction(self, way: int, here: int, step: int, scale: float) -> None:
        """Count checks with a motion away from the target; a reversal during a profile does not count."""
        if abs(step) < _STEP * scale:
            self._rest, self._right, self._away = here, False, 0
            return
        if way * step > 0:
            self._right = True
        wrong = not self._right and way * step < 0 and abs(way) > _WAY * scale
        self._away = self._away + 1 if wrong else 0
        self.turns_away = self._away == WRONG_LOOKS
