"""Drive view of a page, where the user chooses a node and a tab.

The view replaces the scene and the tables; STOP, the robot's state and the left column remain. The address of the page
contains the selected node and tab, so that a reload restores them.
"""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlencode

from nicegui import background_tasks, ui

from canopen_control.commissioning.driven_axis import error_history
from canopen_control.commissioning.object_rows import statusword_bits
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.rpc.messages.health import BAD, GOOD, WARN
from canopen_control.view.drive.drive_tab import DriveTabContext
from canopen_control.view.drive.parameters_tab import FirmwareTab, ParametersTab
from canopen_control.view.drive.scope_tab import ScopeTab
from canopen_control.view.drive.tune_tab import TuneTab
from canopen_control.view.elements.nicegui_elements import ObjectTree
from canopen_control.view.object_list import ObjectList, address_text
from canopen_control.view.panels.panel import Html, section
from canopen_control.view.panels.target_panel import PowerPanel, TargetPanel
from canopen_control.view.robot_connection import in_thread
from canopen_control.view.words import axis_rows, chip, event_log, sentence

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from nicegui.element import Element

    from canopen_control.od.model import ObjectDictionary
    from canopen_control.rpc.messages.state import AxisReading, NodeReading
    from canopen_control.view.drive.drive_tab import DriveTab
    from canopen_control.view.page_content import PageContent
    from canopen_control.view.panels.panel import PanelContext


# Objects tab: all objects of the node as a tree, with live values of the visible ones, and edits with undo.


_NO_EDS: Final = "The objects of this node are unknown, because bus.yml gives no EDS for it."
_READING: Final = "Reading the EDS ..."
_FULL_UPDATE: Final = 25  # calls of `show` between two full updates


class ObjectsTab:
    """Tab with the object tree of a node; it reads the visible objects, and writes only with `--teleop`."""

    def __init__(self, context: DriveTabContext) -> None:
        self._context, self._client = context, ui.context.client
        self._page = f"{self._client.id} {context.node}"
        self._reader = context.panel.robot.live_reader  # kept, because `panel.robot` may change
        self._list: ObjectList | None = None
        self._tree: ObjectTree | None = None
        self._addresses: list[str] = []
        self._is_left, self._has_addresses, self._turns = False, False, 0
        with ui.element("section").classes("cc-panel"):
            with ui.element("div").classes("cc-row cc-acts"):
                self._undo = ui.button("Undo", color="blue-grey-8", on_click=self._take_back).props("unelevated dense")
                self._last = Html("cc-o-last")
            self._message = Html()
            self._place = ui.element("div")
        self._message.show(sentence(_READING))
        background_tasks.create(self._begin(), name="objects")

    async def _begin(self) -> None:
        """Read the EDS on a thread, then create the tree."""
        try:
            od = await in_thread(self._context.node_jobs.dictionary)
        except CanopenError as error:
            self._message.show(sentence(str(error), BAD))
            return
        if od is None:
            self._message.show(sentence(_NO_EDS, WARN))
            return
        self._message.show("")
        self._list = await in_thread(lambda: ObjectList(od, self._context.place.node_id))
        rows = await in_thread(lambda: self._list.rows if self._list is not None else [])
        if not self._place.is_deleted:
            with self._place:
                self._tree = ObjectTree(rows, _product(od), self, writes=self._context.panel.teleop)

    # ------------------------------------------------------------------------------------ calls of the frame

    def show(self, content: PageContent) -> None:
        """Show the values read since the last call, and enable the undo button if an edit can be undone."""
        node_jobs = self._context.node_jobs
        if self._is_left:
            self._is_left = False
            self._watch()
        if self._tree is not None and self._list is not None and self._has_addresses:
            self._turns += 1
            if not self._turns % _FULL_UPDATE:  # a browser that was disconnected for a moment has missed updates
                self._show_values()
            if news := self._list.news(node_jobs.live):
                self._tree.values(news)
            lost = node_jobs.lost if self._addresses and not content.lost else ""
            self._message.show(sentence(lost, BAD))
        last = node_jobs.history.last
        self._undo.set_enabled(last is not None and self._context.panel.teleop and not content.lost)
        self._last.show(sentence(f"last write: {last.words}" if last is not None else "nothing has been written yet"))

    def leave(self) -> None:
        self._is_left = True
        self._reader.watch(self._page, self._context.node_jobs, ())

    # ------------------------------------------------------------------------------------ events of the tree

    def seen(self, addresses: list[str]) -> None:
        """Start reading the objects at these addresses, which are now visible."""
        self._addresses, self._has_addresses = addresses, True
        self._show_values()
        if not self._is_left:
            self._watch()

    def _show_values(self) -> None:
        if self._tree is not None and self._list is not None:
            self._tree.values(self._list.known(self._context.node_jobs.live, self._addresses))

    def _watch(self) -> None:
        entries = self._list.entries_with_mode(self._addresses) if self._list is not None else []
        self._reader.watch(self._page, self._context.node_jobs, entries)

    def search(self, text: str) -> None:
        if self._list is not None and self._tree is not None:
            self._tree.matches(text, *self._list.search(text))

    def write(self, address: str, text: str) -> None:
        """Write an object on a thread, and show the result next to it."""
        background_tasks.create(self._write(address, text), name="write")

    async def _write(self, address: str, text: str) -> None:
        entry = self._list.entry(address) if self._list is not None else None
        if entry is None or self._tree is None or not self._context.panel.teleop:
            return  # not requested by this page
        try:
            edit = await self._context.node_jobs.write(entry, text)
        except CanopenError as error:
            self._tree.answer(address, str(error), good=False)
        else:
            self._tree.answer(address, f"written: {edit.words}", good=True)
        self._reader.soon(self._context.node_jobs, entry)

    async def _take_back(self) -> None:
        if not self._context.panel.teleop:
            return
        try:
            edit = await self._context.node_jobs.undo()
        except CanopenError as error:
            self._last.show(sentence(str(error), BAD))
            ui.notify(str(error), type="negative", position="top", multi_line=True, close_button="OK")
            return
        if self._tree is not None:
            self._tree.answer(address_text(edit.entry.address), f"undone: {edit.words}", good=True)
        self._last.show(sentence(f"undone: {edit.words}", GOOD))
        self._reader.soon(self._context.node_jobs, edit.entry)


