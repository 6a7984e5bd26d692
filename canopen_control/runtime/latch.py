"""The latched STOP: no client makes anything move until somebody releases it on purpose.

The law of this file: latching stops first and is never refused; a second STOP changes nothing but is done again.
Releasing enables nothing, and what was commanded before the STOP counts no more: whoever wants the robot to move has
to enable its drives and to command it anew. A latched robot comes back latched, however it ended: the latch is a file
below the state folder, one for each robot's name. This is a function of this program, no safety function (ISO 13850).
"""

from __future__ import annotations

import json
import os
import time
from typing import TYPE_CHECKING

from canopen_control.cia402.objects import CONTROLWORD, axis_of
from canopen_control.errors import ControlError
from canopen_control.hardware.axis_power import Action
from canopen_control.master.event_log import Event, Level

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from canopen_control.controllers.base import Controller

__all__ = ["StopLatch", "is_controlword"]

RELEASE = "canopen-control stop --release"
_MOVING = (Action.ENABLE, Action.HOME)


class StopLatch:
    """Whether STOP is latched: `by` says who did it, None while it is not. `report` is told of both ends."""

    __slots__ = ("_path", "_report", "by")

    def __init__(self, report: Callable[[Event], None]) -> None:
        self._report = report
        self._path: Path | None = None
        self.by: str | None = None

    def keep(self, path: Path) -> None:
        """Outlive this process in the file `path`, and be what that says: latched, if it is there."""
        self._path = path
        try:
            self.by = str(json.loads(path.read_text())["by"])
        except FileNotFoundError:
            return
        except (OSError, ValueError, LookupError, TypeError):  # it is there: somebody has latched it
            self.by = "somebody before"

    def tell(self, now: int) -> None:
        """Say, at the start, that it is latched still."""
        if self.by is not None:
            text = f"STOP is latched since an earlier run (by {self.by}): nothing moves; release it: {RELEASE}"
            self._report(Event(now, "stop_latched", "", text, Level.WARNING))

    def _write_down(self, now: int) -> None:
        """Make the file what the latch is; a file that cannot be written is told, and the latch holds all the same."""
        if self._path is None:
            return
        try:
            if self.by is None:
                self._path.unlink(missing_ok=True)
                return
            self._path.parent.mkdir(parents=True, exist_ok=True)
            fresh = self._path.with_suffix(".new")
            fresh.write_text(json.dumps({"by": self.by, "time": time.time()}) + "\n")
            os.replace(fresh, self._path)
        except OSError as error:
            what = "the next run will be latched still" if self.by is None else "the next run will not be latched"
            text = f"the STOP latch cannot be kept in {self._path}: {error.strerror or error}; {what}"
            self._report(Event(now, "latch_not_kept", "", text, Level.ERROR))

    @property
    def held(self) -> bool:
        """Whether nothing may move."""
        return self.by is not None

    @property
    def hint(self) -> str | None:
        """What to do next while nothing may move."""
        return None if self.by is None else f"STOP is latched (by {self.by}): {RELEASE}"

    def hold(self, by: str, now: int) -> None:
        """Latch it; a second one leaves the credit to the first."""
        if self.by is None:
            self.by = by
            text = f"STOP by {by}, latched: nothing moves before it is released"
            self._report(Event(now, "stop_latched", "", text, Level.WARNING))
            self._write_down(now)

    def release(self, by: str, now: int) -> None:
        """Let go; a second call does nothing."""
        if self.by is not None:
            self.by = None
            text = f"STOP was released by {by}; the drives stay disabled until somebody enables them"
            self._report(Event(now, "stop_released", "", text, Level.WARNING))
            self._write_down(now)

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
