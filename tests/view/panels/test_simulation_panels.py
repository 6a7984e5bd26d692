import contextlib

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from nicegui import ui
from support.pages import FakeContext, at_rest, expect_seen, seen, settle, visited

from canopen_control.errors import RemoteError
from canopen_control.rpc.messages.drive import AddPayload, BlockJoint, PushRobot, SetGrip
from canopen_control.rpc.messages.robot import PublishEvent
from canopen_control.view.page_content import DriveFaults
from canopen_control.view.panels.simulation_panels import WorldPanel


class World:
    def __init__(self, *, changeable=True, refusal=""):
        self._changeable, self._refusal, self.acts = changeable, refusal, []

    def changeable(self):
        return self._changeable

    def act(self, what):
        if self._refusal:
            raise RemoteError("ConfigError", self._refusal)
        self.acts.append(what)


@contextlib.asynccontextmanager
async def played(world):
    context = FakeContext().with_faults()
    context.robot.world_client = world

    async with visited(lambda: WorldPanel(context), context) as (user, panel):
        await at_rest()
        for whole in seen(ui.expansion):
            whole.open()
        yield user, panel, context


def field(label):
    return next(item for item in seen(ui.number) if item.props["label"] == label)


async def test_what_a_person_asks_for_happens_and_is_in_the_events():
    world = World()
    async with played(world) as (user, _panel, context):
        link = seen(ui.select)[0]
        link.value = "fork"
        field("kg").value = -2
        for number, button in enumerate(("Add payload", "Push", "Block", "Release", "Set floor friction"), 1):
            user.find(button).click()
            await settle(lambda number=number: len(world.acts) == len(context.asked) == number)
            link.value = "the heaviest link"
    assert world.acts == [
        AddPayload(mass=-2.0, on="fork"),
        PushRobot(force=(0.0, 30.0, 0.0), seconds=0.2),
        BlockJoint(joint="left"),
        BlockJoint(joint="left", on=False),
        SetGrip(friction=0.2),
    ]
    assert PublishEvent(kind="world", text="from a page: payload of -2 kg on fork") in context.asked
    assert len(context.asked) == 5


@pytest.mark.parametrize(
    ("label", "value", "button", "text"),
    [
        ("s", 0, "Push", "a push needs a duration above 0"),
        ("friction", -1, "Set floor friction", "friction cannot be negative"),
        ("kg", None, "Add payload", "a field is empty"),
        ("y, N", None, "Push", "a field is empty"),
    ],
)
async def test_a_number_that_cannot_be_is_reported_and_nothing_happens(label, value, button, text):
    world = World()
    async with played(world) as (user, _panel, context):
        field(label).value = value
        user.find(button).click()
        await expect_seen(user, text)
    assert world.acts == context.asked == []


async def test_what_the_world_refuses_is_reported():
    async with played(World(refusal="the robot has no link 'fork'")) as (user, _panel, context):
        user.find("Add payload").click()
        await expect_seen(user, "the robot has no link")
    assert context.asked == []


async def test_nothing_is_offered_without_physics_and_it_is_looked_for_again_with_other_drives():
    world = World(changeable=False)
    async with played(world) as (_user, panel, context):
        before = len(seen(ui.expansion))
        world._changeable = True
        panel.show(context.content())  # the same drives, so no new request
        await at_rest()
        same = len(seen(ui.expansion))
        context.robot.faults = DriveFaults({"another": ()})
        panel.show(context.content())
        await settle(lambda: bool(seen(ui.expansion)))
        assert (before, same, len(seen(ui.expansion))) == (0, 0, 1)
