"""Interface for the tabs of the Drive view; the package docstring explains how to add a tab."""

from __future__ import annotations

import time
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any, Final, Protocol

from nicegui import ui

from canopen_control.rpc.messages.health import BAD, GOOD, IDLE
from canopen_control.view.panels.panel import Html
from canopen_control.view.words import sentence

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.commissioning.jobs import Job, JobOption, JobRun
    from canopen_control.rpc.messages.robot import NodePlace
    from canopen_control.rpc.messages.state import NodeReading
    from canopen_control.view.page_content import PageContent
    from canopen_control.view.panels.panel import PanelContext
    from canopen_control.view.robot_view import NodeJobs


# Progress of a job at a node: the current step, a bar, rate and remaining time, and finally the result.


_SHOWN: Final = 200  # maximum number of lines and rows


class WorkBar:
    """Progress bar for a node's latest job that was started from the tab `tab` on any page."""

    def __init__(self, node_jobs: NodeJobs, tab: str) -> None:
        self._node_jobs, self._tab = node_jobs, tab
        self._words = Html()
        self._bar = ui.linear_progress(0.0, show_value=False).props("instant-feedback rounded size=10px")
        with ui.element("div").classes("cc-row"):
            self._end = ui.button("Abort", color="red-8", on_click=self._ask_end).props("outline dense")
            self._save = ui.button("Save the file", color="blue-9", on_click=self._download).props("unelevated dense")
        self._outcome = Html()
        self.show()

    def show(self) -> None:
        """Update the progress of the job, or show its result."""
        work = self._node_jobs.work
        is_own = work is not None and work.job.tab == self._tab
        running = work is not None and not work.over
        self._bar.visible = running and is_own
        self._end.visible = work is not None and running and is_own and work.job.can_end
        self._save.visible = is_own and work is not None and work.over and work.file is not None
        if work is None or (not is_own and not running):
            return
        if not is_own:
            self._words.show(sentence(f"{work.title} is still running; wait until this has ended.", IDLE))
            return
        if not work.over:
            self._bar.value = work.done / work.total if work.total else 0.0
            self._words.show(sentence(progress_words(work, time.monotonic()), IDLE))
            self._outcome.show("")
            return
        self._words.show(sentence(work.sentence, GOOD if work.good else BAD))
        self._outcome.show(outcome(work))

    def _ask_end(self) -> None:
        if self._node_jobs.work is not None:
            self._node_jobs.work.end()

    def _download(self) -> None:
        work = self._node_jobs.work
        if work is not None and work.file is not None:
            name, data = work.file
            ui.download.content(data, name)


def progress_words(work: JobRun, now: float) -> str:
    """Return a text with a job's current step, its progress and, if known, the rate and the remaining time."""
    words = f"{work.title}: {work.doing}" if work.doing else work.title
    if work.total:
        words += f", {work.done:,} of {work.total:,} {work.unit} ({100 * work.done // work.total} %)"
    pace = work.pace(now)
    return words + (f", {pace[0]:,.0f} {work.unit}/s, {pace[1]:.0f} s left" if pace is not None else "")


def outcome(work: JobRun) -> str:
    """Return the result lines and the result table of a job as HTML."""
    lines = "".join(f"<p class='cc-line'>{escape(line)}</p>" for line in work.lines[:_SHOWN])
    if not work.table:
        return lines
    rows = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in work.table[:_SHOWN])
    more = f"<p class='cc-note'>and {len(work.table) - _SHOWN} more</p>" if len(work.table) > _SHOWN else ""
    heads = "<tr><th>object</th><th>name</th><th>file</th><th>node</th></tr>"
    return f"{lines}<div class='cc-wide'><table class='cc-table'>{heads}{rows}</table></div>{more}"


# Form for the options that a job declares, which are also options of the command line.


class JobForm:
    """Inputs for the options of a job: a checkbox for each switch, a text field for every other option.

    The inputs for `names` (None: all options) are created in the current container; `add` creates more.
    """

    def __init__(self, job: Job, names: Iterable[str] | None = None) -> None:
        self._job = job
        self.inputs: dict[str, ui.checkbox | ui.input] = {}
        self.add(*(job.declared if names is None else names))

    def add(self, *names: str) -> None:
        """Create the inputs for further options in the current container."""
        declared = self._job.declared
        self.inputs |= {name: _input(declared[name]) for name in names}

    def options(self, **others: object) -> Any:  # noqa: ANN401 - of the job's own type
        """Return the job's options, taken from the inputs and `others`; raise ConfigError if an input is invalid."""
        declared = self._job.declared
        values = {
            name: bool(widget.value) if declared[name].is_switch else declared[name].value_of(str(widget.value or ""))
            for name, widget in self.inputs.items()
        }
        return self._job.options(**values, **others)


def _input(option: JobOption) -> ui.checkbox | ui.input:
    if option.is_switch:
        return ui.checkbox(option.text, value=option.default).props("dense")
    label = f"{option.text} (several with commas)" if option.repeats else option.text
    value = "" if option.repeats or option.default is None else f"{option.default}".removesuffix(".0")
    return ui.input(label, value=value).props("dense").style("width: 100%")


READ_ONLY_NOTE = (
    "<p class='cc-note'>This page is read-only. To write, start <code>canopen-control view --teleop</code></p>"
)


@dataclass(frozen=True, slots=True)
class DriveTabContext:
    """Context of a tab: the panel context of the page, and the node's jobs, which all pages share."""

    panel: PanelContext
    node_jobs: NodeJobs

    @property
    def place(self) -> NodePlace:
        """Node-ID, EDS, axes and joints of the node."""
        return self.node_jobs.place

    @property
    def node(self) -> str:
        return self.node_jobs.place.name

    def reading(self, content: PageContent) -> NodeReading | None:
        """Return the node's state as reported by the robot, or None without a connection."""
        return None if content.lost else content.state.nodes.get(self.node)


class DriveTab(Protocol):
    """Tab for one node, created when the user first opens it."""

    def __init__(self, context: DriveTabContext) -> None: ...

    def show(self, content: PageContent) -> None:
        """Update the visible tab; unchanged data is not sent again."""
        ...

    def leave(self) -> None:
        """Stop reading and driving when the tab is hidden; `show` may follow later."""
        ...
