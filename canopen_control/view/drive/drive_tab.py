"""What a tab of the Drive view is, and what it is given; how to add one stands in this folder's docstring."""

from __future__ import annotations

import time
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Final, Protocol

from nicegui import ui

from canopen_control.view.panels.panel import Html
from canopen_control.view.words import BAD, GOOD, IDLE, sentence

if TYPE_CHECKING:
    from canopen_control.rpc.messages.robot import NodePlace
    from canopen_control.rpc.messages.state import NodeReading
    from canopen_control.view.node_desk import NodeJob, NodeJobs
    from canopen_control.view.page_content import PageContent
    from canopen_control.view.panels.panel import PanelContext


# How far the long work at a node is: what goes on, a bar, rate and remaining time, its end, and what came of it.


_SHOWN: Final = 200  # of lines and rows


class WorkBar:
    """Follows the newest work of the tab `key` at a node, whichever page has begun it; `can_end`: it may be ended."""

    def __init__(self, desk: NodeJobs, key: str, *, can_end: bool = True) -> None:
        self._desk, self._key, self._can_end = desk, key, can_end
        self._words = Html()
        self._bar = ui.linear_progress(0.0, show_value=False).props("instant-feedback rounded size=10px")
        with ui.element("div").classes("cc-row"):
            self._end = ui.button("Abort", color="red-8", on_click=self._ask_end).props("outline dense")
            self._save = ui.button("Save the file", color="blue-9", on_click=self._download).props("unelevated dense")
        self._outcome = Html()
        self.show()

    def show(self) -> None:
        """Show how far it is."""
        work = self._desk.work
        mine = work is not None and work.key == self._key
        goes_on = work is not None and not work.over
        self._bar.visible = goes_on and mine
        self._end.visible = goes_on and mine and self._can_end
        self._save.visible = mine and work is not None and work.over and work.file is not None
        if work is None or (not mine and not goes_on):
            return
        if not mine:
            self._words.show(sentence(f"{work.title} goes on; nothing else begins before its end.", IDLE))
            return
        if not work.over:
            self._bar.value = work.done / work.total if work.total else 0.0
            self._words.show(sentence(progress_words(work, time.monotonic()), IDLE))
            self._outcome.show("")
            return
        self._words.show(sentence(work.told, GOOD if work.good else BAD))
        self._outcome.show(outcome(work))

    def _ask_end(self) -> None:
        if self._desk.work is not None:
            self._desk.work.end()

    def _download(self) -> None:
        work = self._desk.work
        if work is not None and work.file is not None:
            name, data = work.file
            ui.download.content(data, name)


def progress_words(work: NodeJob, now: float) -> str:
    """Return what goes on, how far it is, how fast, and how long the rest takes."""
    words = f"{work.title}: {work.doing}" if work.doing else work.title
    if work.total:
        words += f", {work.done:,} of {work.total:,} {work.unit} ({100 * work.done // work.total} %)"
    pace = work.pace(now)
    return words + (f", {pace[0]:,.0f} {work.unit}/s, {pace[1]:.0f} s left" if pace is not None else "")


def outcome(work: NodeJob) -> str:
    """Return the lines and the table of what came of it, as HTML."""
    lines = "".join(f"<p class='cc-line'>{escape(each)}</p>" for each in work.lines[:_SHOWN])
    if not work.table:
        return lines
    rows = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in work.table[:_SHOWN])
    more = f"<p class='cc-note'>and {len(work.table) - _SHOWN} more</p>" if len(work.table) > _SHOWN else ""
    heads = "<tr><th>object</th><th>name</th><th>file</th><th>node</th></tr>"
    return f"{lines}<div class='cc-wide'><table class='cc-table'>{heads}{rows}</table></div>{more}"


LOOK_ONLY = "<p class='cc-note'>This page only looks. To write: <code>canopen-control view --teleop</code></p>"


@dataclass(frozen=True, slots=True)
class DriveTabContext:
    """The node that a tab is about: the page's robot, where the node is, and what is done at it for all pages."""

    panel: PanelContext
    desk: NodeJobs

    @property
    def place(self) -> NodePlace:
        """Its node id, EDS, axes and joints."""
        return self.desk.place

    @property
    def node(self) -> str:
        """Its name in bus.yml."""
        return self.desk.place.name

    def reading(self, content: PageContent) -> NodeReading | None:
        """Return what the robot says of the node; None where nobody knows it now."""
        return None if content.lost else content.state.nodes.get(self.node)


class DriveTab(Protocol):
    """A tab of one node: made in its place when it is opened first."""

    def __init__(self, context: DriveTabContext) -> None:
        """Make the widgets in the place that is current."""
        ...

    def show(self, content: PageContent) -> None:
        """Show what is known now, while the tab is seen; what has not changed is not sent again."""
        ...

    def leave(self) -> None:
        """End what it reads or drives: it is not seen any more. It may be shown again."""
        ...
