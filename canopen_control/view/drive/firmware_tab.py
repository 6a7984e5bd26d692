"""The Firmware tab: choose a program, load it with a progress that tells rate and remaining time, and its verdict."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from nicegui import ui

from canopen_control.errors import ConfigError
from canopen_control.view.drive.drive_tab import LOOK_ONLY
from canopen_control.view.drive.release_panel import ReleasePanel
from canopen_control.view.drive.work_bar import WorkBar
from canopen_control.view.elements.nicegui_elements import FileUpload
from canopen_control.view.firmware_job import MOST_BYTES, check_image, load_program, options_of
from canopen_control.view.node_desk import NodeWork
from canopen_control.view.panels.panel import Html, tell
from canopen_control.view.words import BAD, IDLE, sentence

if TYPE_CHECKING:
    from nicegui.events import UploadEventArguments

    from canopen_control.view.drive.drive_tab import DriveTabContext
    from canopen_control.view.page_content import PageContent

__all__ = ["FirmwareTab"]

_KEY: Final = "firmware"
_WHAT: Final = (
    "The program is stopped and cleared (0x1F51), sent (0x1F50), checked (0x1F57, 0x1F56) and started. An "
    "interrupted transfer restarts; a drive without a program waits in its boot loader for the next attempt. A "
    "download cannot be cancelled from here: a partial program is unusable."
)
_TOO_LONG: Final = f"{MOST_BYTES} bytes at most go through a running robot"


class FirmwareTab:
    """Begins the download at the node's desk and follows it."""

    def __init__(self, context: DriveTabContext) -> None:
        self._context, self._desk = context, context.desk
        self._image: tuple[str, bytes] | None = None
        self._load: ui.button | None = None
        with ui.element("section").classes("cc-panel"):
            ui.html("Now", sanitize=False, tag="h2")
            self._release = ReleasePanel(context)
            self._bar = WorkBar(self._desk, _KEY, can_end=False)
        with ui.element("section").classes("cc-panel"):
            ui.html("Program", sanitize=False, tag="h2")
            ui.html(f"<p class='cc-note'>{_WHAT}</p>", sanitize=False)
            if context.panel.teleop:
                self._make_form()
            else:
                ui.html(LOOK_ONLY, sanitize=False)

    def _make_form(self) -> None:
        self._upload = FileUpload(
            "Choose the firmware file as supplied by the manufacturer",
            self._take,
            lambda: self._refuse(_TOO_LONG),
            MOST_BYTES,
        )
        self._told = Html()
        with ui.element("div").classes("cc-row"):
            self._number = ui.input("program", value="1").props("dense").style("width: 6em")
            self._expected = ui.input("0x1F56 has to be (optional)").props("dense").style("width: 16em")
        with ui.element("div").classes("cc-row cc-acts"):
            self._load = ui.button("Load it into the drive", color="orange-9", on_click=self._begin)
            self._load.props("unelevated dense")

    def show(self, content: PageContent) -> None:
        """Follow the node and the work."""
        self._release.show(content)
        self._bar.show()
        if self._load is not None:
            self._load.set_enabled(not content.lost and not self._desk.busy and self._image is not None)

    def leave(self) -> None:
        """Leave it: a download that has begun goes on."""

    async def _take(self, event: UploadEventArguments) -> None:
        self._upload.reset()
        name = event.file.name
        try:
            if event.file.size() > MOST_BYTES:
                raise ConfigError(f"{name}: {_TOO_LONG}")
            image = await event.file.read()
            check_image(image, name)
        except ConfigError as error:
            self._refuse(str(error))
            return
        self._image = name, image
        self._told.show(sentence(f"{name}: {len(image):,} bytes", IDLE))

    def _refuse(self, why: str) -> None:
        self._image = None
        self._told.show(sentence(f"Not taken. {why}", BAD))

    def _begin(self) -> None:
        if self._image is None or not self._context.panel.teleop:
            return
        name, image = self._image
        try:
            options = options_of(str(self._number.value or ""), str(self._expected.value or ""))
        except ConfigError as error:
            tell("Not begun", str(error))
            return
        work = NodeWork(_KEY, f"Loading {name} into {self._context.node}", "bytes")
        refused = self._desk.begin(work, lambda session, told: load_program(session, told, image, options))
        if refused is not None:
            tell("Not begun", refused)
        self._bar.show()
