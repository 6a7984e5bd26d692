"""The Objects tab for a simulated user: reading, updates, and the results of writing."""

import contextlib

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from nicegui import ui
from support.pages import FakeContext, StubDesk, at_rest, html, seen, settle, visited
from support.service_node import NodeStub

from canopen_control.commissioning.object_rows import LiveObject
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.od.eds import read_eds
from canopen_control.view.drive.drive_tab import DriveTabContext
from canopen_control.view.drive.drive_view import ObjectsTab
from canopen_control.view.elements.nicegui_elements import ObjectTree

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 3).od
SPEED = OD[0x6081, 0]


class Watched:
    """Stands for the reader of live objects."""

    def __init__(self):
        self.watched, self.written = [], []

    def watch(self, _page, _desk, entries):
        self.watched.append([entry.index for entry in entries])

    def soon(self, _desk, entry):
        self.written.append(entry.index)


@pytest.fixture
def sent(monkeypatch):
    """Return what is sent to the tree."""
    calls = []
    monkeypatch.setattr(ObjectTree, "run_method", lambda _tree, name, *args: calls.append((name, *args)))
    return calls


@contextlib.asynccontextmanager
async def played(*, od=OD, teleop=True, held=None):
    page = FakeContext(teleop=teleop)
    page.robot.live_reader = Watched()
    desk = StubDesk(NodeStub(held or {(0x6081, 0): bytes(4)}), od)
    async with visited(lambda: ObjectsTab(DriveTabContext(page, desk))) as (user, tab):
        await settle(lambda: tab._tree is not None or od is not OD)
        tab.show(page.content())
        yield user, tab, page


async def test_what_is_in_sight_is_read_until_the_tab_is_left(sent):
    async with played() as (user, tab, page):
        user.find(kind=ObjectTree).trigger("seen", ["0x6081:00", "0x6041:00"])
        tab.leave()
        tab.show(page.content())
        tab.leave()
        assert page.robot.live_reader.watched == [[0x6081, 0x6041, 0x6061], [], [0x6081, 0x6041, 0x6061], []]


async def test_values_are_sent_once_the_tree_is_there(sent):
    async with played() as (user, tab, page):
        tab._context.node_jobs.keep(LiveObject(SPEED, 500))
        tab.show(page.content())
        before = list(sent)
        user.find(kind=ObjectTree).trigger("seen", ["0x6081:00"])
        tab.show(page.content())
        tab.show(page.content())
        assert before == []
        assert [item[1]["0x6081:00"]["value"] for item in sent] == ["500", "500"]  # as it came into sight, and as news


async def test_a_search_is_answered_with_what_it_means(sent):
    async with played() as (user, _tab, _page):
        user.find(kind=ObjectTree).trigger("search", "0x6081")
        user.find(kind=ObjectTree).trigger("search", "")
        user.find(kind=ObjectTree).trigger("search", "nonsense")
    assert sent[0] == ("matches", ["0x6081:00"], "", "0x6081")
    assert sent[1] == ("matches", None, "", "")
    assert sent[2][:2] == ("matches", [])


async def test_a_write_is_answered_at_its_object_and_can_be_undone(sent):
    async with played() as (user, tab, page):
        user.find(kind=ObjectTree).trigger("write", {"address": "0x6081:00", "text": "1234"})
        await settle(lambda: len(sent) > 0)
        tab.show(page.content())
        words = html(user)
        user.find("Undo").click()
        await settle(lambda: len(sent) > 1)
        written, soon = tab._context.node_jobs.stub.written, page.robot.live_reader.written
    assert sent[0] == ("answer", "0x6081:00", "written: 0x6081:00 Profile velocity: 0 -> 1234", True)
    assert "last write: 0x6081:00 Profile velocity: 0 -&gt; 1234" in words
    assert sent[1][2] == "undone: 0x6081:00 Profile velocity: 1234 -> 0"
    assert [item[2] for item in written] == [(1234).to_bytes(4, "little"), bytes(4)]
    assert soon == [0x6081, 0x6081]


async def test_a_refusal_is_reported_at_its_object(sent):
    async with played() as (user, tab, _page):
        for text in ("99999999999", "fast"):
            user.find(kind=ObjectTree).trigger("write", {"address": "0x6081:00", "text": text})
        user.find(kind=ObjectTree).trigger("write", {"address": "0x6041:00", "text": "1"})
        tab._context.node_jobs.stub.refused[0x6083, 0] = 0x08000022
        tab._context.node_jobs.stub.objects[0x6083, 0] = bytes(4)
        user.find(kind=ObjectTree).trigger("write", {"address": "0x6083:00", "text": "1"})
        await settle(lambda: len(sent) == 4)
        assert tab._context.node_jobs.stub.written == []
    reported = {item[1]: item[2] for item in sent}
    assert "is read-only; nothing was written" in reported["0x6041:00"]
    assert "0x08000022" in reported["0x6083:00"]
    assert not any(good for *_, good in sent)


async def test_a_read_only_page_writes_nothing_for_any_request(sent):
    async with played(teleop=False) as (user, tab, _page):
        user.find(kind=ObjectTree).trigger("write", {"address": "0x6081:00", "text": "1234"})
        await at_rest()
        assert tab._context.node_jobs.stub.written == []
        assert (seen(ui.button)[0].enabled, tab._tree._props["writes"]) == (False, False)


@pytest.mark.rest
async def test_a_node_without_an_eds_and_one_that_cannot_be_read_are_reported():
    async with played(od=None) as (user, _tab, _page):
        await at_rest()
        assert "The objects of this node are unknown" in html(user)

    class Broken(StubDesk):
        def dictionary(self):
            raise ConfigError("no EDS file left.eds")

    page = FakeContext()
    desk = Broken(NodeStub({}), None)
    async with visited(lambda: ObjectsTab(DriveTabContext(page, desk))) as (user, _tab):
        await at_rest()
        assert "no EDS file left.eds" in html(user)
