"""The Objects tab: the whole dictionary of the node as a tree, live where it is in sight, with edits and their undo."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from nicegui import background_tasks, ui

from canopen_control.errors import CanopenError
from canopen_control.view.elements.nicegui_elements import ObjectTree
from canopen_control.view.object_list import ObjectList, address_text
from canopen_control.view.panels.panel import Html
from canopen_control.view.robot_connection import in_thread
from canopen_control.view.words import BAD, GOOD, WARN, sentence

if TYPE_CHECKING:
    from canopen_control.od.model import ObjectDictionary
    from canopen_control.view.drive.drive_tab import DriveTabContext
    from canopen_control.view.page_content import PageContent

__all__ = ["ObjectsTab"]

_NO_EDS: Final = "Nothing tells what the objects of this node are: bus.yml names no EDS for it."
_READING: Final = "Reading the EDS ..."
_ANEW: Final = 25  # showings


class ObjectsTab:
    """Reads what is in sight while the tab is; a page that only looks writes nothing."""

    def __init__(self, context: DriveTabContext) -> None:
        self._context, self._client = context, ui.context.client
        self._page = f"{self._client.id} {context.node}"
        self._reader = context.panel.robot.live_reader  # of this robot, also when another one is there
        self._list: ObjectList | None = None
        self._tree: ObjectTree | None = None
        self._seen: list[str] = []
        self._is_left, self._is_heard, self._turns = False, False, 0
        with ui.element("section").classes("cc-panel"):
            with ui.element("div").classes("cc-row cc-acts"):
                self._undo = ui.button("Undo", color="blue-grey-8", on_click=self._take_back).props("unelevated dense")
                self._last = Html("cc-o-last")
            self._told = Html()
            self._place = ui.element("div")
        self._told.show(sentence(_READING))
        background_tasks.create(self._begin(), name="objects")

    async def _begin(self) -> None:
        """Read the EDS on a thread, then make the tree."""
        try:
            od = await in_thread(self._context.desk.dictionary)
        except CanopenError as error:
            self._told.show(sentence(str(error), BAD))
            return
        if od is None:
            self._told.show(sentence(_NO_EDS, WARN))
            return
        self._told.show("")
        self._list = await in_thread(lambda: ObjectList(od, self._context.place.node_id))
        rows = await in_thread(lambda: self._list.rows if self._list is not None else [])
        if not self._place.is_deleted:
            with self._place:
                self._tree = ObjectTree(rows, _product(od), self, writes=self._context.panel.teleop)

    # ------------------------------------------------------------------------------------ what the frame asks of it

    def show(self, content: PageContent) -> None:
        """Send what was read since, and show what can be undone."""
        desk = self._context.desk
        if self._is_left:
            self._is_left = False
            self._watch()
        if self._tree is not None and self._list is not None and self._is_heard:
            self._turns += 1
            if not self._turns % _ANEW:  # a browser that was away for a moment has not heard all
                self._tell_seen()
            if news := self._list.news(desk.live):
                self._tree.values(news)
            lost = desk.lost if self._seen and not content.lost else ""
            self._told.show(sentence(lost, BAD))
        last = desk.history.last
        self._undo.set_enabled(last is not None and self._context.panel.teleop and not content.lost)
        self._last.show(sentence(f"last write: {last.words}" if last is not None else "nothing was written yet"))

    def leave(self) -> None:
        """Read no more."""
        self._is_left = True
        self._reader.watch(self._page, self._context.desk, ())

    # ------------------------------------------------------------------------------------ what the tree tells

    def seen(self, addresses: list[str]) -> None:
        """Have what is in sight read."""
        self._seen, self._is_heard = addresses, True
        self._tell_seen()
        if not self._is_left:
            self._watch()

    def _tell_seen(self) -> None:
        if self._tree is not None and self._list is not None:
            self._tree.values(self._list.known(self._context.desk.live, self._seen))

    def _watch(self) -> None:
        entries = self._list.entries_with_mode(self._seen) if self._list is not None else []
        self._reader.watch(self._page, self._context.desk, entries)

    def search(self, text: str) -> None:
        """Show what the words mean."""
        if self._list is not None and self._tree is not None:
            self._tree.matches(*self._list.search(text))

    def write(self, address: str, text: str) -> None:
        """Write an object, and say at it what came of that."""
        background_tasks.create(self._write(address, text), name="write")

    async def _write(self, address: str, text: str) -> None:
        entry = self._list.entry(address) if self._list is not None else None
        if entry is None or self._tree is None or not self._context.panel.teleop:
            return  # no page of ours asks for it
        try:
            edit = await self._context.desk.write(entry, text)
        except CanopenError as error:
            self._tree.answer(address, str(error), good=False)
        else:
            self._tree.answer(address, f"written: {edit.words}", good=True)
        self._reader.soon(self._context.desk, entry)

    async def _take_back(self) -> None:
        if not self._context.panel.teleop:
            return
        try:
            edit = await self._context.desk.undo()
        except CanopenError as error:
            self._last.show(sentence(str(error), BAD))
            ui.notify(str(error), type="negative", position="top", multi_line=True, close_button="OK")
            return
        if self._tree is not None:
            self._tree.answer(address_text(edit.entry.address), f"undone: {edit.words}", good=True)
        self._last.show(sentence(f"undone: {edit.words}", GOOD))
        self._reader.soon(self._context.desk, edit.entry)


def _product(od: ObjectDictionary) -> str:
    """Return by what the favourites of the kind of drive are kept."""
    return f"{od.device.vendor_number or 0:X}-{od.device.product_number or 0:X}-{od.device.product_name}"
