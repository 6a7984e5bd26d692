import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from nicegui import ui
from support.pages import AXIS, NODE, FakeContext, html, seen, settle, state, visited

from canopen_control.rpc.messages.robot import AxisRequest
from canopen_control.view.panels.target_panel import PowerPanel


def pressed(label, refusal=None, **status):
    context = FakeContext(**status)
    context.refusal = refusal

    async def act(user, _panel):
        user.find(label).click()
        await settle(lambda: context.asked)
        if refusal:
            await user.should_see(refusal)
        return context.asked

    return visited(lambda: PowerPanel(context), act)


@pytest.mark.parametrize(("label", "action"), [("Disable", "disable"), ("Reset fault", "fault-reset")])
def test_a_button_asks_for_its_action(label, action):
    assert pressed(label) == [AxisRequest(action=action, node="left_drive", source="view")]


def test_a_node_without_an_axis_has_no_row():
    context = FakeContext(nodes={"left_drive": NODE, "io": NODE | {"axes": []}})

    async def act(_user, _panel):
        return [label.text for label in seen(ui.label)]

    assert visited(lambda: PowerPanel(context), act) == ["left_drive"]


def test_several_drives_have_a_row_for_all():
    axes = [AXIS | {"joint": "lift"}]
    context = FakeContext(nodes={"left_drive": NODE, "lift_drive": NODE | {"axes": axes}})

    async def act(_user, _panel):
        return [button.text for button in seen(ui.button)].count("Disable"), [label.text for label in seen(ui.label)]

    assert visited(lambda: PowerPanel(context), act) == (3, ["all drives", "left_drive", "lift_drive"])


def test_what_is_refused_is_told():
    pressed("Disable", "the drive does not answer")


def test_without_drives_there_is_nothing_to_enable():
    context = FakeContext(nodes={})

    async def act(user, _panel):
        return html(user)

    assert "No drives" in visited(lambda: PowerPanel(context), act)


def test_enable_is_grey_and_closed_while_stop_is_latched():
    context = FakeContext()

    async def act(user, panel):
        found = []
        for latched in (False, True, False):
            panel.show(context.content(state(latched=latched)))
            (enable,) = [each for each in seen(ui.button) if each.text == "Enable"]
            found.append((enable.enabled, enable.props["color"]))
            others = [each.enabled for each in seen(ui.button) if each.text != "Enable"]
            assert others == [True, True]  # to disable is always allowed
        return found

    assert visited(lambda: PowerPanel(context), act) == [(True, "green-8"), (False, "grey-5"), (True, "green-8")]
