"""A whole page of a robot, for a simulated user."""

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from nicegui import ui
from support.pages import FakeContext, html, seen, state, visited

from canopen_control.view.elements.nicegui_elements import Feed
from canopen_control.view.view_app import PANELS, Page, build_waiting, stop_html


def made(context, act):
    async def show(user, page):
        page.show(context.content())
        return await act(user, page)

    return visited(lambda: Page(context), show)


def test_everything_is_on_the_page_and_stop_is_before_it():
    context = FakeContext()

    async def act(user, _page):
        await user.should_see("Disable")
        return html(user), user._client.body_html

    text, body = made(context, act)
    for words in ("pair", "running", "enabled, follows commands", "2.50<wbr><small>velocity", "Nothing has happened"):
        assert words in text
    assert 'id="cc-stop-button"' in body


def test_stop_asks_nobody_but_its_own_server_and_needs_nothing_else():
    whole = stop_html()
    assert "http" not in whole
    assert "import" not in whole.split("<script>")[1]
    for word in ("nicegui", "socket", "Vue", "THREE"):
        assert word not in whole.split("<script>")[1]


def test_a_panel_is_a_line_of_the_table():
    assert len({place.key for place in PANELS}) == len(PANELS)
    assert {place.where for place in PANELS} == {"side", "middle", "right"}


def test_only_news_are_told():
    context = FakeContext()

    async def act(_user, page):
        first = page.changes(context.content())
        same = page.changes(context.content())
        lost = page.changes(context.content(state(latched=True), lost="gone"))
        return first, same, lost

    first, same, lost = made(context, act)
    assert first == {"titles": {"left": "left velocity, rad/s", "error": "Tracking error, rad/s"},
                     "lost": False, "latched": False}  # fmt: skip
    assert same == {}
    assert lost == {"lost": True, "latched": True}


@pytest.mark.rest
def test_what_is_sent_goes_through_the_feed(monkeypatch):
    sent = []
    monkeypatch.setattr(Feed, "send", lambda self, data: sent.append(data))

    async def act(_user, page):
        page.send({"scene": {}})

    made(FakeContext(), act)
    assert sent == [{"scene": {}}]


def test_a_robot_that_was_never_there_has_a_page_with_stop_and_the_reason():
    async def act(user, _made):
        return html(user), user._client.body_html, seen(ui.button)

    text, body, buttons = visited(lambda: build_waiting("<robby>", "no robot '<robby>' is running"), act)
    assert "&lt;robby&gt;" in text
    assert "not connected" in text
    assert 'id="cc-stop-button"' in body
    assert buttons == []
