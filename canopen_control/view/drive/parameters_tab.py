"""Parameters tab (backup, comparison, restore and clone) and Firmware tab."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final, Generic, TypeVar

from nicegui import ui

from canopen_control.cia402.state import POWERED_STATES
from canopen_control.commissioning.jobs import BACKUP, CLONE, DIFF, FIRMWARE, RESTORE, JobRun, Reached
from canopen_control.commissioning.parameter_jobs import run_backup, run_clone, run_diff, run_restore
from canopen_control.commissioning.parameter_set import parse_backup
from canopen_control.commissioning.program_download import load_program, refuse_no_program
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.rpc.messages.health import BAD, GOOD, IDLE, WARN
from canopen_control.rpc.messages.robot import MAX_OBJECT, NmtRequest
from canopen_control.view.drive.drive_tab import READ_ONLY_NOTE, JobForm, WorkBar
from canopen_control.view.elements.nicegui_elements import FileUpload
from canopen_control.view.panels.panel import Html, section, show_notice
from canopen_control.view.robot_connection import SOURCE, in_thread
from canopen_control.view.words import sentence

if TYPE_CHECKING:
    from collections.abc import Callable

    from nicegui.events import UploadEventArguments

    from canopen_control.commissioning.jobs import Job, RestoreOptions
    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.commissioning.parameter_set import ParameterSet
    from canopen_control.rpc.messages.state import NodeReading
    from canopen_control.view.drive.drive_tab import DriveTabContext
    from canopen_control.view.page_content import PageContent
    from canopen_control.view.words import Banner


# Panel to take a node out of the robot, so that its parameters can be written, and to return it.


_CONFIRMED: Final = ("PRE_OPERATIONAL", "STOPPED")  # the NMT states of a node that is taken out
_TORQUE: Final = tuple(state.name for state in POWERED_STATES)


class ReleasePanel:
    """Panel that shows how the robot uses a node, with buttons to take the node out of use and to return it."""

    def __init__(self, context: DriveTabContext) -> None:
        self._context = context
        self._words = Html()
        with ui.element("div").classes("cc-row cc-acts"):
            self._take_out_button = ui.button("Take out of the robot", color="blue-grey-8", on_click=self._take_out)
            self._return_button = ui.button("Return to the robot", color="green-8", on_click=self._give_back)
        self._take_out_button.props("unelevated dense")
        self._return_button.props("unelevated dense")
        self._take_out_button.visible = self._return_button.visible = False

    def show(self, content: PageContent) -> None:
        reading = self._context.reading(content)
        words, tone = release_words(reading, content.banner)
        self._words.show(sentence(words, tone))
        out = reading is not None and reading.taken_out
        powered = reading is not None and any(axis.state in _TORQUE for axis in reading.axes)
        free = self._context.panel.teleop and reading is not None and not self._context.node_jobs.busy
        self._take_out_button.visible, self._return_button.visible = not out, out
        self._take_out_button.set_enabled(free and not powered)
        self._return_button.set_enabled(free)

    async def _take_out(self) -> None:
        await self._ask("preop", "not taken out")

    async def _give_back(self) -> None:
        await self._ask("start", "not returned")

    async def _ask(self, command: str, problem: str) -> None:
        request = NmtRequest(command=command, node=self._context.node, source=SOURCE)
        refused = await self._context.panel.ask(request)
        if refused is not None:
            show_notice(f"{self._context.node}: {problem}", refused)


def release_words(reading: NodeReading | None, robot: Banner) -> tuple[str, str]:
    """Return a sentence on whether parameter sets may be written to a node, and the level for the sentence's colour."""
    if reading is None:
        return "No connection: the state of the drive is unknown.", WARN
    powered = [axis.joint for axis in reading.axes if axis.state in _TORQUE]
    if powered:
        names = ", ".join(powered)
        return f"Parameter sets cannot be written to an enabled drive; disable {names} first.", WARN
    if not reading.taken_out:
        return "The robot controls this node. To write a parameter set, take the node out of the robot first.", IDLE
    state = (reading.nmt_state or "unknown").replace("_", "-").lower()
    if reading.age is None or reading.nmt_state not in _CONFIRMED:
        return f"The node was commanded out of the robot, but has not confirmed that: its NMT state is {state}.", WARN
    if robot.tone == BAD and robot.action == "fault-reset":
        return f"The node is taken out of the robot ({state}), and the robot is in fault: {robot.cause}", BAD
    return "The node is taken out of the robot, which sends it no commands until it is returned.", GOOD


T = TypeVar("T")


