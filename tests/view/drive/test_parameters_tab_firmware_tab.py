import contextlib

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from nicegui import ui
from support.pages import FakeContext, StubDesk, expect_seen, html, seen, settle, upload, visited
from support.service_node import NodeStub

from canopen_control.commissioning.jobs import RESTORE, JobRun
from canopen_control.rpc.messages.health import BAD
from canopen_control.view.drive import parameters_tab
from canopen_control.view.drive.drive_tab import DriveTabContext
from canopen_control.view.drive.parameters_tab import MAX_FIRMWARE_BYTES, FirmwareTab


@contextlib.asynccontextmanager
async def played(**how):
    page, desk = FakeContext(**how), StubDesk(NodeStub({}), None)

    async with visited(lambda: FirmwareTab(DriveTabContext(page, desk)), page) as (user, tab):
        yield user, tab, page


@pytest.fixture
def loaded(monkeypatch):
    """Return what is loaded: image and options."""
    calls = []

    def load(_session, _work, image, options):
        calls.append((image, options))
        return "program 1 of 5 bytes runs"

    monkeypatch.setattr(parameters_tab, "load_program", load)
    return calls


def buttons():
    return {item.text: item.enabled for item in seen(ui.button)}


async def test_a_program_is_chosen_and_loaded(loaded):
    async with played() as (user, tab, page):
        before = buttons()["Load into the drive"]
        await upload(user, "a.bin", b"image")
        tab._form.inputs["expected"].value = "0x1A"
        tab.show(page.content())
        user.find("Load into the drive").click()
        await settle(lambda: tab._node_jobs.work is not None and tab._node_jobs.work.over)
        tab.show(page.content())
        text, after = html(user), buttons()
    assert before is False
    assert [(image, options.number, options.expected) for image, options in loaded] == [(b"image", 1, 0x1A)]
    assert "a.bin: 5 bytes" in text
    assert "program 1 of 5 bytes runs" in text
    assert "Abort" not in after  # half a program is none


async def test_a_file_that_cannot_be_one_and_a_number_that_is_none_are_reported(loaded):
    async with played() as (user, tab, page):
        await upload(user, "empty.bin", b"")
        text = html(user)
        tab.show(page.content())
        off = buttons()["Load into the drive"]
        await upload(user, "a.bin", b"image")
        tab._form.inputs["number"].value = "fifth"
        tab.show(page.content())
        user.find("Load into the drive").click()
        await expect_seen(user, "Not started: 'fifth' is not a number of a program: 1 to 254")
    assert f"cc-{BAD}'>Not read. empty.bin is empty" in text
    assert (off, loaded) == (False, [])


async def test_a_file_that_is_too_long_for_a_running_robot_is_reported(loaded):
    async with played() as (user, _tab, _page):
        await upload(user, "long.bin", bytes(MAX_FIRMWARE_BYTES + 1))
        assert "long.bin: at most 400000 bytes can be loaded through a running robot" in html(user)


async def test_nothing_begins_alongside_other_work(loaded):
    async with played() as (user, tab, page):
        await upload(user, "a.bin", b"image")
        tab.show(page.content())
        tab._node_jobs.work = JobRun(RESTORE, "Restoring a.dcf")
        user.find("Load into the drive").click()
        await expect_seen(user, "left_drive is busy: Restoring a.dcf")
    assert loaded == []


async def test_a_read_only_page_loads_nothing():
    async with played(teleop=False) as (user, _tab, _page):
        text, there = html(user), list(buttons())
    assert "This page is read-only" in text
    assert "Load into the drive" not in there