def _product(od: ObjectDictionary) -> str:
    """Return the key under which the browser stores the favourite objects of this drive type."""
    return f"{od.device.vendor_number or 0:X}-{od.device.product_number or 0:X}-{od.device.product_name}"


# Status tab: state of the node and its drives, statusword bits, errors, events, and targets of held buttons.


_NO_ERRORS: Final = "<p class='cc-note'>The drive's error history is empty.</p>"
_GONE: Final = "<p class='cc-note'>Unknown.</p>"


class StatusTab:
    """Tab with the state of the node; the error history is read once, and again when the user requests it."""

    def __init__(self, context: DriveTabContext) -> None:
        self._context, self._client = context, ui.context.client
        self._drives: TargetPanel | None = None
        with ui.element("div").classes("cc-tab-columns"):
            with section("State"):
                self._facts = Html("cc-stale")
                self._power = PowerPanel(context.panel, context.node) if context.place.axes else None
            with section("Statusword") as bits:
                self._bits = Html("cc-stale")
            bits.visible = bool(context.place.axes)
            with section("Teleop by target: hold a button"):
                self._drives = TargetPanel(context.panel, context.node)
            with section("Controlled by"):
                self._commander = Html("cc-stale")
            with section("Error history (0x1003)"):
                self._errors = Html()
                ui.button("Read again", color="blue-grey-6", on_click=self._read).props("outline dense")
            with section("Events of this node, newest first"):
                self._events = Html("cc-log")
        background_tasks.create(self._read(), name="errors")

    def show(self, content: PageContent) -> None:
        reading = self._context.reading(content)
        if reading is not None:
            self._facts.show(facts_table(reading))
            self._bits.show("".join(_bits(axis) for axis in reading.axes) or _GONE)
            self._commander.show(_movers(content, reading))
        if self._power is not None:
            self._power.show(content)
        if self._drives is not None:
            self._drives.show(content)
        self._events.show(event_log(event for event in content.events if event.node == self._context.node))

    def leave(self) -> None:
        """Stop any motion that this tab commands."""
        self._context.panel.release(self._client.id)

    async def _read(self) -> None:
        try:
            errors = await self._context.node_jobs.ask(error_history)
        except ConfigError as error:  # 0x1003 is optional (CiA 301, 7.5.2.4)
            self._errors.show(sentence(str(error)))
            return
        except CanopenError as error:
            self._errors.show(sentence(str(error), BAD))
            return
        self._errors.show("".join(f"<p class='cc-line'>{escape(text)}</p>" for text in errors) or _NO_ERRORS)


