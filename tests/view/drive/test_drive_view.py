"""The frame of the Drive view, for a simulated user: node, tab, and the end of work on leaving."""

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from nicegui import ui
from support.pages import FakeContext, at_rest, expect_seen, html, visited

from canopen_control.view.drive import drive_view
from canopen_control.view.drive.drive_view import DriveView, TabSlot

MADE = []


class FakeTab:
    def __init__(self, context):
        self.context, self.shown, self.left = context, 0, 0
        MADE.append(self)
        ui.label(f"{type(self).__name__} of {context.node}")

    def show(self, _content):
        self.shown += 1

    def leave(self):
        self.left += 1


class OtherTab(FakeTab):
    pass


@pytest.fixture(autouse=True)
def _tabs(monkeypatch):
    monkeypatch.setattr(drive_view, "TABS", (TabSlot("one", "One", FakeTab), TabSlot("two", "Two", OtherTab)))
    MADE.clear()


def played(asked=None, context=None):
    context = context or FakeContext()

    def build():
        with ui.element("main") as main, ui.element("div") as side:
            ui.label("banner")
        with main:
            return DriveView(context, main, side, asked or {})

    return visited(build, context)


def switch(user, value):
    from nicegui import ElementFilter

    with user._client:
        next(iter(ElementFilter(kind=ui.toggle))).value = value


def turn(user, key):
    from nicegui import ElementFilter

    with user._client:
        next(iter(ElementFilter(kind=ui.tabs))).value = key


@pytest.mark.rest
async def test_nothing_is_made_before_it_is_opened():
    async with played() as (user, view):
        closed = list(MADE)
        switch(user, "drive")
        view.show(FakeContext().content())
        await expect_seen(user, "FakeTab of left_drive")
        assert closed == []
        assert "enabled, follows commands" in html(user)
        assert "cc-in-drive" in view._main.classes
    (tab,) = MADE
    assert tab.shown == 2


async def test_a_page_is_opened_at_its_address():
    async with played({"drive": "left_drive", "tab": "two"}) as (user, _view):
        await expect_seen(user, "OtherTab of left_drive")
    assert [type(item) for item in MADE] == [OtherTab]


async def test_a_tab_that_is_left_is_reported_and_stays():
    async with played() as (user, view):
        switch(user, "drive")
        turn(user, "two")
        await at_rest()
        turn(user, "one")
        await at_rest()
        switch(user, "robot")
        await at_rest()
        assert ("cc-in-drive" in view._main.classes) is False
    one, two = MADE
    assert (one.left, two.left) == (2, 2)


async def test_another_node_has_tabs_of_its_own(monkeypatch):
    context = FakeContext()
    desk = context.robot.node_jobs("left_drive")
    context.robot._node_jobs["io"] = type(desk)("pair", desk.place)
    async with played(context=context) as (user, view):
        switch(user, "drive")
        view._choice.value = "io"
        await at_rest()
        assert ([type(item) for item in MADE], MADE[0].left) == ([FakeTab, FakeTab], 1)


async def test_a_page_that_is_closed_ends_what_its_tabs_do():
    async with played() as (user, view):
        switch(user, "drive")
        view.leave()
    assert MADE[0].left == 1
