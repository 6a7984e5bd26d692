from __future__ import annotations

import math

import pytest
from support.control import Hardware, S, add, manager

from canopen_control.errors import UnknownInterface

TYPE = "battery_state_broadcaster/BatteryStateBroadcaster"


def robot(states, **params):
    """Return hardware with these states, and an active broadcaster."""
    hardware = Hardware("l/velocity", states=tuple(states))
    for name, value in states.items():
        hardware.set(name, value)
    control = manager(hardware)
    broadcaster = add(control, "power", TYPE, **params)
    control.switch(["power"], now=0)
    return hardware, control, broadcaster


def test_a_battery_is_told_with_what_is_read_and_what_is_known_of_it():
    states = {"main/battery_voltage": 24.5, "main/battery_current": -3.0, "main/battery_percentage": 80.0,
              "main/battery_power_supply_status": 2.0, "main/battery_temperature": 31.0}  # fmt: skip
    read = ("battery_current", "battery_percentage", "battery_power_supply_status")
    interfaces = {"main": dict.fromkeys(read, True)}
    _, control, power = robot(
        states, batteries=["main"], interfaces=interfaces, main={"capacity": 40.0, "serial_number": "77"}
    )
    control.broadcast(S, 0.01)
    sample = power.sample(0)
    (main,) = sample.batteries
    assert (sample.time, main.name, main.voltage, main.current, main.percentage) == (1.0, "main", 24.5, -3.0, 0.8)
    assert (main.power_supply_status, main.power_supply_health, main.present) == (2, 0, True)
    assert (main.temperature, main.charge, main.capacity, main.serial_number) == (None, None, 40.0, "77")


def test_without_a_percentage_it_is_that_of_the_voltage_where_its_bounds_are_known():
    hardware, _, power = robot(
        {"a/battery_voltage": 22.5, "b/battery_voltage": 22.5},
        batteries=["a", "b"],
        a={"minimum_voltage": 20.0, "maximum_voltage": 25.0},
    )
    assert [each.percentage for each in power.sample(0).batteries] == [0.5, None]
    hardware.set("a/battery_voltage", math.nan)
    power.update(S, 0.01)
    told = power.sample(0).batteries[0]
    assert (told.voltage, told.percentage, told.present) == (None, None, False)


def test_all_of_them_are_told_as_one():
    states = {"a/battery_voltage": 24.0, "a/battery_charge": 10.0, "a/battery_power_supply_health": 1.0,
              "b/battery_voltage": 26.0, "b/battery_charge": 5.0, "b/battery_power_supply_health": 3.0}  # fmt: skip
    wanted = {"battery_charge": True, "battery_power_supply_health": True}
    _, _, power = robot(
        states,
        batteries=["a", "b"],
        interfaces={"a": wanted, "b": wanted},
        a={"capacity": 40.0, "power_supply_technology": 3, "location": "left"},
        b={"capacity": 20.0, "power_supply_technology": 3, "location": "right"},
    )
    both = power.sample(0).together
    assert (both.voltage, both.charge, both.capacity, both.current) == (25.0, 15.0, 60.0, None)
    assert (both.power_supply_health, both.power_supply_technology, both.location) == (3, 3, "left, right")
    assert both.present


def test_batteries_of_several_kinds_are_of_no_kind_together():
    _, _, power = robot(
        {"a/battery_voltage": 0.0, "b/battery_voltage": math.nan},
        batteries=["a", "b"],
        a={"power_supply_technology": 3},
        b={"power_supply_technology": 2},
    )
    both = power.sample(0).together
    assert (both.power_supply_technology, both.present, both.voltage, both.percentage) == (0, False, 0.0, None)


def test_one_that_says_whether_it_is_there_is_believed():
    _, _, power = robot(
        {"a/battery_voltage": 24.0, "a/battery_present": 0.0},
        batteries=["a"],
        interfaces={"a": {"battery_present": True}},
    )
    assert not power.sample(0).batteries[0].present


def test_the_voltage_must_be_there():
    with pytest.raises(UnknownInterface, match="b/battery_voltage"):
        robot({"a/battery_voltage": 24.0}, batteries=["b"])