def facts_table(reading: NodeReading) -> str:
    """Return an HTML table with the state of a node."""
    lines = "".join(f"<tr><th>{name}</th><td>{escape(text)}</td></tr>" for name, text in _facts(reading))
    return f"<table class='cc-table cc-known'>{lines}</table>"


def _facts(reading: NodeReading) -> Iterator[tuple[str, str]]:
    yield "node", f"{reading.node_id} on {reading.bus}" if reading.bus else str(reading.node_id)
    remark = ", taken out of the robot" if reading.taken_out else ""
    yield "NMT", f"{(reading.nmt_state or 'unknown').replace('_', '-').lower()}{remark}"
    for axis in reading.axes:
        name = axis.joint if len(reading.axes) > 1 else "drive"
        yield name, f"{(axis.state or 'unknown').replace('_', ' ').lower()}, mode {axis.mode or '-'}"
    yield "last seen", "never" if reading.age is None else f"{reading.age:.2f} s ago" if reading.age >= 0.25 else "live"
    counts = reading.sdo
    yield "SDO", f"{counts.reads} reads, {counts.writes} writes, {counts.failed} failed"
    for error in dict.fromkeys(filter(None, (reading.error, *(axis.error for axis in reading.axes)))):
        yield "error", error


def _bits(axis: AxisReading) -> str:
    if axis.statusword is None:
        return _GONE
    bits = "".join(
        f"<span class='{'cc-set' if bit.on else ''}'>{bit.bit} {escape(bit.name)}</span>"
        for bit in statusword_bits(axis.statusword, axis.mode)
    )
    return f"<p class='cc-note'>{escape(axis.joint)}: 0x{axis.statusword:04X}</p><div class='cc-bits'>{bits}</div>"


def _movers(content: PageContent, reading: NodeReading) -> str:
    """Return, as HTML, a sentence about the controllers that command the node's joints."""
    joints = {axis.joint for axis in reading.axes}
    active = [controller for controller in content.controllers if controller.state == "active"]
    names = [
        candidate.name for candidate in active if any(claim.rpartition("/")[0] in joints for claim in candidate.claims)
    ]
    if not reading.axes:
        return sentence("This node is not a drive.")
    if not names:
        return sentence("No active controller commands this drive.")
    return sentence(
        f"{', '.join(names)} command{'s' if len(names) == 1 else ''} this drive, also for targets of this page."
    )


# Tabs of the Drive view in their order; a new tab is a class in this folder and an entry here.


@dataclass(frozen=True, slots=True)
class TabSlot:
    """Tab of the Drive view; `key` identifies the tab in the page's address."""

    key: str
    title: str
    make: Callable[[DriveTabContext], DriveTab]


TABS: Final = (
    TabSlot("status", "Status", StatusTab),
    TabSlot("objects", "Objects", ObjectsTab),
    TabSlot("scope", "Scope", ScopeTab),
    TabSlot("tune", "Tune", TuneTab),
    TabSlot("parameters", "Parameters", ParametersTab),
    TabSlot("firmware", "Firmware", FirmwareTab),
)


_ROBOT, _DRIVE = "robot", "drive"
_OPEN: Final = "cc-in-drive"
_LOST: Final = "<p class='cc-line cc-bad'>No connection: the state of the drive is unknown.</p>"


