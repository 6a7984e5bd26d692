"""STOP that stays: while it is latched no client makes anything move, until somebody releases it on purpose.

The law of this file: latching stops first and is never refused; a second STOP changes nothing but is done again.
Releasing enables nothing, and what was commanded before the STOP counts no more: whoever wants the robot to move has
to enable its drives and to command it anew. This is a function of this program, no safety function (ISO 13850).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from canopen_control.cia402.objects import CONTROLWORD, axis_of
from canopen_control.errors import ControlError
from canopen_control.hardware.interfaces import POSITION
from canopen_control.hardware.wishes import Action
from canopen_control.master.events import Event, Level

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.controllers.base import Controller

__all__ = ["StopLatch", "forget_commands", "is_controlword"]

RELEASE = "canopen-control stop --release"
_MOVING = (Action.ENABLE, Action.HOME)


class StopLatch:
    """Whether STOP is latched: `by` says who did it, None while it is not. `report` is told of both ends."""

    __slots__ = ("_report", "by")

    def __init__(self, report: Callable[[Event], None]) -> None:
        self._report = report
        self.by: str | None = None

    @property
    def held(self) -> bool:
        """Whether nothing may move."""
        return self.by is not None

    def hold(self, by: str, controllers: Iterable[Controller], now: int) -> None:
        """Latch it and have the controllers forget their commands; a second one leaves the credit to the first."""
        if self.by is None:
            self.by = by
            text = f"STOP by {by}, latched: nothing moves before it is released"
            self._report(Event(now, "stop_latched", "", text, Level.WARNING))
        forget_commands(controllers, now)

    def release(self, by: str, now: int) -> None:
        """Let go; a second call does nothing."""
        if self.by is not None:
            self.by = None
            text = f"STOP was released by {by}; the drives stay disabled until somebody enables them"
            self._report(Event(now, "stop_released", "", text, Level.WARNING))

    def refuse(self, *what: str) -> None:
        """Raise ControlError while it is latched; the sentence begins with `what` and says how to go on."""
        if self.by is not None:
            doing = " ".join(what)
            raise ControlError(f"{doing} is refused: STOP is latched (by {self.by}); release it first: {RELEASE}")

    def check_action(self, action: Action) -> None:
        """Refuse what would move an axis; disabling, halting and acknowledging faults stay possible."""
        if action in _MOVING:
            self.refuse("axis", action.value)

    def check_controllers(self, controllers: Iterable[Controller]) -> None:
        """Refuse to activate controllers that command something."""
        for controller in controllers:
            if controller.command_interface_names():
                self.refuse("activating", controller.name)

    def check_write(self, index: int) -> None:
        """Refuse a controlword past the controllers, by SDO."""
        if is_controlword(index):
            self.refuse(f"writing the controlword (0x{index:04X})")


def is_controlword(index: int) -> bool:
    """Whether an object is the controlword of one of a device's axes."""
    return axis_of(index)[0] == CONTROLWORD


def forget_commands(controllers: Iterable[Controller], now: int) -> None:
    """Put active controllers back to where no command had come yet; velocity and effort targets become 0.0."""
    for controller in controllers:
        if not controller.commands:
            continue
        controller.on_deactivate(now)
        for command in controller.commands:
            if command.interface == POSITION:
                command.value = math.nan  # the hardware holds where it is, and does not go on to the old target
        controller.on_activate(controller.commands, controller.states, now)
