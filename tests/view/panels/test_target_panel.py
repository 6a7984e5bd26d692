import pytest
from nicegui import ui
from support.pages import AXIS, NODE, TARGET, FakeContext, drive_state, expect_seen, html, seen, settle, state, visited

from canopen_control.rpc.messages.robot import AxisRequest
from canopen_control.view.elements.nicegui_elements import HoldButtons
from canopen_control.view.panels.target_panel import PowerPanel, TargetPanel

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")


async def pressed(label, refusal=None, **status):
    context = FakeContext(**status)
    context.refusal = refusal

    async with visited(lambda: PowerPanel(context)) as (user, _panel):
        user.find(label).click()
        await settle(lambda: context.asked)
        if refusal:
            await expect_seen(user, refusal)
    return context.asked


@pytest.mark.parametrize(("label", "action"), [("Disable", "disable"), ("Reset fault", "fault-reset")])
async def test_a_button_asks_for_its_action(label, action):
    assert await pressed(label) == [AxisRequest(action=action, node="left_drive", source="view")]


async def test_several_drives_have_a_row_for_all():
    axes = [AXIS | {"joint": "lift"}]
    context = FakeContext(nodes={"left_drive": NODE, "lift_drive": NODE | {"axes": axes}})
    async with visited(lambda: PowerPanel(context)) as (_user, _panel):
        assert [button.text for button in seen(ui.button)].count("Disable") == 3
        assert [label.text for label in seen(ui.label)] == ["all drives", "left_drive", "lift_drive"]


async def test_what_is_refused_is_reported():
    assert len(await pressed("Disable", "the drive does not answer")) == 1


async def test_without_drives_there_is_nothing_to_enable():
    context = FakeContext(nodes={})
    async with visited(lambda: PowerPanel(context)) as (user, _panel):
        assert "No drives" in html(user)


async def test_enable_is_grey_and_closed_while_stop_is_latched():
    context = FakeContext()
    async with visited(lambda: PowerPanel(context)) as (_user, panel):
        results = []
        for latched in (False, True, False):
            panel.show(context.content(state(latched=latched)))
            (enable,) = [item for item in seen(ui.button) if item.text == "Enable"]
            results.append((enable.enabled, enable.props["color"]))
            others = [item.enabled for item in seen(ui.button) if item.text != "Enable"]
            assert others == [True, True]  # to disable is always allowed
        assert results == [(True, "green-8"), (False, "grey-5"), (True, "green-8")]


def played(context):
    return visited(lambda: TargetPanel(context), context)


def hold(user):
    user.find(kind=HoldButtons).trigger("hold", "target")


def of_drive(axis=None, **how):
    context = FakeContext(controllers=(TARGET,), **how)
    context.content(drive_state(axis))
    return context


async def test_a_velocity_is_given_while_the_button_is_held_and_rests_at_zero():
    context = of_drive()
    async with played(context) as (user, _panel):
        seen(ui.slider)[0].value = 2.5
        hold(user)
    (motion,) = context.held
    assert (motion.moving.controller, motion.moving.values, motion.moving.interface) == ("left", [2.5], "velocity")
    assert (motion.resting.values, motion.moving.dead_man) == ([0.0], True)


async def test_a_position_begins_where_the_drive_is_and_rests_there():
    context = of_drive({"mode": "PP"})
    async with played(context) as (user, _panel):
        began = seen(ui.slider)[0].value
        seen(ui.slider)[0].value = -1.5
        hold(user)
        assert began == 1.0
    (motion,) = context.held
    assert (motion.moving.values, motion.resting.values, motion.moving.interface) == ([-1.5], [1.0], "position")


async def test_nothing_is_sent_while_the_position_of_the_drive_is_unknown():
    context = of_drive({"mode": "PP"})
    context.robot.state.joints.clear()
    async with played(context) as (user, _panel):
        hold(user)
    assert context.held == []


async def test_another_mode_makes_another_target_and_ends_what_is_driven():
    context = of_drive()
    async with played(context) as (user, panel):
        let = context.let
        panel.show(context.content(drive_state({"mode": "HM"})))
        let, buttons, text = context.let - let, seen(HoldButtons), html(user)
    assert (let, buttons) == (1, [])
    assert "choose another mode" in text


async def test_the_end_of_the_slider_is_chosen():
    async with played(of_drive()) as (_user, _panel):
        slider, most = seen(ui.slider)[0], seen(ui.number)[0]
        slider.value = 9.0
        most.value = 4.0
        shorter = slider.props["min"], slider.props["max"], slider.value
        most.value = -1.0
        assert (shorter, slider.props["max"]) == (("-4.0", "4.0", 4.0), "4.0")


@pytest.mark.parametrize(("label", "action"), [("Enable left", "enable"), ("Stop left", "disable")])
async def test_each_drive_is_enabled_and_stopped_by_itself_and_a_refusal_is_reported(label, action):
    context = of_drive()
    context.refusal = "no RPDO carries its target"
    async with played(context) as (user, _panel):
        (button,) = [item for item in seen(ui.button) if item.props.get("aria-label") == label]
        user.find(button.text).click()
        await settle(lambda: context.asked)
        await expect_seen(user, "no RPDO carries its target")
    assert context.asked == [AxisRequest(action=action, node="left_drive", joint="left", source="view")]


async def test_a_mode_is_asked_for_and_that_of_the_drive_is_shown():
    context = of_drive()
    async with played(context) as (_user, _panel):
        select = seen(ui.select)[0]
        shown = select.value
        select.value = "CSP"
        await settle(lambda: context.asked)
        assert shown == "PV"
    assert context.asked == [AxisRequest(action="mode", node="left_drive", joint="left", mode="CSP", source="view")]


async def test_a_read_only_page_may_stop_and_nothing_else():
    async with played(of_drive(teleop=False)) as (user, _panel):
        able = {item.text: item.enabled for item in seen(ui.button)}
        buttons, choice, message = seen(HoldButtons), seen(ui.select)[0].enabled, html(user)
    assert able == {"Enable": False, "Stop": True}
    assert (buttons, choice) == ([], False)
    assert "--teleop" in message


async def test_a_disabled_drive_is_not_shown_as_ready_and_a_robot_without_such_drives_has_no_panel():
    context = of_drive({"cia402_state": "SWITCH_ON_DISABLED"})
    async with played(context) as (_user, panel):
        off = "cc-off" in panel._rows["left"]._body._classes
        context.robot.controllers = ()
        panel.show(context.content())
        assert (off, panel._rows, panel._frame.visible) == (True, {}, False)
