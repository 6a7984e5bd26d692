"""The Scope tab for a simulated user: choices, charts, cursors, overlay and files."""

import contextlib

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from nicegui import ui
from support.pages import FakeContext, StubDesk, html, settle, upload, visited
from support.service_node import NodeStub

from canopen_control.commissioning.scope_capture import NamedShot, Shot, csv_of
from canopen_control.commissioning.scope_run import ScopeRun
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.od.eds import read_eds
from canopen_control.view.drive import scope_tab
from canopen_control.view.drive.drive_tab import DriveTabContext
from canopen_control.view.drive.scope_tab import ScopeTab, read_overlay, signals_of

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 3).od
NAMED = NamedShot(
    Shot(tuple((10.0 + n / 10, (float(n),)) for n in range(11))), ("left_drive:0x606C",), ("counts/s",), "shot of 10"
)


@pytest.fixture
def began(monkeypatch):
    """Keep what is begun from running; its shots are given."""
    runs = []

    def start(run):
        runs.append(run)

    monkeypatch.setattr(ScopeRun, "start", start)
    return runs


@pytest.fixture
def sent(monkeypatch):
    calls = []
    monkeypatch.setattr(ui.echart, "run_chart_method", lambda _chart, name, *args, **_more: calls.append((name, *args)))
    return calls


@contextlib.asynccontextmanager
async def played(od=OD):
    page = FakeContext()
    desk = StubDesk(NodeStub({}), od)

    async with visited(lambda: ScopeTab(DriveTabContext(page, desk))) as (user, tab):
        await settle(lambda: bool(tab._signals.options))
        tab.show(page.content())
        yield user, tab, page


def finish(run, *shots):
    run.shots.extend(shots)
    run.captures += len(shots)
    run.words, run.over = "1 shot", True


async def test_numbers_of_the_node_and_joints_of_the_robot_are_offered():
    async with played() as (_user, tab, _page):
        options, chosen = tab._signals.options, tab._signals.value
    assert options["left_drive:0x606C:00"] == "0x606C Velocity actual value"
    assert options["left:velocity"] == "left velocity"
    assert chosen == ["left_drive:0x606C:00", "left_drive:0x6064:00"]
    assert not any("0x1008" in item for item in signals_of(OD, "n"))  # a text
    assert signals_of(None, "n") == {}


async def test_a_shot_is_drawn_with_cursors_and_the_next_one_over_it(began, sent):
    async with played() as (user, tab, page):
        user.find("Single").click()
        await settle(lambda: bool(began))
        tab.show(page.content())
        waits = tab._single.enabled, tab._end.enabled
        finish(began[0], NAMED)
        tab.show(page.content())
        first = [option["id"] for option in tab._chart.options["series"]]
        tab._range.value = {"min": 0, "max": 500}
        readings = html(user)
        user.find("Keep as overlay").click()
        finish(began[0], NamedShot(NAMED.shot, NAMED.names, NAMED.units, "shot of 11"))
        tab.show(page.content())
        both = [option["name"] for option in tab._chart.options["series"][:2]]
        user.find("Drop the overlay").click()
        after = [option["id"] for option in tab._chart.options["series"]]
    assert (began[0].options.length, began[0].options.trigger, began[0].options.rolling) == (2.0, "", False)
    assert waits == (False, True)
    assert first == after == ["s0", "marks0"]
    assert [name for name, *_ in sent] == ["setOption"]
    assert "dt 0.5 s (2 Hz)" in readings
    assert both == ["left_drive:0x606C (shot of 10)", "left_drive:0x606C"]


async def test_a_trigger_is_asked_for_as_the_verb_writes_it(began):
    async with played() as (user, tab, page):
        tab._trigger.value = "rising"
        shown = tab._level.visible, tab._before.visible
        tab._place.value, tab._level.value = 2, 50
        user.find("Rolling").click()
        await settle(lambda: bool(began))
        began[0].over = True
        tab._trigger.value = "fault"
        tab.show(page.content())
        user.find("Single").click()
        await settle(lambda: len(began) == 2)
        assert (shown, tab._level.visible) == ((True, True), False)
    assert (began[0].options.trigger, began[0].options.before, began[0].options.rolling) == ("2:rising:50", 0.4, True)
    assert began[1].options.trigger == "fault"


async def test_nothing_chosen_is_reported_and_a_scope_continues_when_the_tab_is_left(began):
    async with played() as (user, tab, page):
        chosen, tab._signals.value = tab._signals.value, []
        user.find("Single").click()
        words = html(user)
        tab._signals.value = chosen
        user.find("Single").click()
        await settle(lambda: bool(began))
        tab.leave()
        goes_on = not began[0]._ending.is_set()
        tab.show(page.content())
        user.find("Abort").click()
        ended = began[0]._ending.is_set()
    assert "at least one signal" in words
    assert (goes_on, ended) == (True, True)


async def test_files_are_what_the_scope_writes(began, sent, monkeypatch):
    saved = {}

    async def picture(_chart, _name, _look, timeout):
        return "data:image/png;base64,iVBORw=="

    monkeypatch.setattr(ui.echart, "run_chart_method", picture)

    async with played() as (user, tab, page):
        monkeypatch.setattr(ui.download, "content", lambda data, name: saved.update({name: data}))
        user.find("Single").click()
        await settle(lambda: bool(began))
        finish(began[0], NAMED)
        tab.show(page.content())
        user.find("CSV").click()
        user.find("PNG").click()
        await settle(lambda: len(saved) == 2)
    assert saved["left_drive.csv"].startswith(b"time,t,left_drive:0x606C")
    assert saved["left_drive.png"] == b"\x89PNG"


@pytest.mark.rest
async def test_a_file_that_was_saved_is_laid_below_the_shot_and_a_bad_one_is_reported(began, monkeypatch):
    reports = []
    monkeypatch.setattr(scope_tab, "show_notice", lambda what, why: reports.append(why))
    async with played() as (user, tab, page):
        user.find("Single").click()
        await settle(lambda: bool(began))
        finish(began[0], NAMED)
        tab.show(page.content())
        await upload(user, "old.csv", csv_of(NAMED).encode(), until=lambda: tab._overlay is not None)
        both = [option["name"] for option in tab._chart.options["series"][:2]]
        await upload(user, "photo.csv", b"\xff\xd8\xff", until=lambda: bool(reports))
        label, can_be_dropped = tab._overlay.label, tab._drop.visible
    assert both == ["left_drive:0x606C (old.csv)", "left_drive:0x606C"]
    assert (label, can_be_dropped) == ("old.csv", True)
    assert reports == ["photo.csv is not a text file; choose a CSV file that was saved by a scope"]


def test_an_overlay_has_a_signal_of_the_shot():
    text = csv_of(NAMED).encode()
    assert read_overlay(b"\xef\xbb\xbf" + text, "a.csv", None).names == NAMED.names
    other = NamedShot(NAMED.shot, ("right_drive:0x606C",))
    with pytest.raises(ConfigError, match=r"a\.csv has the signals left_drive:0x606C, but none of right_drive:0x606C"):
        read_overlay(text, "a.csv", other)
    for bad in (b"", b"a,b\n", b'"', text.replace(b"3", b"x"), text + b"1,2\n"):
        with pytest.raises(ConfigError):
            read_overlay(bad, "a.csv", NAMED)
