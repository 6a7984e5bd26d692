import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from nicegui import ui
from support.pages import StubDesk, html, seen, settle, visited
from support.service_node import NodeStub

from canopen_control.commissioning.jobs import FIRMWARE, RESTORE, JobRun
from canopen_control.view.drive.drive_tab import WorkBar, outcome, progress_words


def test_how_far_it_is_how_fast_and_how_long():
    work = JobRun(FIRMWARE, "Loading a.bin", "bytes", doing="sending")
    assert progress_words(work, 0.0) == "Loading a.bin: sending"
    work.total = 100_000
    assert progress_words(work, 10.0) == "Loading a.bin: sending, 0 of 100,000 bytes (0 %)"
    work.done = 40_000
    assert progress_words(work, 11.0).endswith("40,000 of 100,000 bytes (40 %), 40,000 bytes/s, 2 s left")


def test_what_came_of_it_is_escaped():
    work = JobRun(RESTORE, "x", lines=["<b>"], table=[("0x6081:00", "<i>", "1", "2")])
    assert "&lt;b&gt;" in outcome(work)
    assert "<td>&lt;i&gt;</td>" in outcome(work)
    work.table *= 500
    assert "and 300 more" in outcome(work)


async def shown(work, press=""):
    desk = StubDesk(NodeStub({}), None)
    desk.work = work
    async with visited(lambda: WorkBar(desk, "parameters")) as (user, bar):
        if press:
            user.find(press).click()
            await settle(lambda: work._ending.is_set())
        bar.show()
        return html(user), [item.text for item in seen(ui.button)]


async def test_work_of_another_tab_is_reported_and_is_in_the_way():
    words, buttons = await shown(JobRun(FIRMWARE, "Loading a.bin"))
    assert "Loading a.bin is still running; wait until this has ended." in words
    assert buttons == []


async def test_work_that_continues_may_be_ended():
    work = JobRun(RESTORE, "Restoring a.dcf", "groups", done=1, total=4)
    words, buttons = await shown(work, press="Abort")
    assert "1 of 4 groups (25 %)" in words
    assert buttons == ["Abort"]
    assert work._ending.is_set()


@pytest.mark.rest
async def test_its_end_is_reported_with_the_file_that_came_of_it():
    words, buttons = await shown(JobRun(RESTORE, "x", sentence="134 parameters", good=True, file=("a.dcf", b"x")))
    assert "cc-good'>134 parameters" in words
    assert buttons == ["Save the file"]
    words, buttons = await shown(JobRun(RESTORE, "x", sentence="is enabled", good=False))
    assert "cc-bad'>is enabled" in words
    assert buttons == []
