"""Switches that break the virtual drives, on the page.

The law of this file: it is there only while there are virtual drives; what is asked of them is asked by viser's own
threads, so that a drive that hangs holds nothing up but its own answer.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import RemoteError
from canopen_control.view.controls import tell
from canopen_control.view.words import active_faults, fault_text

if TYPE_CHECKING:
    import viser

    from canopen_control.view.faults import FaultDesk

__all__ = ["FaultPanel"]

ON: Final = "Switch on"
OFF: Final = "Switch off"


class FaultPanel:
    """A folder with drive, fault, what it does, and what is on; `refresh` looks who is there."""

    def __init__(self, gui: viser.GuiApi, desk: FaultDesk) -> None:
        self._desk, self._busy = desk, threading.Lock()
        self._faults: dict[str, dict[str, Any]] = {}
        self._folder = gui.add_folder("Break a virtual drive", expand_by_default=False, visible=False)
        with self._folder:
            self._drive = gui.add_dropdown("drive", ("-",))
            self._fault = gui.add_dropdown("fault", ("-",))
            self._text = gui.add_html(_box(fault_text(None)))
            self._switch = gui.add_button_group("", (ON, OFF))
            self._active = gui.add_html(_box(active_faults({})))
        self._fault.on_update(lambda _event: self._explain())
        self._drive.on_update(lambda _event: self.refresh())
        self._switch.on_click(self._on_switch)

    def refresh(self) -> None:
        """Look which virtual drives are there and what is on; waits for their answers, one caller at a time."""
        if not self._busy.acquire(blocking=False):
            return
        try:
            drives = self._desk.drives()
            self._show(drives)
        except RemoteError:
            self._folder.visible = False  # it went away between two questions; the next look tells
        finally:
            self._busy.release()

    def _show(self, drives: list[str]) -> None:
        if bool(drives) is not self._folder.visible:
            self._folder.visible = bool(drives)
        if not drives:
            return
        if tuple(drives) != self._drive.options:
            self._drive.options = tuple(drives)
        found = {drive: self._desk.faults(drive) for drive in drives}
        self._faults = {fault["name"]: fault for fault in found[self._drive.value]}
        if tuple(self._faults) != self._fault.options:
            self._fault.options = tuple(self._faults)
            self._explain()
        self._active.content = _box(
            active_faults({drive: [fault["name"] for fault in each if fault["on"]] for drive, each in found.items()})
        )

    def _explain(self) -> None:
        self._text.content = _box(fault_text(self._faults.get(self._fault.value)))

    def _on_switch(self, event: viser.GuiEvent[Any]) -> None:
        try:
            self._desk.switch(self._drive.value, self._fault.value, on=event.target.value == ON)
        except (RemoteError, KeyError) as error:
            tell(event.client, "Not switched", str(error))
        self.refresh()


def _box(html: str) -> str:
    return f"<div class='cc-box'>{html}</div>"
