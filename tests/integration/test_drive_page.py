"""The Drive view in a real browser: robby on virtual drives, and the resulting frames and events."""

import pytest
from support.browser import RobotPage
from support.host import eventually

from canopen_control.client import RobotClient
from canopen_control.rpc.messages.robot import GetStatus

pytestmark = pytest.mark.browser

SPEED = "0x6081:00"
#: whether a click in the middle of an element reaches it, and nothing that lies above it
ON_TOP = """button => {
  const {x, y, width, height} = button.getBoundingClientRect();
  return button.contains(document.elementFromPoint(x + width / 2, y + height / 2));
}"""


def opened(show, tab, size=(1440, 900), node="left_drive"):
    page = RobotPage(show.chromium, f"{show.url}?drive={node}&tab={tab}", size)
    page.page.goto(page.url, wait_until="commit")
    page.page.get_by_role("button", name="STOP", exact=True).wait_for()
    page.page.locator(f".cc-t-{tab}").wait_for()
    return page


def row(page, address=SPEED):
    return page.page.locator(f"[data-a='{address}']")


def value(page, address=SPEED):
    return row(page, address).locator(".cc-o-value b").inner_text()


def lines(page, tab):
    return " ".join(page.page.locator(f".cc-t-{tab} .cc-line").all_inner_texts())


def test_an_object_is_found_read_written_and_undone_and_another_page_shows_it(show, keep):
    show = show("vobjects", teleop=True)
    pages = [opened(show, "objects"), opened(show, "objects")]
    for page in pages:
        page.page.get_by_label("search objects").fill(SPEED[:6])
        assert eventually(lambda page=page: row(page).count() == 1 and value(page) == "1600"), page.text()
    one, other = pages
    row(one).locator(".cc-o-name").click()
    field = one.page.get_by_label(f"new value of {SPEED}")
    field.fill("99999999999")
    field.press("Enter")
    assert eventually(lambda: "nothing was written" in row(one).inner_text())
    field.fill("1234")
    field.press("Enter")
    assert eventually(lambda: [value(page) for page in pages] == ["1234", "1234"])
    keep(one, "drive_objects")
    with RobotClient.connect("vobjects") as robot:
        texts = [event.text for event in robot.ask(GetStatus()).events if event.kind == "object_written"]
    assert texts == [f"view wrote 1234 to {SPEED} Profile velocity"]
    other.page.get_by_role("button", name="Undo").click()
    assert eventually(lambda: [value(page) for page in pages] == ["1600", "1600"])


@pytest.mark.timed  # a drive that a busy machine loses is booted anew, which ends what is being read of it
def test_a_drive_is_backed_up_compared_and_not_written_while_the_robot_has_it(show, keep, tmp_path):
    show = show("vbackup", teleop=True)
    page = opened(show, "parameters")
    page.page.get_by_role("button", name="Back up", exact=True).click()
    save = page.page.get_by_role("button", name="Save the file")
    assert eventually(save.is_visible), page.text()
    with page.page.expect_download() as download:
        page.page.get_by_role("button", name="Save the file").click()
    file = tmp_path / download.value.suggested_filename
    download.value.save_as(file)
    assert file.name == "left_drive.dcf"
    page.page.locator(".cc-t-parameters input[type=file]").set_input_files(file)
    page.page.get_by_text("left_drive.dcf: ", exact=False).first.wait_for()
    page.page.get_by_role("button", name="Compare with the node").click()
    assert eventually(lambda: "parameters, equal" in lines(page, "parameters")), lines(page, "parameters")
    page.page.get_by_role("button", name="Restore the file").click()
    assert eventually(lambda: "nothing was written" in lines(page, "parameters")), lines(page, "parameters")
    keep(page, "drive_parameters")


def test_a_shot_of_the_scope_is_drawn_by_the_pages_own_files_and_saved_as_it_is_drawn(show, keep):
    show = show("vscope")
    page = opened(show, "scope")
    page.page.get_by_text("0x606C Velocity actual value").first.wait_for()
    page.page.get_by_role("button", name="Single", exact=True).click()
    page.page.locator(".cc-t-scope canvas").first.wait_for()
    assert eventually(lambda: "1 capture; " in lines(page, "scope")), lines(page, "scope")
    with page.page.expect_download() as download:
        page.page.get_by_role("button", name="PNG", exact=True).click()
    assert download.value.path().read_bytes().startswith(b"\x89PNG")
    assert page.foreign() == []
    keep(page, "drive_scope_shot")


def test_stop_is_in_reach_in_every_tab_and_the_page_is_not_wider_than_its_screen(show, keep):
    show = show("vtabs")
    page = opened(show, "status")
    for tab in ("status", "objects", "scope", "tune", "parameters", "firmware"):
        page.page.get_by_role("tab", name=tab.title()).click()
        page.page.locator(f".cc-t-{tab}").wait_for()
        for size in ((1440, 900), (390, 844)):
            page.page.set_viewport_size({"width": size[0], "height": size[1]})
            stop = page.page.get_by_role("button", name="STOP", exact=True)
            box = stop.bounding_box()
            assert 0 <= box["y"] <= size[1] - box["height"]
            assert stop.evaluate(ON_TOP), (tab, size)
            assert page.page.evaluate("() => document.documentElement.scrollWidth") <= size[0], (tab, size)
            keep(page, f"drive_{tab}_{size[0]}")
    assert "tab=firmware" in page.page.url  # loaded anew it is where it was
    page.click("STOP")
    with RobotClient.connect("vtabs") as robot:
        assert eventually(lambda: robot.ask(GetStatus()).latched)
