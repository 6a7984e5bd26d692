import gc
import weakref

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")
from nicegui import ui
from support.pages import at_rest, seen, visited

from canopen_control.view.elements.nicegui_elements import (
    Feed,
    FileUpload,
    HoldButton,
    HoldButtons,
    ObjectTree,
    PresenceElement,
    RobotScene,
    StripCharts,
)
from canopen_control.view.sampling import charts, names


async def test_what_is_sent_goes_out_in_one_message(monkeypatch):
    called = []
    monkeypatch.setattr(Feed, "run_method", lambda self, name, *args: called.append((name, args)))
    async with visited(Feed) as (_user, feed):
        feed.send({"scene": {"angles": [1.0]}, "lost": False})
        feed.send({})
    assert called == [("dispatch", ({"scene": {"angles": [1.0]}, "lost": False},)), ("dispatch", ({},))]


async def test_a_held_button_reports_this_and_a_foreign_word_is_nothing():
    reported, go = [], HoldButton("go", "Go")
    async with visited(lambda: HoldButtons([go], reported.append, lambda: reported.append("let go"))) as (
        user,
        _buttons,
    ):
        group = user.find(kind=HoldButtons)
        for word in ("go", "other", None, ["go"]):
            group.trigger("hold", word)
        group.trigger("release")
    assert reported == ["go", "let go"]


async def test_a_held_button_sends_often_enough_for_the_dead_man():
    from canopen_control.view.robot_connection import HOLD_TIMEOUT_NS

    async with visited(lambda: HoldButtons([], print, print)) as (_user, buttons):
        assert buttons.props["period"] * 1e6 * 3 <= HOLD_TIMEOUT_NS


async def test_it_is_given_its_tree():
    async with visited(lambda: RobotScene({"root": "base"})) as (_user, scene):
        assert scene.props["tree"] == {"root": "base"}


async def test_every_line_is_a_row_that_is_sent():
    async with visited(lambda: StripCharts(charts(["a"], ["can"]), names(["a"], ["can"]), 30.0)) as (_user, strips):
        result, rows = strips.props["charts"], strips.props["names"]
    assert {line["row"] for chart in result for line in chart["lines"]} <= set(rows)


async def test_a_page_reports_that_it_is_there_while_it_is_to():
    reports = []
    async with visited(lambda: PresenceElement(lambda: reports.append("here"))) as (user, presence):
        user.find(kind=PresenceElement).trigger("here")
        before = presence.props["on"]
        presence.switch(on=True)
        assert (before, presence.props["on"]) == (False, True)
    assert reports == ["here"]


class Heard:
    """What a tree tells."""

    def __init__(self):
        self.collected = []

    def seen(self, addresses):
        self.collected.append(("seen", addresses))

    def search(self, text):
        self.collected.append(("search", text))

    def write(self, address, text):
        self.collected.append(("write", address, text))


async def test_a_tree_of_objects_reports_what_is_in_sight_sought_and_written_and_no_nonsense():
    received = Heard()
    async with visited(lambda: ObjectTree([], "286-4F6", received, writes=False)) as (user, tree):
        for event, args in (
            ("seen", ["0x6081:00", 5]),
            ("seen", None),
            ("search", "v" * 500),
            ("write", {"address": "0x6081:00", "text": "5"}),
            ("write", {"address": 7, "text": "5"}),
            ("write", "0x6081:00"),
        ):
            user.find(kind=ObjectTree).trigger(event, args)
        assert (tree._props["writes"], tree._props["product"]) == (False, "286-4F6")
    assert received.collected == [
        ("seen", ["0x6081:00"]),
        ("seen", []),
        ("search", "v" * 200),
        ("write", "0x6081:00", "5"),
    ]


async def test_a_tree_is_sent_values_matches_and_answers(monkeypatch):
    sent = []
    monkeypatch.setattr(ObjectTree, "run_method", lambda _tree, *args: sent.append(args))
    async with visited(lambda: ObjectTree([], "", Heard(), writes=True)) as (_user, tree):
        tree.values({"0x6081:00": {"value": "5", "meaning": None, "changed": True, "error": None, "bits": []}})
        tree.matches("", None)
        tree.matches("speed", ("0x6081:00",))
        tree.answer("0x6081:00", "written", good=True)
    assert [item[0] for item in sent] == ["values", "matches", "matches", "answer"]
    assert sent[1:] == [
        ("matches", None, "", ""),
        ("matches", ["0x6081:00"], "", "speed"),
        ("answer", "0x6081:00", "written", True),
    ]


@pytest.mark.rest
async def test_a_chosen_file_reaches_its_waiter_and_the_upload_ends_with_the_page():
    taken = []

    def build():
        with ui.column() as column:
            FileUpload("Choose", lambda event: taken.append(event.file.name), lambda: None, 100)
        return column

    async with visited(build) as (user, column):
        upload = seen(ui.upload)[0]
        path, freed = upload.props["url"], weakref.ref(upload)
        answer = await user.http_client.post(path, files={"file": ("wave.json", b"{}")})
        assert (answer.status_code, taken) == (200, ["wave.json"])
        column.clear()
        del upload
        await at_rest()
        await user.http_client.post(path, files={"file": ("more.json", b"{}")})
        assert taken == ["wave.json"]
        gc.collect()
        assert freed() is None  # and with it the page, which its handlers know