class FileChoice(Generic[T]):
    """Upload of one file, which `read` converts to a value.

    `value` is None before the first file and after a refused file: one with more than `most` bytes, or one for which
    `read` raises CanopenError. `words` returns a description of the value for the page.
    """

    def __init__(
        self, label: str, most: int, too_long: str, read: Callable[[bytes, str], T], words: Callable[[T], str]
    ) -> None:
        self.value: T | None = None
        self.name = ""
        self._max, self._too_long, self._read, self._words = most, too_long, read, words
        self.upload = FileUpload(label, self._take, lambda: self._refuse(too_long), most)
        self._message = Html()

    async def _take(self, event: UploadEventArguments) -> None:
        self.upload.reset()
        self.name = name = event.file.name
        try:
            if event.file.size() > self._max:
                raise ConfigError(f"{name}: {self._too_long}")
            data = await event.file.read()
            value = await in_thread(lambda: self._read(data, name))
        except CanopenError as error:
            self._refuse(str(error))
            return
        self.value = value
        self._message.show(sentence(f"{name}: {self._words(value)}", IDLE))

    def _refuse(self, why: str) -> None:
        self.value = None
        self._message.show(sentence(f"Not read. {why}", BAD))


# Firmware tab: choice of a program, download with rate and remaining time, and result.


MAX_FIRMWARE_BYTES: Final = MAX_OBJECT
"""Maximum length of a program that can be loaded through a running robot; `firmware --can` has no such limit."""
_WHAT: Final = (
    "The program is stopped and cleared (0x1F51), sent (0x1F50), checked (0x1F57, 0x1F56) and started. An "
    "interrupted transfer restarts; a drive without a program waits in its boot loader for the next attempt. A "
    "download cannot be cancelled from here: a partial program is unusable."
)


class FirmwareTab:
    """Tab that starts a firmware download as a job of the node, and shows its progress."""

    def __init__(self, context: DriveTabContext) -> None:
        self._context, self._node_jobs = context, context.node_jobs
        self._image: FileChoice[bytes] | None = None
        self._load: ui.button | None = None
        with section("Now"):
            self._release = ReleasePanel(context)
            self._bar = WorkBar(self._node_jobs, FIRMWARE.tab)
        with section("Program"):
            ui.html(f"<p class='cc-note'>{_WHAT}</p>", sanitize=False)
            if context.panel.teleop:
                self._make_form()
            else:
                ui.html(READ_ONLY_NOTE, sanitize=False)

    def _make_form(self) -> None:
        self._image = FileChoice(
            "Choose the firmware file as supplied by the manufacturer",
            MAX_FIRMWARE_BYTES,
            f"at most {MAX_FIRMWARE_BYTES} bytes can be loaded through a running robot",
            program_of,
            lambda image: f"{len(image):,} bytes",
        )
        self._form = JobForm(FIRMWARE)
        with ui.element("div").classes("cc-row cc-acts"):
            self._load = ui.button("Load into the drive", color="orange-9", on_click=self._begin)
            self._load.props("unelevated dense")

    def show(self, content: PageContent) -> None:
        self._release.show(content)
        self._bar.show()
        if self._load is not None:
            self._load.set_enabled(
                not content.lost
                and not self._node_jobs.busy
                and self._image is not None
                and self._image.value is not None
            )

    def leave(self) -> None:
        """Do nothing, because a download continues when the tab is hidden."""

    def _begin(self) -> None:
        if self._image is None or (image := self._image.value) is None or not self._context.panel.teleop:
            return
        try:
            options = self._form.options()
        except ConfigError as error:
            show_notice("Not started", str(error))
            return
        work = JobRun(FIRMWARE, f"Loading {self._image.name} into {self._context.node}")
        refused = self._node_jobs.begin(work, partial(load_program, image=image, options=options))
        if refused is not None:
            show_notice("Not started", refused)
        self._bar.show()


MAX_PARAMETER_BYTES: Final = 4_000_000  # limit for a DCF
_BACKUP: Final = (
    "Saves all read/write parameters (no commands or live values) as a DCF; each is read twice. Nothing is written to "
    "the drive, so this works while the robot runs."
)
_RESTORE: Final = (
    "Only differences are written, then everything is read back. If the drive refuses a value, all previous "
    "values are restored. Node-ID and bit rate are kept."
)


