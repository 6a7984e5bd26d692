import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from nicegui import ui
from support.pages import (
    ARM,
    BASE,
    FORWARD,
    LIFT,
    TARGET,
    FakeContext,
    drive_state,
    expect_seen,
    html,
    seen,
    settle,
    state,
    visited,
)

from canopen_control.rpc.messages.robot import SwitchControllers
from canopen_control.rpc.messages.trajectory import CancelTrajectory
from canopen_control.view.elements.nicegui_elements import HoldButtons
from canopen_control.view.panels.teleop_panel import TeleopPanel

OFF = FORWARD | {"state": "inactive"}


def played(context):
    return visited(lambda: TeleopPanel(context), context)


def hold(user, key):
    user.find(kind=HoldButtons).trigger("hold", key)


async def test_a_base_is_driven_by_a_pad_at_the_speeds_of_its_sliders():
    context = FakeContext(controllers=(BASE | {"state": "active"},))
    async with played(context) as (user, _panel):
        linear, angular = seen(ui.slider)
        linear.value, angular.value = 0.5, 1.5
        for key in ("forward", "left", "back", "right"):
            hold(user, key)
        user.find(kind=HoldButtons).trigger("release")
    assert [(item.moving.linear, item.moving.angular) for item in context.held] == [
        (0.5, 0.0), (0.0, 1.5), (-0.5, 0.0), (0.0, -1.5),
    ]  # fmt: skip
    assert all(item.resting.linear == item.resting.angular == 0.0 for item in context.held)
    assert context.let == 2  # once when it was built


async def test_a_base_that_drives_sideways_has_two_more_buttons():
    base = BASE | {"state": "active", "topic": "reference", "twist_axes": ["linear.x", "linear.y", "angular.z"]}
    context = FakeContext(controllers=(base,))
    async with played(context) as (user, _panel):
        linear, _ = seen(ui.slider)
        linear.value = 0.5
        for key in ("slide_left", "slide_right", "forward"):
            hold(user, key)
    assert [(item.moving.linear, item.moving.lateral, item.moving.angular) for item in context.held] == [
        (0.0, 0.5, 0.0), (0.0, -0.5, 0.0), (0.5, 0.0, 0.0),
    ]  # fmt: skip
    assert all(item.resting.lateral == 0.0 for item in context.held)


async def test_joints_are_driven_by_what_their_sliders_report_and_rest_at_zero():
    context = FakeContext()
    async with played(context) as (user, _panel):
        seen(ui.slider)[0].value = 3.0
        hold(user, "drive")
    assert context.held[0].moving.values == [3.0]
    assert context.held[0].resting.values == [0.0]


async def test_a_position_begins_where_the_joint_is_within_its_limits_and_rests_there():
    context = FakeContext(controllers=(LIFT,))
    async with played(context) as (user, _panel):
        slider = seen(ui.slider)[0]
        assert (slider.props["min"], slider.props["max"], slider.value) == (0.0, 0.5, 0.1)
        hold(user, "drive")
        user.find(kind=ui.slider).trigger("update:modelValue", 0.4)
        hold(user, "drive")
    assert [item.moving.values for item in context.held] == [[0.1], [0.4]]
    assert context.held[1].resting.values == [0.1]


async def test_a_position_slider_follows_its_joint():
    context = FakeContext(controllers=(LIFT,))
    async with played(context) as (_user, panel):
        joints = {"lift": {"position": 0.3}}
        panel.show(context.content(state(joints=joints)))
        assert seen(ui.slider)[0].value == 0.3


async def test_the_controller_is_chosen_and_a_refusal_reported():
    context = FakeContext(controllers=(FORWARD, BASE))
    context.refusal = "the joint is claimed"
    async with played(context) as (user, _panel):
        seen(ui.select)[0].value = "base"
        await settle(lambda: context.asked)
        await expect_seen(user, "the joint is claimed")
    assert context.asked == [SwitchControllers(activate=("base",), deactivate=("forward",))]


@pytest.mark.rest
@pytest.mark.parametrize(
    ("how", "words"),
    [({"controllers": (OFF,)}, "forward accepts commands, but is not active"), ({"teleop": False}, "--teleop")],
    ids=["no active controller", "no teleop"],
)
async def test_without_an_active_controller_or_teleop_nothing_can_be_driven(how, words):
    async with played(FakeContext(**how)) as (user, _panel):
        assert words in html(user)
        assert seen(HoldButtons) == []


@pytest.mark.rest
@pytest.mark.parametrize(("controllers", "visible"), [((TARGET,), False), ((TARGET, FORWARD), True), ((OFF,), True)])
async def test_where_drives_take_targets_by_themselves_it_leaves_the_page_to_them(controllers, visible):
    async with played(FakeContext(controllers=controllers)) as (_user, panel):
        assert panel._frame.visible is visible


async def test_while_the_drives_are_disabled_the_buttons_are_not_shown_as_ready():
    context = FakeContext()
    async with played(context) as (_user, panel):
        ready = "cc-off" in panel._whole._classes
        panel.show(context.content(drive_state({"cia402_state": "SWITCH_ON_DISABLED"})))
        assert (ready, "cc-off" in panel._whole._classes) == (False, True)


async def test_a_client_without_control_is_notified():
    context = FakeContext()
    context.refusal = "another page drives"
    async with played(context) as (user, _panel):
        hold(user, "drive")
        await expect_seen(user, "another page drives")


async def test_an_arm_has_a_slider_for_each_joint_and_goes_there_while_its_button_is_held():
    context = FakeContext(controllers=(ARM,))
    async with played(context) as (user, _panel):
        _left, lift, share = seen(ui.slider)
        assert (lift.props["min"], lift.props["max"], lift.value) == (0.0, 0.5, 0.1)
        hold(user, "drive")
        user.find(kind=ui.slider).trigger("update:modelValue", 0.4)
        share.value = 50.0
        hold(user, "drive")
        hold(user, "drive")
    stays, goes, again = context.held
    assert goes == again  # the same direction continues: nothing is planned again
    assert stays.moving.points[0].positions == [1.0, 0.1]
    (point,) = goes.moving.points
    assert (goes.moving.controller, goes.moving.joints) == ("arm", ["left", "lift"])
    assert (point.positions, point.velocities) == ([0.4, 0.4], [0.0, 0.0])
    assert point.time_from_start == pytest.approx(1.5 * 0.3 / (0.5 * 0.2))  # half of the lift's limit, 0.2 m/s
    assert goes.resting == CancelTrajectory(controller="arm", own=True, why="the page released its button")


async def test_an_arm_of_which_a_joint_is_unknown_is_not_moved():
    unknown = {"left": {"position": None, "velocity": None, "effort": None, "command": None}}
    context = FakeContext(controllers=(ARM,), joints=unknown)
    async with played(context) as (user, _panel):
        hold(user, "drive")
    assert context.held == []


@pytest.mark.rest
async def test_without_any_controller_that_takes_commands_the_page_reports_this():
    async with played(FakeContext(controllers=())) as (user, _panel):
        assert "No active controller accepts commands" in html(user)
    async with played(FakeContext(controllers=(ARM,))) as (user, _panel):
        assert "No active controller" not in html(user)
