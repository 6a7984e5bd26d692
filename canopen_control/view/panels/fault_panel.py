"""Panel for faults and quirks of virtual drives and inputs of virtual devices, hidden without virtual nodes."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from nicegui import ui

from canopen_control.client.drive_client import signal_values
from canopen_control.errors import ConfigError, RemoteError
from canopen_control.view.panels.panel import Html, show_notice
from canopen_control.view.robot_connection import in_thread
from canopen_control.view.words import active_faults, fault_text, quirk_text

if TYPE_CHECKING:
    from canopen_control.rpc.messages.drive import QuirkListing
    from canopen_control.view.page_content import DriveFaults, PageContent
    from canopen_control.view.panels.panel import PanelContext


class FaultPanel:
    """Panel that switches faults and quirks of a virtual drive, and sets the inputs of a virtual device."""

    def __init__(self, context: PanelContext) -> None:
        self._context = context
        self._board: DriveFaults | None = None
        self._whole = ui.expansion("Faults of virtual drives").props("dense").classes("cc-stale w-full")
        self._whole.set_visibility(False)
        with self._whole:
            self._drive = ui.select([], label="drive", on_change=self._follow).props("dense").style("width: 100%")
            self._fault = ui.select([], label="fault", on_change=self._explain).props("dense").style("width: 100%")
            self._text = Html()
            with ui.element("div").classes("cc-row"):
                ui.button("Switch on", color="red-8", on_click=partial(self._switch, True)).props("dense unelevated")
                ui.button("Switch off", color="blue-grey-6", on_click=partial(self._switch, False)).props(
                    "dense outline"
                )
            self._quirk = ui.select([], label="quirk", on_change=self._explain_quirk).props("dense")
            self._quirk.style("width: 100%")
            self._quirk_text = Html()
            with ui.element("div").classes("cc-row"):
                self._strength = ui.input("strength, or @AXIS").props("dense")
                ui.button("Quirk on", color="red-8", on_click=partial(self._switch_quirk, True)).props(
                    "dense unelevated"
                )
                ui.button("Quirk off", color="blue-grey-6", on_click=partial(self._switch_quirk, False)).props(
                    "dense outline"
                )
            self._inputs = ui.element("div").classes("cc-row")
            with self._inputs:
                self._signals = ui.input("inputs, as di0=1,ai0=16384").props("dense")
                ui.button("Set", color="blue-grey-6", on_click=self._set).props("dense outline")
            self._active = Html()

    def show(self, content: PageContent) -> None:
        board = content.faults
        if board is None or board == self._board:
            return
        self._board = board
        drives = list(board.drives)
        self._whole.set_visibility(bool(drives))
        if drives != self._drive.options:
            self._drive.set_options(
                drives, value=self._drive.value if self._drive.value in drives else next(iter(drives), None)
            )
        self._follow()
        self._active.show(active_faults(board.active) if drives else "")

    def _follow(self) -> None:
        faults = self._board.drives.get(self._drive.value or "", ()) if self._board is not None else ()
        self._inputs.set_visibility(any(fault.acts == "input" for fault in faults))
        names = [fault.name for fault in faults]
        if names != self._fault.options:
            self._fault.set_options(
                names, value=self._fault.value if self._fault.value in names else next(iter(names), None)
            )
        quirks = [quirk.name for quirk in self._quirks()]
        self._quirk.set_visibility(bool(quirks))
        if quirks != self._quirk.options:
            self._quirk.set_options(
                quirks, value=self._quirk.value if self._quirk.value in quirks else next(iter(quirks), None)
            )
        self._explain()
        self._explain_quirk()

    def _quirks(self) -> tuple[QuirkListing, ...]:
        return self._board.quirks.get(self._drive.value or "", ()) if self._board is not None else ()

    def _explain_quirk(self) -> None:
        chosen = next((quirk for quirk in self._quirks() if quirk.name == self._quirk.value), None)
        self._quirk_text.show(quirk_text(chosen))

    def _explain(self) -> None:
        faults = self._board.drives.get(self._drive.value or "", ()) if self._board is not None else ()
        self._text.show(fault_text(next((fault for fault in faults if fault.name == self._fault.value), None)))

    async def _set(self) -> None:
        drive, client = self._drive.value, self._context.robot.fault_client
        try:
            await in_thread(partial(client.set_signals, drive or "", signal_values(self._signals.value or "")))
        except (ConfigError, RemoteError) as error:
            show_notice("Not set", str(error))

    async def _switch_quirk(self, on: bool) -> None:
        drive, quirk, client = self._drive.value, self._quirk.value, self._context.robot.fault_client
        if not drive or not quirk:
            return
        strength = (self._strength.value or "").strip() if on else ""
        text = f"{quirk}{strength}" if strength.startswith(("@", "=")) or not strength else f"{quirk}={strength}"
        try:
            await in_thread(partial(client.switch_quirk, drive, text, on=on))
        except RemoteError as error:
            show_notice("Not switched", str(error))
        self._context.refresh_faults()

    async def _switch(self, on: bool) -> None:
        drive, fault, context = self._drive.value, self._fault.value, self._context.robot.fault_client
        if not drive or not fault:
            return
        try:
            await in_thread(partial(context.switch, drive, fault, on=on))
        except RemoteError as error:
            show_notice("Not switched", str(error))
        self._context.refresh_faults()
