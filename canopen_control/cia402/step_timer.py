"""The time that a drive has for one step: one command, sent in one state.

Law of this file: each transition of the diagram has its time, by number. A step that asks for no transition, because
the drive is to stay where it is, has none. A step whose time is over is told once and not timed again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia402.events import TransitionTimedOut
from canopen_control.cia402.state import State, transition_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.cia402.state import Command

__all__ = ["SETTLE", "StepTimer", "transition_number"]

_NEVER: Final = (1 << 62) - 1
SETTLE = -1
"""In place of a transition number: the time after which a command that was overtaken no longer arrives."""


def transition_number(state: State | None, command: Command | None) -> int | None:
    """Return the number of the transition that `command` asks for in `state`, None where it asks for none."""
    transition = transition_of(state, command) if state is not None and command is not None else None
    return None if transition is None else transition.number


class StepTimer:
    """The timer of the present step: `command` is what is being sent, `deadline` is `_NEVER` for none."""

    def __init__(self, timeout_ns: int, timeouts: Mapping[int, int]) -> None:
        self.command: Command | None = None
        self.deadline = _NEVER
        self._timeout = timeout_ns
        self._timeouts = dict(timeouts)
        self._armed = False

    def rearm(self) -> None:
        """Begin a new step with the next command, even if it is the same: something else is wanted of it."""
        self._armed = False

    def enter(self) -> None:
        """Begin a new step with the next command, because the drive is in another state."""
        self._armed = False
        self.deadline = _NEVER

    def must_arm(self, command: Command | None) -> bool:
        """Whether `command` begins a new step."""
        return not self._armed or command is not self.command

    def arm(self, command: Command | None, number: int | None, now: int) -> None:
        """Begin the step `command`; `number` is that of its transition, None for no time."""
        self._armed, self.command = True, command
        self.deadline = _NEVER if number is None else now + self._timeouts.get(number, self._timeout)

    def timed_out(
        self, state: State | None, goal: State, statusword: int | None, gave_up: bool, now: int
    ) -> TransitionTimedOut:
        """Return the event of a step whose time is over; without a transition `goal` is what was wanted."""
        command = self.command
        transition = transition_of(state, command) if state is not None and command is not None else None
        wanted, number = (transition.target, transition.number) if transition is not None else (goal, None)
        return TransitionTimedOut(now, state, wanted, command, number, statusword, gave_up)
