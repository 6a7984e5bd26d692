import gc
import weakref

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")
from nicegui import ui
from support.pages import seen, settle, visited

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


def test_what_is_sent_goes_out_in_one_message(monkeypatch):
    called = []
    monkeypatch.setattr(Feed, "run_method", lambda self, name, *args: called.append((name, args)))

    async def act(_user, feed):
        feed.send({"scene": {"angles": [1.0]}, "lost": False})
        feed.send({})

    visited(Feed, act)
    assert called == [("dispatch", ({"scene": {"angles": [1.0]}, "lost": False},)), ("dispatch", ({},))]


def test_a_held_button_says_so_and_a_foreign_word_is_nothing():
    told = []

    async def act(user, _buttons):
        group = user.find(kind=HoldButtons)
        for word in ("go", "other", None, ["go"]):
            group.trigger("hold", word)
        group.trigger("release")

    visited(lambda: HoldButtons([HoldButton("go", "Go")], told.append, lambda: told.append("let go")), act)
    assert told == ["go", "let go"]


def test_a_held_button_speaks_often_enough_for_the_dead_man():
    from canopen_control.view.robot_connection import HOLD_TIMEOUT_NS

    async def act(_user, buttons):
        return buttons.props["period"]

    assert visited(lambda: HoldButtons([], print, print), act) * 1e6 * 3 <= HOLD_TIMEOUT_NS


def test_it_is_given_its_tree():
    async def act(_user, scene):
        return scene.props["tree"]

    assert visited(lambda: RobotScene({"root": "base"}), act) == {"root": "base"}


def test_every_line_is_a_row_that_is_sent():
    async def act(_user, strips):
        return strips.props["charts"], strips.props["names"]

    found, rows = visited(lambda: StripCharts(charts(["a"], ["can"]), names(["a"], ["can"]), 30.0), act)
    assert {line["row"] for chart in found for line in chart["lines"]} <= set(rows)


def test_a_page_says_that_it_is_there_while_it_is_to():
    told = []

    async def act(user, presence):
        user.find(kind=PresenceElement).trigger("here")
        before = presence.props["on"]
        presence.switch(on=True)
        return before, presence.props["on"]

    assert visited(lambda: PresenceElement(lambda: told.append("here")), act) == (False, True)
    assert told == ["here"]


class Heard:
    """What a tree tells."""

    def __init__(self):
        self.told = []

    def seen(self, addresses):
        self.told.append(("seen", addresses))

    def search(self, text):
        self.told.append(("search", text))

    def write(self, address, text):
        self.told.append(("write", address, text))


def test_a_tree_of_objects_tells_what_is_in_sight_sought_and_written_and_no_nonsense():
    heard = Heard()

    async def act(user, tree):
        for event, args in (
            ("seen", ["0x6081:00", 5]),
            ("seen", None),
            ("search", "v" * 500),
            ("write", {"address": "0x6081:00", "text": "5"}),
            ("write", {"address": 7, "text": "5"}),
            ("write", "0x6081:00"),
        ):
            user.find(kind=ObjectTree).trigger(event, args)
        return tree._props["writes"], tree._props["product"]

    assert visited(lambda: ObjectTree([], "286-4F6", heard, writes=False), act) == (False, "286-4F6")
    assert heard.told == [
        ("seen", ["0x6081:00"]),
        ("seen", []),
        ("search", "v" * 200),
        ("write", "0x6081:00", "5"),
    ]


def test_a_tree_is_sent_values_matches_and_answers(monkeypatch):
    sent = []
    monkeypatch.setattr(ObjectTree, "run_method", lambda _tree, *args: sent.append(args))

    async def act(_user, tree):
        tree.values({"0x6081:00": {"value": "5", "meaning": None, "changed": True, "error": None, "bits": []}})
        tree.matches("", None)
        tree.matches("speed", ("0x6081:00",))
        tree.answer("0x6081:00", "written", good=True)

    visited(lambda: ObjectTree([], "", Heard(), writes=True), act)
    assert [each[0] for each in sent] == ["values", "matches", "matches", "answer"]
    assert sent[1:] == [
        ("matches", None, "", ""),
        ("matches", ["0x6081:00"], "", "speed"),
        ("answer", "0x6081:00", "written", True),
    ]


@pytest.mark.rest
def test_a_chosen_file_comes_to_who_waits_for_it_and_the_upload_goes_with_its_page():
    taken = []

    def build():
        with ui.column() as column:
            FileUpload("Choose", lambda event: taken.append(event.file.name), lambda: None, 100)
        return column

    async def act(user, column):
        upload = seen(ui.upload)[0]
        path, freed = upload.props["url"], weakref.ref(upload)
        answer = await user.http_client.post(path, files={"file": ("wave.json", b"{}")})
        assert (answer.status_code, taken) == (200, ["wave.json"])
        column.clear()
        del upload
        await settle(turns=5)
        await user.http_client.post(path, files={"file": ("more.json", b"{}")})
        assert taken == ["wave.json"]
        gc.collect()
        assert freed() is None  # and with it the page, which its handlers know

    visited(build, act)
