"""Timeout of commands, for every kind of controller."""

from __future__ import annotations

import math

import pytest
from support.control import DIFF_DRIVE, FORWARD, Hardware, S, add, manager

from canopen_control.controllers.command_timeout import CommandSender, SenderWatch, timeout_ns
from canopen_control.errors import NotEnabled

WHEELS = ["left", "right"]
BASE = {
    "left_wheel_names": ["left"],
    "right_wheel_names": ["right"],
    "wheel_separation": 0.4,
    "wheel_radius": 0.1,
    "open_loop": True,
}


@pytest.mark.parametrize(
    ("timeout", "interfaces", "expected"),
    [
        (None, ["velocity"], 2 * S),
        (None, ["effort"], 2 * S),
        (None, ["position"], 0),
        (None, ["position", "velocity"], 2 * S),
        (None, ["digital_outputs"], 0),
        (0.0, ["velocity"], 0),
        (0.5, ["velocity"], S // 2),
        (0.5, ["position"], S // 2),
    ],
)
def test_what_moves_has_an_end_and_what_stands_has_none(timeout, interfaces, expected):
    assert timeout_ns(timeout, interfaces) == expected


def forward(interface: str = "velocity", **params):
    hardware = Hardware(*(f"{joint}/{interface}" for joint in WHEELS))
    control = manager(hardware)
    add(control, "forward", FORWARD, joints=WHEELS, interface_name=interface, **params)
    control.switch(["forward"], now=0)
    return hardware, control


def base(**params):
    hardware = Hardware(*(f"{joint}/velocity" for joint in WHEELS))
    control = manager(hardware)
    add(control, "base", DIFF_DRIVE, **{**BASE, **params})
    control.switch(["base"], now=0)
    return hardware, control


@pytest.mark.parametrize("interface", ["velocity", "effort"])
def test_without_a_time_out_in_the_yaml_a_velocity_or_effort_ends_after_two_seconds(interface):
    hardware, control = forward(interface)
    control.command("forward", [10.0, 10.0], 0)
    control.update(2 * S, 0.01)
    assert hardware.values() == [10.0, 10.0]
    control.update(2 * S + 1, 0.01)
    assert hardware.values() == [0.0, 0.0]
    assert [event.kind for event in control.events()][-1] == "command_timeout"


def test_zero_is_for_ever_and_reported_once():
    hardware, control = forward(command_timeout=0.0)
    control.command("forward", [10.0, 10.0], 0)
    control.update(10**6 * S, 0.01)
    assert hardware.values() == [10.0, 10.0]
    assert [event.kind for event in control.events()].count("endless_command") == 1


@pytest.mark.parametrize("make", [forward, base])
def test_a_command_to_drives_that_are_off_is_refused_counted_and_reported_once(make):
    hardware, control = make()
    name = control.active[0]
    hardware.command_interfaces[1].enabled = False
    control.events()
    for _ in range(3):
        with pytest.raises(NotEnabled, match="right"):
            control.command(name, [1.0, 1.0], S, source="me")
    assert control.get(name).rejected == 3
    assert [event.text for event in control.events()] == [
        "right: not enabled, so commands are refused (from me; reported once)"
    ]
    hardware.command_interfaces[1].enabled = True
    control.update(2 * S, 0.01)
    assert all(value == 0.0 or math.isnan(value) for value in hardware.values())
    control.command(name, [1.0, 1.0], 2 * S)
    control.update(2 * S, 0.01)
    assert all(value > 0.0 for value in hardware.values())


@pytest.mark.parametrize("make", [forward, base])
def test_what_was_commanded_before_a_drive_was_off_is_discarded(make):
    hardware, control = make()
    name = control.active[0]
    control.command(name, [1.0, 1.0], 0)
    control.update(0, 0.01)
    assert hardware.values()[0] > 0.0
    hardware.command_interfaces[0].enabled = False
    control.update(1, 0.01)
    assert hardware.values() == [0.0, 0.0]
    hardware.command_interfaces[0].enabled = True
    for now in range(2, 5):
        control.update(now, 0.01)
        assert hardware.values() == [0.0, 0.0]


def test_a_position_from_before_is_discarded_too():
    hardware, control = forward("position")
    control.command("forward", [1.0, 2.0], 0)
    control.update(0, 0.01)
    hardware.command_interfaces[0].enabled = False
    control.update(1, 0.01)
    hardware.command_interfaces[0].enabled = True
    control.update(2, 0.01)
    assert all(math.isnan(value) for value in hardware.values())


def test_the_odometry_continues_after_what_was_commanded_is_discarded():
    hardware, control = base(cmd_vel_timeout=0.0)
    control.command("base", [1.0, 0.0], 0)
    control.update(0, 0.01)
    control.running.forget(1, "a test")
    before = control.get("base").publications
    for now in range(1, 4):
        control.update(now * S, 1.0)
    assert control.get("base").publications > before
    assert hardware.values() == [0.0, 0.0]


@pytest.mark.parametrize("make", [forward, base])
def test_a_command_ends_with_the_client_that_holds_it(make):
    hardware, control = make()
    name, mine, yours = control.active[0], object(), object()
    control.command(name, [1.0, 1.0], 0, source="ros", holder=mine)
    control.update(0, 0.01)
    control.running.client_disconnected(yours)
    assert hardware.values()[0] > 0.0
    control.events()
    control.running.client_disconnected(mine)
    assert hardware.values() == [0.0, 0.0]
    assert [event.kind for event in control.events()] == ["commander_gone"]
    control.running.client_disconnected(mine)
    assert not control.events()


def test_two_of_the_same_name_are_two():
    """Whose connection it is counts, not what he calls himself."""
    hardware, control = forward()
    first, second = object(), object()
    control.command("forward", [1.0, 1.0], 0, source="command", holder=first)
    control.command("forward", [2.0, 2.0], 0, source="command", holder=second)
    control.update(0, 0.01)
    control.running.client_disconnected(first)
    assert hardware.values() == [2.0, 2.0]


def test_a_client_of_a_chain_needs_the_drives_at_its_end():
    hardware, control = base()
    add(control, "upper", FORWARD, joints=["base/linear", "base/angular"], interface_name="velocity")
    control.switch(["upper"], now=0)
    control.command("upper", [1.0, 0.0], 0)
    control.update(0, 0.01)
    control.update(1, 0.01)
    assert hardware.values() == [10.0, 10.0]
    hardware.command_interfaces[0].enabled = False
    control.update(2, 0.01)
    assert hardware.values() == [0.0, 0.0]
    with pytest.raises(NotEnabled):
        control.command("upper", [1.0, 0.0], 3)
    hardware.command_interfaces[0].enabled = True
    control.update(4, 0.01)
    control.update(5, 0.01)
    assert hardware.values() == [0.0, 0.0]


@pytest.mark.parametrize("make", [forward, base])
def test_a_client_that_sent_standstill_may_leave_without_an_event(make):
    """A base that brakes along its ramp goes on braking, without a word."""
    hardware, control = make(**({} if make is forward else {"linear.x.max_acceleration": 1.0}))
    name, holder = control.active[0], object()
    control.command(name, [1.0, 1.0], 0, holder=holder)
    for now in range(0, S // 2, S // 10):
        control.update(now, 0.1)
    control.command(name, [0.0, 0.0], S // 2, holder=holder)
    control.events()
    control.running.client_disconnected(holder)
    before = hardware.values()[1]
    assert before > 0.0
    control.update(S // 2, 0.1)
    assert (hardware.values()[1] > 0.0) is (make is base)
    assert hardware.values()[1] < before
    assert not control.events()


ONE, OTHER, THIRD = (CommandSender(object(), name) for name in ("one (pid 1)", "other (pid 2)", "third (pid 3)"))


def alternations(*takes):
    """Return what is reported for senders and their times in s."""
    watch = SenderWatch()
    reports = [watch.take(sender, round(seconds * S)) for sender, seconds in takes]
    return [report for report in reports if report is not None]


def test_two_senders_that_alternate_are_reported_once_with_both_names():
    turns = [((ONE, OTHER)[turn % 2], 1 + turn * 0.05) for turn in range(200)]
    assert alternations(*turns) == [("one (pid 1)", "other (pid 2)")]


def test_three_senders_that_alternate_are_reported_once():
    turns = [((ONE, OTHER, THIRD)[turn % 3], 1 + turn * 0.05) for turn in range(200)]
    assert len(alternations(*turns)) == 1


@pytest.mark.parametrize(
    "takes",
    [
        [(ONE, 1 + turn / 10) for turn in range(100)],
        [(ONE, 1), (OTHER, 1.1), (OTHER, 1.2), (ONE, 1.3), (ONE, 1.4)],  # one interruption
        [(ONE, 1), (OTHER, 3.5), (ONE, 6), (OTHER, 8.5), (ONE, 11)],  # each when the command before has ended
        [(CommandSender(object(), "command"), 1 + turn / 10) for turn in range(100)],  # a script that starts many
    ],
)
def test_a_sender_that_takes_over_is_normal(takes):
    assert alternations(*takes) == []


def test_an_alternation_after_a_quiet_time_is_reported_again():
    turns = [((ONE, OTHER)[turn % 2], start + turn * 0.1) for start in (1, 15) for turn in range(10)]
    assert len(alternations(*turns)) == 2
    turns = [((ONE, OTHER)[turn % 2], start + turn * 0.1) for start in (1, 8) for turn in range(10)]
    assert len(alternations(*turns)) == 1


def test_clients_that_command_a_controller_alternately_are_reported_and_the_newer_command_applies():
    hardware, control = forward()
    control.events()
    for turn in range(20):
        source, value = ("teleop", 1.0) if turn % 2 else ("command", 2.0)
        control.command("forward", [value, value], turn * S // 10, source=source)
        control.update(turn * S // 10, 0.01)
        assert hardware.values() == [value, value]
    (event,) = control.events()
    assert (event.kind, event.controller) == ("two_senders", "forward")
    assert event.text == (
        "forward: command and teleop command it alternately, so its motion jerks; each newer command applies; "
        "end one of the two"
    )
