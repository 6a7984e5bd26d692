"""What the statusword and the motion tell beside the state: warning, limit, following error, a wrong direction.

The law of this file: each is told when it begins, not while it lasts. An active limit closes the direction in which the
axis went and leaves the other open. An axis that turns against its command is told from one that lags by both being
large for `PATIENCE` looks on end.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import INTERNAL_LIMIT, WARNING
from canopen_control.hardware.interfaces import POSITION
from canopen_control.hardware.news import News
from canopen_control.master.events import Level

if TYPE_CHECKING:
    from canopen_control.hardware.axis import Axis
    from canopen_control.hardware.axis_modes import ModeTarget
    from canopen_control.master.cycle import Output

__all__ = ["Watch"]

PATIENCE: Final = 5  # looks, of a tenth of a second each
_FOLLOWING: Final = 1 << 13
_BITS: Final = WARNING | INTERNAL_LIMIT | _FOLLOWING
_FOLLOWING_MODES = (OperationMode.PP, OperationMode.CSP)
_NEGATIVE_SWITCH, _POSITIVE_SWITCH = 1, 2  # 0x60FD
_SIDES = {1: "positive", -1: "negative", 0: "unknown"}


class Watch:
    """Looks at one axis; `action` is what a following error leads to: stop, warn or ignore."""

    def __init__(self, axis: Axis, action: str) -> None:
        self._axis, self._action = axis, action
        self._bits = 0
        self._against = 0
        self._last_target = 0
        self._limit_at = 0  # the position at which the limit was reached
        self._targets: tuple[Output | None, Output | None] = (
            axis.output(objects.TARGET_VELOCITY),
            axis.output(objects.TARGET_POSITION),
        )

    def look(self, word: int, mode: int | None, target: ModeTarget | None) -> list[News]:
        """Take a statusword and return what began or ended with it."""
        rose, fell = word & ~self._bits & _BITS, self._bits & ~word & _BITS
        if not rose | fell:
            return []
        self._bits = word & _BITS
        news = []
        if rose & WARNING:
            news.append(News("warning", f"warning (statusword 0x{word:04X})"))
        if rose & INTERNAL_LIMIT:
            news += self._limit(target)
        if rose & _FOLLOWING and mode in _FOLLOWING_MODES and self._action != "ignore":
            text = f"following error (statusword 0x{word:04X})"
            stops = self._action == "stop"
            news.append(News("following_error", text, Level.ERROR if stops else Level.WARNING, stops))
        return news

    def leaves_limit(self) -> bool:
        """Look, ten times a second, whether a limit that shows no more was left: by a motion the other way."""
        limits = self._axis.limits
        if not limits.blocked or self._bits & INTERNAL_LIMIT:
            return False
        way = self._axis.raw_position - self._limit_at
        if way * limits.blocked >= 0:
            return False
        limits.blocked = 0
        return True

    def turns_the_wrong_way(self, enabled: bool) -> bool:
        """Look, ten times a second, whether the axis turns against its velocity target."""
        output, actual = self._targets[0], self._axis.velocity
        if output is None or actual is None or not enabled or not actual.fresh:
            self._against = 0
            return False
        target, speed = output.value, actual.value
        steady, self._last_target = target == self._last_target, target
        against = steady and target * speed < 0 and abs(speed) * 2 > abs(target)
        self._against = self._against + 1 if against else 0
        return self._against == PATIENCE

    def _limit(self, target: ModeTarget | None) -> list[News]:
        limits = self._axis.limits
        if limits.blocked:
            return []  # the same limit, touched again
        limits.blocked = self._direction(target)
        self._limit_at = self._axis.raw_position
        side = _SIDES[limits.blocked]
        return [News("limit", f"limit reached, {side} side; only the other direction is followed", Level.WARNING)]

    def _direction(self, target: ModeTarget | None) -> int:
        """Return the side of the limit: the switch that is closed, else where the target lies."""
        inputs = self._axis.digital_inputs
        switches = inputs.value & 3 if inputs is not None and inputs.fresh else 0
        if switches in (_NEGATIVE_SWITCH, _POSITIVE_SWITCH):
            return 1 if switches == _POSITIVE_SWITCH else -1
        velocity, position = self._targets
        if target is not None and target.interface == POSITION and position is not None:
            way = position.value - self._axis.raw_position
        else:
            way = velocity.value if velocity is not None else 0
        return (way > 0) - (way < 0)
