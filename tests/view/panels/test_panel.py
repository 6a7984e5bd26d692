import pytest
from nicegui import ui
from support.pages import FakeContext, expect_seen, seen, visited

from canopen_control.view.elements.nicegui_elements import HoldButton, HoldButtons
from canopen_control.view.panels.panel import Html, hold_buttons, show_notice, value_slider
from canopen_control.view.robot_connection import twist_motion

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")


async def test_a_slider_stands_between_its_name_and_its_value():
    async with visited(lambda: value_slider("speed", 0.0, 2.0, 0.1, 0.5)) as (_user, _built):
        slider = seen(ui.slider)[0]
        slider.value = 0.456
        assert (slider.props["max"], [label.text for label in seen(ui.label)]) == (2.0, ["speed", "0.46"])


async def test_what_is_held_is_sent_and_the_end_is_the_pages():
    context = FakeContext()
    motions = {"go": twist_motion("base", 1.0, 0.0), "wait": None}
    buttons = [HoldButton(key, key) for key in motions]
    async with visited(lambda: hold_buttons(context, buttons, motions.get)) as (user, _built):
        for key in motions:
            user.find(kind=HoldButtons).trigger("hold", key)
        user.find(kind=HoldButtons).trigger("release")
    assert context.held == [motions["go"]]
    assert context.let == 1


async def test_only_what_has_changed_is_sent():
    async with visited(Html) as (user, piece):
        outbox = user._client.outbox
        sent = []
        for text in ("a", "a", "b"):
            outbox.updates.clear()
            piece.show(text)
            sent.append(bool(outbox.updates))
        assert sent == [True, False, True]


async def test_a_notice_is_seen():
    async with visited(lambda: None) as (user, _made):
        show_notice("Not driven", "another page drives")
        await expect_seen(user, "Not driven: another page drives")
