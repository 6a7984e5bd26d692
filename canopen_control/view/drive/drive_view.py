"""The Drive view of a page: which node, its tabs, and the switch between it and the robot.

It takes the place of the scene and the tables; STOP, the robot's state and what is on the left stay. Where somebody is
stands in the page's address, so that a page loaded anew is where it was.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlencode

from nicegui import ui

from canopen_control.view.drive.drive_tab import DriveTabContext
from canopen_control.view.drive.drive_tabs import TABS
from canopen_control.view.panels.panel import Html
from canopen_control.view.words import axis_rows, chip

if TYPE_CHECKING:
    from nicegui.element import Element

    from canopen_control.view.drive.drive_tab import DriveTab
    from canopen_control.view.page_content import PageContent
    from canopen_control.view.panels.panel import PanelContext

__all__ = ["DriveView"]

_ROBOT, _DRIVE = "robot", "drive"
_OPEN: Final = "cc-in-drive"
_LOST: Final = "<p class='cc-line cc-bad'>No connection: nobody knows what the drive does.</p>"


class DriveView:
    """Made in the page's `main`; the switch comes second in its `side`. `asked` is the page's query."""

    def __init__(self, context: PanelContext, main: Element, side: Element, asked: dict[str, str]) -> None:
        self._context, self._main, self._client = context, main, ui.context.client
        self._tabs: dict[str, DriveTab] = {}
        self._places: dict[str, ui.element] = {}
        self._content: PageContent | None = None
        nodes = context.robot.node_names
        self._node = asked.get(_DRIVE, "") if asked.get(_DRIVE) in nodes else next(iter(nodes), "")
        keys = [slot.key for slot in TABS]
        self._key = asked.get("tab", "") if asked.get("tab") in keys else keys[0]
        self.is_open = False
        with side, ui.element("section").classes("cc-panel cc-p-switch") as switch:
            self._switch = ui.toggle({_ROBOT: "Robot", _DRIVE: "Drives"}, value=_ROBOT, on_change=self._switched)
            self._switch.props("unelevated no-caps spread toggle-color=blue-9 color=grey-3 text-color=grey-9")
        switch.move(side, 1)
        switch.visible = bool(nodes)
        with ui.element("div").classes("cc-drive-view") as self._whole:
            self._make_head(nodes)
            self._body = ui.element("div").classes("cc-tab-bodies")
        if asked.get(_DRIVE) in nodes:
            self._switch.value = _DRIVE

    def _make_head(self, nodes: list[str]) -> None:
        with ui.element("div").classes("cc-drive-head"):
            names = {name: f"{name} · node {self._context.robot.desk(name).place.node_id}" for name in nodes}
            self._choice = ui.select(names, value=self._node or None, on_change=self._chosen)
            self._choice.props('dense options-dense outlined aria-label="node"').classes("cc-node")
            self._state = Html("cc-node-state")
            with ui.tabs() as tabs:
                made = {slot.key: ui.tab(slot.key, label=slot.title) for slot in TABS}
            tabs.value = made[self._key]
            tabs.on_value_change(lambda event: self._turn(str(event.value)))
            tabs.props("dense no-caps inline-label outside-arrows mobile-arrows align=left").classes("cc-drive-tabs")

    # ------------------------------------------------------------------------------------ what the page asks of it

    def show(self, content: PageContent) -> None:
        """Show what is known now in the tab that is seen."""
        self._content = content
        if not self.is_open:
            return
        self._state.show(_LOST if content.lost else node_state(content, self._node))
        tab = self._tabs.get(self._key)
        if tab is not None:
            tab.show(content)

    def leave(self) -> None:
        """End what the tabs read and drive: the page is closed."""
        for tab in self._tabs.values():
            tab.leave()

    # ------------------------------------------------------------------------------------ what the user does

    def _switched(self, event: Any) -> None:  # noqa: ANN401 - what a browser sends
        self.is_open = event.value == _DRIVE
        self._main.classes(**{"add" if self.is_open else "remove": _OPEN})
        if self.is_open:
            self._open_tab()
        else:
            self.leave()
        self._tell_place()

    def _chosen(self, event: Any) -> None:  # noqa: ANN401 - what a browser sends
        if event.value and event.value != self._node:
            self.leave()
            self._node = str(event.value)
            self._tabs.clear()
            self._places.clear()
            self._body.clear()
            self._open_tab()
            self._tell_place()

    def _turn(self, key: str) -> None:
        if key == self._key:
            return
        if (before := self._tabs.get(self._key)) is not None:
            before.leave()
        self._key = key
        self._open_tab()
        self._tell_place()

    def _open_tab(self) -> None:
        """Show the chosen tab of the chosen node; it is made where it was not there yet."""
        if self._key not in self._tabs and self._node:
            slot = next(each for each in TABS if each.key == self._key)
            context = DriveTabContext(self._context, self._context.robot.desk(self._node))
            with self._body, ui.element("div").classes(f"cc-tab cc-t-{slot.key}") as place:
                self._places[slot.key], self._tabs[slot.key] = place, slot.make(context)
        for key, place in self._places.items():
            place.visible = key == self._key
        if self._content is not None:
            self.show(self._content)

    def _tell_place(self) -> None:
        """Have the page's address say where the user is."""
        place = urlencode({_DRIVE: self._node, "tab": self._key}) if self.is_open else ""
        script = (
            "const at = new URL(location.href); at.searchParams.delete('drive'); at.searchParams.delete('tab');"
            f"for (const [key, value] of new URLSearchParams('{place}')) at.searchParams.set(key, value);"
            "history.replaceState(null, '', at)"
        )
        if self._client.has_socket_connection:
            self._client.run_javascript(script)


def node_state(content: PageContent, node: str) -> str:
    """Return the state of each axis of a node as HTML, of a node without axes its own."""
    rows = [row for row in axis_rows(content.state) if row.node == node]
    return "".join(
        chip(f"{row.joint}: {row.state}" if len(rows) > 1 else row.state, row.tone)
        + ("" if row.age == "live" else f"<small class='cc-late'>{row.age}</small>")
        for row in rows
    )
