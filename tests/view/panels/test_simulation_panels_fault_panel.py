import contextlib

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from nicegui import ui
from support.pages import FakeContext, at_rest, expect_seen, html, seen, visited

from canopen_control.errors import RemoteError
from canopen_control.rpc.messages.drive import FaultListing, QuirkListing
from canopen_control.view.page_content import DriveFaults
from canopen_control.view.panels.simulation_panels import FaultPanel


@contextlib.asynccontextmanager
async def played(ask=None):
    context = FakeContext().with_faults()
    switched = []
    context.robot.drives.ask = ask or (lambda drive, request: switched.append((drive, request.name, request.on)))

    async with visited(lambda: FaultPanel(context), context) as (user, _panel):
        yield user, switched


async def test_drives_and_faults_are_offered_and_what_is_on_is_reported():
    async with played() as (user, _switched):
        drive, fault = seen(ui.select)
        assert (drive.value, fault.value, fault.options) == ("left_drive", "silent", ["silent", "hot"])
        fault.value = "hot"
        result = html(user)
    assert "left_drive: silent" in result
    assert "The drive is hot (once)" in result


async def test_a_fault_is_switched():
    async with played() as (user, switched):
        user.find("Switch off").click()
        user.find("Switch on").click()
        await at_rest()
    assert sorted(switched) == [("left_drive", "silent", False), ("left_drive", "silent", True)]


async def test_what_the_drive_refuses_is_reported():
    def refuse(*_args, **_how):
        raise RemoteError("DriveError", "not while it moves")

    async with played(refuse) as (user, _switched):
        user.find("Switch on").click()
        await expect_seen(user, "not while it moves")


async def test_inputs_are_set_where_a_device_has_some():
    inputs = []
    context = FakeContext().with_faults()
    board = context.content().faults
    module = (*board.drives["left_drive"], FaultListing(name="input_stuck", acts="input"))
    context.robot.faults = DriveFaults({"io": module, **board.drives})
    context.robot.drives.ask = lambda drive, request: inputs.append((drive, request.values))
    async with visited(lambda: FaultPanel(context)) as (user, panel):
        panel.show(context.content())
        drive = seen(ui.select)[0]
        await expect_seen(user, "inputs, as di0=1,ai0=16384")
        user.find(ui.input).type("di0=1,ai0=2.5")
        user.find("Set").click()
        await at_rest()
        user.find(ui.input).clear().type("di0")
        user.find("Set").click()
        await expect_seen(user, "write SIGNAL=NUMBER")
        drive.value = "left_drive"
        await user.should_not_see("inputs, as di0=1,ai0=16384")
    assert inputs == [("io", {"di0": 1.0, "ai0": 2.5})]


async def test_on_mock_hardware_nothing_is_offered_to_be_broken():
    context = FakeContext()
    async with visited(lambda: FaultPanel(context)) as (_user, panel):
        results = []
        for board in (DriveFaults(), context.with_faults().robot.faults, DriveFaults()):
            context.robot.faults = board
            panel.show(context.content())
            results.append(panel._whole.visible)
        assert results == [False, True, False]


async def test_a_quirk_is_explained_and_switched_with_its_strength():
    switched = []
    context = FakeContext().with_faults()
    late = QuirkListing(
        name="brake_delay", does="follows late", clause="CiA 402-2, 6.3", source="jsd#48", acts="axis",
        unit="s", default=0.5, low=0.001, high=60.0, on=["brake_delay=0.5"],
    )  # fmt: skip
    board = context.content().faults
    context.robot.faults = DriveFaults(board.drives, {"left_drive": (late,)})
    context.robot.drives.ask = lambda drive, request: switched.append((drive, request.quirk, request.on))
    async with visited(lambda: FaultPanel(context)) as (user, panel):
        panel.show(context.content())
        for text in ("", "1.5", "@0", "=2@0"):
            panel._strength.value = text
            user.find("Quirk on").click()
            await at_rest()
        user.find("Quirk off").click()
        await at_rest()
        result = html(user)
    assert "The drive follows late." in result
    assert "jsd#48" in result
    assert "left_drive: silent, brake_delay=0.5" in result
    names = ["brake_delay", "brake_delay=1.5", "brake_delay@0", "brake_delay=2@0"]
    assert switched == [*(("left_drive", name, True) for name in names), ("left_drive", "brake_delay", False)]
