"""The STOP latch: after a latched STOP no client can move the robot until a client releases the latch explicitly.

A latched STOP is never refused; a repeated STOP stops again and does not change the latch. A release enables nothing,
and commands from before the STOP are discarded: to move the robot, a client has to enable the drives and to send new
commands. The latch is stored in the state folder of the robot, so that a latched robot restarts latched, even after a
crash. This is a function of this program, not a safety function (ISO 13850).
"""

from __future__ import annotations

import json
import os
import time
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.objects import CONTROLWORD, axis_of
from canopen_control.errors import ControlError
from canopen_control.hardware.axis_statechart import Action
from canopen_control.master.event_log import Event, Level

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from canopen_control.controllers.base import Controller


MOVING_ACTIONS: Final = (Action.ENABLE, Action.HOME)
RELEASE: Final = "canopen-control stop --release"


class StopLatch:
    """STOP latch; `by` is the client that latched STOP, or None if not latched. `report` receives the events."""

    __slots__ = ("_path", "_report", "by")

    def __init__(self, report: Callable[[Event], None]) -> None:
        self._report = report
        self._path: Path | None = None
        self.by: str | None = None

    def keep(self, path: Path) -> None:
        """Restore the latch from the file `path`, and save later changes there."""
        self._path = path
        try:
            self.by = str(json.loads(path.read_text())["by"])
        except (FileNotFoundError, NotADirectoryError):
            return
        except (OSError, ValueError, LookupError, TypeError):  # the file exists, so STOP was latched
            self.by = "an earlier client"

    def report(self, now: int) -> None:
        """Report, at the start of a run, a STOP that is still latched from an earlier run."""
        if self.by is not None:
            text = f"STOP is latched since an earlier run (by {self.by}): nothing moves; release it: {RELEASE}"
            self._report(Event(now, "stop_latched", "", text, Level.WARNING))

    def _write_file(self, now: int) -> None:
        """Save the latch state to the file, if any; a failure is reported but does not change the state."""
        if self._path is None:
            return
        try:
            if self.by is None:
                self._path.unlink(missing_ok=True)
                return
            self._path.parent.mkdir(parents=True, exist_ok=True)
            temporary = self._path.with_suffix(".new")
            temporary.write_text(json.dumps({"by": self.by, "time": time.time()}) + "\n")
            os.replace(temporary, self._path)
        except OSError as error:
            consequence = (
                "the next run will still be latched" if self.by is None else "the next run will not be latched"
            )
            text = f"the STOP latch cannot be saved in {self._path}: {error.strerror or error}; {consequence}"
            self._report(Event(now, "latch_not_kept", "", text, Level.ERROR))

    @property
    def held(self) -> bool:
        return self.by is not None

    @property
    def hint(self) -> str | None:
        """Sentence about the latched STOP, with the release command, or None if not latched."""
        return None if self.by is None else f"STOP is latched (by {self.by}): {RELEASE}"

    def hold(self, by: str, now: int) -> None:
        """Latch STOP and report an event; do nothing if STOP is already latched."""
        if self.by is None:
            self.by = by
            text = f"STOP was latched by {by}: nothing moves before it is released"
            self._report(Event(now, "stop_latched", "", text, Level.WARNING))
            self._write_file(now)

    def release(self, by: str, now: int) -> None:
        """Release the latch and report an event; do nothing if STOP is not latched."""
        if self.by is not None:
            self.by = None
            text = f"STOP was released by {by}; the drives stay disabled until you enable them"
            self._report(Event(now, "stop_released", "", text, Level.WARNING))
            self._write_file(now)

    def refuse(self, *request: str) -> None:
        """Raise ControlError while STOP is latched; the message begins with the words in `request`."""
        if self.by is not None:
            doing = " ".join(request)
            raise ControlError(f"{doing} is refused: STOP is latched (by {self.by}); release it first: {RELEASE}")

    def check_action(self, action: Action) -> None:
        """Raise ControlError for enabling or homing while STOP is latched; all other actions are allowed."""
        if action in MOVING_ACTIONS:
            self.refuse("axis", action.value)

    def check_controllers(self, controllers: Iterable[Controller]) -> None:
        """Raise ControlError for controllers with command interfaces while STOP is latched."""
        for controller in controllers:
            if controller.command_interface_names():
                self.refuse("activating", controller.name)

    def check_write(self, index: int) -> None:
        """Raise ControlError for an SDO write of a controlword while STOP is latched."""
        if is_controlword(index):
            self.refuse(f"writing the controlword (0x{index:04X})")


def is_controlword(index: int) -> bool:
    """Whether `index` is the controlword of any axis of a device (0x6040 plus a multiple of 0x800)."""
    return axis_of(index)[0] == CONTROLWORD