class ParametersTab:
    """Tab that starts the parameter jobs of the node, and shows their progress."""

    def __init__(self, context: DriveTabContext) -> None:
        self._context, self._node_jobs = context, context.node_jobs
        self._writers: list[ui.button] = []
        writes = context.panel.teleop
        with section("Now"):
            self._release = ReleasePanel(context)
            self._bar = WorkBar(self._node_jobs, RESTORE.tab)
        with ui.element("div").classes("cc-tab-columns"):
            with section("Backup"):
                ui.html(f"<p class='cc-note'>{_BACKUP}</p>", sanitize=False)
                self._backup = ui.button("Back up", color="blue-9", on_click=self._begin_backup)
                self._backup.props("unelevated dense")
            with section("A file"):
                self._make_upload()
                self._diff = ui.button("Compare with the node", color="blue-9", on_click=self._begin_diff)
                self._diff.props("unelevated dense")
            with section("Restore and clone"):
                ui.html(f"<p class='cc-note'>{_RESTORE}</p>", sanitize=False)
                if writes:
                    self._make_options()
                else:
                    ui.html(READ_ONLY_NOTE, sanitize=False)

    def _make_upload(self) -> None:
        too_long = f"the DCF must have at most {MAX_PARAMETER_BYTES} bytes"
        self._file = FileChoice("Choose a DCF", MAX_PARAMETER_BYTES, too_long, uploaded, _file_words)
        self._file.upload.props("accept='.dcf,.eds'")

    def _make_options(self) -> None:
        self._form = JobForm(RESTORE)
        with ui.element("div").classes("cc-row cc-acts"):
            restore = ui.button("Restore the file", color="orange-9", on_click=self._begin_restore)
            self._writers.append(restore.props("unelevated dense"))
        names = [node_name for node_name in self._context.panel.robot.node_names if node_name != self._context.node]
        if not names:
            return
        self._source = ui.select(names, value=names[0], label="clone from").props("dense").style("width: 100%")
        with ui.element("div").classes("cc-row cc-acts"):
            clone = ui.button("Clone into this node", color="orange-9", on_click=self._begin_clone)
            self._writers.append(clone.props("unelevated dense"))

    # ------------------------------------------------------------------------------------ calls of the frame

    def show(self, content: PageContent) -> None:
        self._release.show(content)
        self._bar.show()
        free = not content.lost and not self._node_jobs.busy
        self._backup.set_enabled(free)
        self._diff.set_enabled(free and self._file.value is not None)
        for button in self._writers:
            button.set_enabled(free)
        if self._writers:
            self._writers[0].set_enabled(free and self._file.value is not None)

    def leave(self) -> None:
        """Do nothing, because a job continues when the tab is hidden."""

    # ------------------------------------------------------------------------------------ what the user does

    def _begin(self, job: Job, title: str, function: Callable[[NodeSession, JobRun], str]) -> None:
        refused = self._node_jobs.begin(JobRun(job, title), function)
        if refused is not None:
            ui.notify(refused, type="negative", position="top")
        self._bar.show()

    def _begin_backup(self) -> None:
        reached = Reached(robot=self._node_jobs.robot)
        self._begin(BACKUP, f"Reading {self._context.node}", partial(run_backup, reached=reached))

    def _begin_diff(self) -> None:
        if (file := self._file.value) is not None:
            self._begin(DIFF, f"Comparing {file.where} with {self._context.node}", partial(run_diff, file=file))

    def _begin_restore(self) -> None:
        if (file := self._file.value) is not None and self._context.panel.teleop:
            restore = partial(run_restore, file=file, options=self._options())
            self._begin(RESTORE, f"Restoring {file.where} into {self._context.node}", restore)

    def _begin_clone(self) -> None:
        if self._context.panel.teleop:
            source = self._context.panel.robot.node_jobs(str(self._source.value))
            clone = partial(run_clone, source=source.session(), options=self._options())
            self._begin(CLONE, f"Cloning {source.place.name} into {self._context.node}", clone)

    def _options(self) -> RestoreOptions:
        options: RestoreOptions = self._form.options(reached=Reached(robot=self._node_jobs.robot))
        return options


def _file_words(file: ParameterSet) -> str:
    return f"{len(file.values)} parameters of node {file.node_id}{f', of {file.date}' if file.date else ''}"


def program_of(data: bytes, name: str) -> bytes:
    """Return the bytes of an uploaded program; raise ConfigError if the file is empty, or if it is an EDS or DCF."""
    refuse_no_program(data, name)
    return data


def uploaded(data: bytes, name: str) -> ParameterSet:
    """Parse an uploaded DCF; raise ConfigError or EdsError if the file is invalid."""
    if not data:
        raise ConfigError(f"{name} is empty")
    return parse_backup(data, name)
