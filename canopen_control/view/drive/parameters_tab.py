"""The Parameters tab: backup to a file, comparison with one, restore of one, and clone from another node."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from nicegui import ui

from canopen_control.errors import CanopenError, ConfigError
from canopen_control.service.guarded_restore import RestoreOptions
from canopen_control.service.restore_journal import Reached
from canopen_control.view import parameter_jobs as jobs
from canopen_control.view.drive.drive_tab import LOOK_ONLY
from canopen_control.view.drive.release_panel import ReleasePanel
from canopen_control.view.drive.work_bar import WorkBar
from canopen_control.view.elements.nicegui_elements import FileUpload
from canopen_control.view.node_desk import NodeWork
from canopen_control.view.panels.panel import Html
from canopen_control.view.robot_connection import in_thread
from canopen_control.view.words import BAD, IDLE, sentence

if TYPE_CHECKING:
    from collections.abc import Callable

    from nicegui.events import UploadEventArguments

    from canopen_control.service.node_session import NodeSession
    from canopen_control.service.parameter_set import ParameterSet
    from canopen_control.view.drive.drive_tab import DriveTabContext
    from canopen_control.view.page_content import PageContent

__all__ = ["ParametersTab"]

_KEY: Final = "parameters"
_BACKUP: Final = (
    "Saves all read/write parameters (no commands or live values) as a DCF; each is read twice. Nothing is written to "
    "the drive, so this works while the robot runs."
)
_RESTORE: Final = (
    "Only differences are written, then everything is read back. If the drive refuses a value, all previous "
    "values are restored. Node id, bit rate and another drive's calibration stay."
)
_TOO_LONG: Final = f"A DCF of {jobs.MOST_BYTES} bytes at most is wanted"


class ParametersTab:
    """Begins the work at the node's desk and follows it."""

    def __init__(self, context: DriveTabContext) -> None:
        self._context, self._desk = context, context.desk
        self._file: ParameterSet | None = None
        self._writers: list[ui.button] = []
        writes = context.panel.teleop
        with ui.element("section").classes("cc-panel"):
            ui.html("Now", sanitize=False, tag="h2")
            self._release = ReleasePanel(context)
            self._bar = WorkBar(self._desk, _KEY)
        with ui.element("div").classes("cc-tab-columns"):
            with ui.element("section").classes("cc-panel"):
                ui.html("Backup", sanitize=False, tag="h2")
                ui.html(f"<p class='cc-note'>{_BACKUP}</p>", sanitize=False)
                self._backup = ui.button("Back up", color="blue-9", on_click=self._begin_backup)
                self._backup.props("unelevated dense")
            with ui.element("section").classes("cc-panel"):
                ui.html("A file", sanitize=False, tag="h2")
                self._make_upload()
                self._diff = ui.button("Compare with the node", color="blue-9", on_click=self._begin_diff)
                self._diff.props("unelevated dense")
            with ui.element("section").classes("cc-panel"):
                ui.html("Restore and clone", sanitize=False, tag="h2")
                ui.html(f"<p class='cc-note'>{_RESTORE}</p>", sanitize=False)
                if writes:
                    self._make_options()
                else:
                    ui.html(LOOK_ONLY, sanitize=False)

    def _make_upload(self) -> None:
        self._upload = FileUpload("Choose a DCF", self._take, lambda: self._refuse(_TOO_LONG), jobs.MOST_BYTES)
        self._upload.props("accept='.dcf,.eds'")
        self._told = Html()

    def _make_options(self) -> None:
        self._store = ui.checkbox("store in the drive (0x1010), once all is proven").props("dense")
        self._keep = ui.checkbox("keep what the drive took, where it refuses some").props("dense")
        self._any = ui.checkbox("also the backup of another drive on another node id").props("dense")
        self._protect = ui.input("leave as they are, as in 0x2*, Home offset").props("dense").style("width: 100%")
        with ui.element("div").classes("cc-row cc-acts"):
            restore = ui.button("Restore the file", color="orange-9", on_click=self._begin_restore)
            self._writers.append(restore.props("unelevated dense"))
        others = [each for each in self._context.panel.robot.node_names if each != self._context.node]
        if not others:
            return
        self._source = ui.select(others, value=others[0], label="clone from").props("dense").style("width: 100%")
        with ui.element("div").classes("cc-row cc-acts"):
            clone = ui.button("Clone into this node", color="orange-9", on_click=self._begin_clone)
            self._writers.append(clone.props("unelevated dense"))

    # ------------------------------------------------------------------------------------ what the frame asks of it

    def show(self, content: PageContent) -> None:
        """Follow the node and the work."""
        self._release.show(content)
        self._bar.show()
        free = not content.lost and not self._desk.busy
        self._backup.set_enabled(free)
        self._diff.set_enabled(free and self._file is not None)
        for button in self._writers:
            button.set_enabled(free)
        if self._writers:
            self._writers[0].set_enabled(free and self._file is not None)

    def leave(self) -> None:
        """Leave it: work that has begun goes on."""

    # ------------------------------------------------------------------------------------ what the user does

    async def _take(self, event: UploadEventArguments) -> None:
        """Read the file that the user has chosen."""
        self._upload.reset()
        name = event.file.name
        try:
            if event.file.size() > jobs.MOST_BYTES:
                raise ConfigError(f"{name}: {_TOO_LONG}")
            data = await event.file.read()
            file = await in_thread(lambda: jobs.uploaded(data, name))
        except CanopenError as error:
            self._refuse(str(error))
            return
        self._file = file
        date = f", of {file.date}" if file.date else ""
        self._told.show(sentence(f"{name}: {len(file.values)} parameters of node {file.node_id}{date}", IDLE))

    def _refuse(self, why: str) -> None:
        self._file = None
        self._told.show(sentence(f"Not read. {why}", BAD))

    def _begin(self, title: str, unit: str, function: Callable[[NodeSession, NodeWork], str]) -> None:
        refused = self._desk.begin(NodeWork(_KEY, title, unit), function)
        if refused is not None:
            ui.notify(refused, type="negative", position="top")
        self._bar.show()

    def _begin_backup(self) -> None:
        self._begin(f"Reading {self._context.node}", "objects", jobs.backup)

    def _begin_diff(self) -> None:
        if (file := self._file) is not None:
            title = f"Comparing {file.where} with {self._context.node}"
            self._begin(title, "objects", lambda session, work: jobs.compare(session, work, file))

    def _begin_restore(self) -> None:
        if (file := self._file) is None or not self._context.panel.teleop:
            return
        options, any_node = self._options(), bool(self._any.value)
        title = f"Restoring {file.where} into {self._context.node}"
        self._begin(
            title, "groups", lambda session, work: jobs.restore(session, work, file, options, any_node=any_node)
        )

    def _begin_clone(self) -> None:
        if not self._context.panel.teleop:
            return
        source, options = self._context.panel.robot.desk(str(self._source.value)), self._options()
        title = f"Cloning {source.place.name} into {self._context.node}"
        self._begin(title, "objects", lambda session, work: jobs.clone_from(session, work, source, options))

    def _options(self) -> RestoreOptions:
        globs = [each.strip() for each in str(self._protect.value or "").split(",") if each.strip()]
        reached = Reached(robot=self._desk.robot)
        return RestoreOptions(globs, keep=bool(self._keep.value), store=bool(self._store.value), reached=reached)
