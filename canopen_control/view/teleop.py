"""Driving by a held button: who drives, and what is sent when he lets go. No browser, no socket.

The law of this file: nothing moves but while a button is held, and a held button says so again and again. Silence for
`LET_GO_NS`, a closed page or another controller end the motion with the rest command, once and at once. One page
drives at a time; who comes second waits until the first has let go.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

__all__ = ["HOLD_HZ", "LET_GO_NS", "DeadMan", "Motion", "joint_motion", "twist_motion"]

HOLD_HZ: Final = 20.0
LET_GO_NS: Final = 200_000_000


@dataclass(frozen=True, slots=True)
class Motion:
    """A method of the API with what moves and what rests: parameters of the command, `controller` among them."""

    method: str
    moving: Mapping[str, Any]
    resting: Mapping[str, Any]


def twist_motion(controller: str, linear: float, angular: float) -> Motion:
    """Return the motion of a base: m/s and rad/s."""
    return Motion(
        "twist",
        {"controller": controller, "linear": linear, "angular": angular},
        {"controller": controller, "linear": 0.0, "angular": 0.0},
    )


def joint_motion(controller: str, values: Sequence[float], resting: Sequence[float]) -> Motion:
    """Return the motion of joints to `values`; they rest at zero, or where they are if these are positions."""
    return Motion(
        "command",
        {"controller": controller, "values": list(values)},
        {"controller": controller, "values": list(resting)},
    )


class DeadMan:
    """`send(method, params)` is called with every command."""

    def __init__(self, send: Callable[[str, dict[str, Any]], object]) -> None:
        self._send = send
        self._driver: int | None = None
        self._motion: Motion | None = None
        self._heard = 0

    @property
    def driver(self) -> int | None:
        """The page that drives, None if nobody does."""
        return self._driver

    @property
    def deadline(self) -> int | None:
        """When `tick` is due, in ns."""
        return None if self._driver is None else self._heard + LET_GO_NS

    def hold(self, page: int, motion: Motion, now: int) -> bool:
        """Take note that a page holds a button; False if another one drives."""
        self.tick(now)
        if self._driver not in (None, page):
            return False
        before = self._motion
        if before is not None and before.moving["controller"] != motion.moving["controller"]:
            self._send(before.method, dict(before.resting))
        self._driver, self._motion, self._heard = page, motion, now
        self._send(motion.method, dict(motion.moving))
        return True

    def tick(self, now: int) -> None:
        """Let go when nobody has held for too long."""
        if self._driver is not None and now - self._heard >= LET_GO_NS:
            self.let_go()

    def leave(self, page: int) -> None:
        """Let go, because the page has been closed; other pages' driving goes on."""
        if page == self._driver:
            self.let_go()

    def let_go(self) -> None:
        """End the motion now."""
        motion, self._driver, self._motion = self._motion, None, None
        if motion is not None:
            self._send(motion.method, dict(motion.resting))
