import contextlib

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from nicegui import ui
from support.pages import FakeContext, StubDesk, expect_seen, html, seen, settle, upload, visited
from support.parameter_node import session_with

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.commissioning.jobs import FIRMWARE, RESTORE, JobRun, Reached
from canopen_control.commissioning.parameter_jobs import run_backup
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, EdsError
from canopen_control.od.eds import read_eds
from canopen_control.view.drive.drive_tab import DriveTabContext
from canopen_control.view.drive.parameters_tab import ParametersTab, uploaded

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 3).od
SPEED = (0x6081, 0)


def desk_of(node_id=3, name="left_drive"):
    device = session_with(OD, node_id)
    device.transfers.command(NmtCommand.ENTER_PRE_OPERATIONAL)
    return StubDesk(device.transfers, device.od, name, node_id)


def dcf(desk):
    work = JobRun(RESTORE, "x")
    desk.with_session(lambda session: run_backup(session, work, Reached()))
    return work.file[1]


@contextlib.asynccontextmanager
async def played(desk=None, other=None, **how):
    page, desk = FakeContext(**how), desk or desk_of()
    page.robot._node_jobs = {desk.place.name: desk, **({other.place.name: other} if other is not None else {})}

    async with visited(lambda: ParametersTab(DriveTabContext(page, desk)), page) as (user, tab):
        yield user, tab, page


async def press(user, label, tab, page):
    tab.show(page.content())
    user.find(label).click()
    await settle(lambda: tab._node_jobs.work is not None and tab._node_jobs.work.over)
    tab.show(page.content())
    return tab._node_jobs.work


async def test_a_backup_is_made_and_can_be_saved():
    async with played() as (user, tab, page):
        work = await press(user, "Back up", tab, page)
        message, there = work.sentence, "Save the file" in [item.text for item in seen(ui.button)]
    assert message.endswith("parameters to left_drive.dcf")
    assert there


@pytest.mark.rest
async def test_a_file_is_compared_and_restored():
    desk = desk_of()
    data = dcf(desk)
    desk.with_session(lambda session: session.write_value(OD[SPEED], 777))
    async with played(desk) as (user, tab, page):
        await upload(user, "left.dcf", data)
        text = html(user)
        compared = await press(user, "Compare with the node", tab, page)
        shown, desk.work = html(user), None
        tab._form.inputs["store"].value = True
        restored = await press(user, "Restore the file", tab, page)
        compared, restored = compared.sentence, restored.sentence
    assert "left.dcf: " in text
    assert "of node 3" in text
    assert "1 of " in compared
    assert "<td>0x6081:00</td>" in shown
    assert restored.endswith("1 written; stored")
    assert desk.with_session(lambda session: session.read_value(OD[SPEED])) == 0


async def test_what_must_not_be_is_a_sentence_on_the_page():
    desk = desk_of()
    data = dcf(desk)
    desk.stub.robot_leaves_it = False
    async with played(desk) as (user, tab, page):
        await upload(user, "left.dcf", data)
        await press(user, "Restore the file", tab, page)
        assert "controlled by the running robot pair; nothing was written" in html(user)


@pytest.mark.rest
async def test_a_file_that_is_none_is_reported_and_the_one_before_is_discarded():
    desk = desk_of()
    data = dcf(desk)
    async with played(desk) as (user, tab, page):
        await upload(user, "left.dcf", data)
        await upload(user, "x.dcf", b"nonsense")
        tab.show(page.content())
        text, buttons = html(user), {item.text: item.enabled for item in seen(ui.button)}
    assert "Not read. x.dcf" in text
    assert (buttons["Compare with the node"], buttons["Restore the file"]) == (False, False)


@pytest.mark.rest
async def test_a_node_is_cloned_from_another_with_the_globs_that_stay():
    old, new = desk_of(4, "old_drive"), desk_of()
    old.with_session(lambda session: [session.write_value(OD[index, 0], 55) for index in (0x6081, 0x6083)])
    async with played(new, old) as (user, tab, page):
        tab._form.inputs["protect"].value = "0x6083, "
        assert "1 written" in (await press(user, "Clone into this node", tab, page)).sentence
    assert new.with_session(lambda session: session.read_value(OD[SPEED])) == 55


async def test_a_read_only_page_may_back_up_and_compare():
    async with played(teleop=False) as (user, _tab, _page):
        text, buttons = html(user), [item.text for item in seen(ui.button)]
    assert "This page is read-only" in text
    assert "Restore the file" not in buttons
    assert {"Back up", "Compare with the node"} <= set(buttons)


async def test_nothing_else_begins_next_to_it():
    async with played() as (user, tab, page):
        tab._node_jobs.work = JobRun(FIRMWARE, "Loading a.bin into left_drive")
        user.find("Back up").click()
        await expect_seen(user, "left_drive is busy: Loading a.bin into left_drive; wait until this has ended")
        tab.show(page.content())
        assert "Back up" not in [item.text for item in seen(ui.button) if item.enabled]


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "x.dcf is empty"),
        (b"\x7fELF\0\1", "x.dcf"),
        (b"just text", "x.dcf"),
        (data_path("eds", "TMCM-1270.eds").read_bytes(), "has no node-ID"),
    ],
)
def test_a_file_that_is_not_a_backup_is_reported(data, words):
    with pytest.raises((ConfigError, EdsError), match=words):
        uploaded(data, "x.dcf")