class DriveView:
    """Drive view of a page, created inside `main`.

    The toggle between the robot and the Drive view is the second panel in `side`; `query` has the query parameters of
    the page's address.
    """

    def __init__(self, context: PanelContext, main: Element, side: Element, query: dict[str, str]) -> None:
        self._context, self._main, self._client = context, main, ui.context.client
        self._tabs: dict[str, DriveTab] = {}
        self._places: dict[str, ui.element] = {}
        self._content: PageContent | None = None
        nodes = context.robot.node_names
        self._node = query.get(_DRIVE, "") if query.get(_DRIVE) in nodes else next(iter(nodes), "")
        keys = [slot.key for slot in TABS]
        self._key = query.get("tab", "") if query.get("tab") in keys else keys[0]
        self.is_open = False
        with side, ui.element("section").classes("cc-panel cc-p-switch") as switch:
            self._switch = ui.toggle({_ROBOT: "Robot", _DRIVE: "Drives"}, value=_ROBOT, on_change=self._switched)
            self._switch.props("unelevated no-caps spread toggle-color=blue-9 color=grey-3 text-color=grey-9")
        switch.move(side, 1)
        switch.visible = bool(nodes)
        with ui.element("div").classes("cc-drive-view") as self._whole:
            self._make_head(nodes)
            self._body = ui.element("div").classes("cc-tab-bodies")
        if query.get(_DRIVE) in nodes:
            self._switch.value = _DRIVE

    def _make_head(self, nodes: list[str]) -> None:
        with ui.element("div").classes("cc-drive-head"):
            names = {name: f"{name} · node {self._context.robot.node_jobs(name).place.node_id}" for name in nodes}
            self._choice = ui.select(names, value=self._node or None, on_change=self._chosen)
            self._choice.props('dense options-dense outlined aria-label="node"').classes("cc-node")
            self._state = Html("cc-node-state")
            with ui.tabs() as tabs:
                tab_of = {slot.key: ui.tab(slot.key, label=slot.title) for slot in TABS}
            tabs.value = tab_of[self._key]
            tabs.on_value_change(lambda event: self._turn(str(event.value)))
            tabs.props("dense no-caps inline-label outside-arrows mobile-arrows align=left").classes("cc-drive-tabs")

    # ------------------------------------------------------------------------------------ calls of the page

    def show(self, content: PageContent) -> None:
        """Update the visible tab if the Drive view is open."""
        self._content = content
        if not self.is_open:
            return
        self._state.show(_LOST if content.lost else node_state(content, self._node))
        tab = self._tabs.get(self._key)
        if tab is not None:
            tab.show(content)

    def leave(self) -> None:
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
        self._update_address()

    def _chosen(self, event: Any) -> None:  # noqa: ANN401 - what a browser sends
        if event.value and event.value != self._node:
            self.leave()
            self._node = str(event.value)
            self._tabs.clear()
            self._places.clear()
            self._body.clear()
            self._open_tab()
            self._update_address()

    def _turn(self, key: str) -> None:
        if key == self._key:
            return
        if (before := self._tabs.get(self._key)) is not None:
            before.leave()
        self._key = key
        self._open_tab()
        self._update_address()

    def _open_tab(self) -> None:
        """Show the selected tab of the selected node, creating it if necessary."""
        if self._key not in self._tabs and self._node:
            slot = next(tab for tab in TABS if tab.key == self._key)
            context = DriveTabContext(self._context, self._context.robot.node_jobs(self._node))
            with self._body, ui.element("div").classes(f"cc-tab cc-t-{slot.key}") as place:
                self._places[slot.key], self._tabs[slot.key] = place, slot.make(context)
        for key, place in self._places.items():
            place.visible = key == self._key
        if self._content is not None:
            self.show(self._content)

    def _update_address(self) -> None:
        """Write the selected node and tab to the page's address."""
        place = urlencode({_DRIVE: self._node, "tab": self._key}) if self.is_open else ""
        script = (
            "const at = new URL(location.href); at.searchParams.delete('drive'); at.searchParams.delete('tab');"
            f"for (const [key, value] of new URLSearchParams('{place}')) at.searchParams.set(key, value);"
            "history.replaceState(null, '', at)"
        )
        if self._client.has_socket_connection:
            self._client.run_javascript(script)


def node_state(content: PageContent, node: str) -> str:
    """Return the states of a node's axes as HTML; for a node without axes, return the node's own state."""
    rows = [row for row in axis_rows(content.state) if row.node == node]
    return "".join(
        chip(f"{row.joint}: {row.state}" if len(rows) > 1 else row.state, row.tone)
        + ("" if row.age == "live" else f"<small class='cc-late'>{row.age}</small>")
        for row in rows
    )
