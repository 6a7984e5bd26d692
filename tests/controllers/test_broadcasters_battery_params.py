from __future__ import annotations

import math

import pytest

from canopen_control.controllers.broadcasters import QUANTITIES, read_params
from canopen_control.controllers.params import Params
from canopen_control.errors import RobotConfigError


def read(**params):
    return read_params(Params.of(params), "power")


def test_what_is_read_of_each_battery_and_what_is_known_of_it():
    given = read(
        batteries=["main", "spare"],
        interfaces={"spare": {"battery_current": True, "battery_present": False}},
        main={"capacity": 40.0, "location": "slot 1", "power_supply_technology": 3},
    )
    assert given.names == ("main", "spare")
    assert given.measured("main") == ["main/battery_voltage", *[""] * 7]
    assert [each for each in given.measured("spare") if each] == ["spare/battery_voltage", "spare/battery_current"]
    main, spare = given.own
    assert (main.capacity, main.location, main.power_supply_technology) == (40.0, "slot 1", 3)
    assert math.isnan(spare.capacity)


def test_the_older_spellings_are_taken():
    assert read(state_joints=["main"], main={"capacity": 2.0}).own[0].capacity == 2.0
    one = read(sensor_name="pack", design_capacity=8.0, power_supply_technology=2)
    assert one.measured("pack") == ["pack/voltage", *[""] * (len(QUANTITIES) - 1)]
    assert (one.names, one.own[0].design_capacity, one.own[0].power_supply_technology) == (("pack",), 8.0, 2)


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({}, "no 'batteries'; give it under"),
        ({"batteries": ["a"], "sensor_name": "b"}, "both 'sensor_name' and 'batteries'"),
        ({"batteries": ["a", "a"]}, "batteries names one twice: a, a"),
        ({"batteries": ["a"], "interfaces": {"a": {"battery_curent": True}}}, "interfaces.a.battery_curent, did you"),
        ({"batteries": ["a"], "interfaces": {"b": {"battery_current": True}}}, "interfaces.b.battery_current"),
        ({"batteries": ["a"], "a": {"minimum_voltage": 9.0, "maximum_voltage": 9.0}}, "a: minimum_voltage is 9"),
        ({"batteries": ["a"], "a": {"power_supply_technology": 9}}, "power_supply_technology"),
    ],
)
def test_what_cannot_be_is_told(params, words):
    with pytest.raises(RobotConfigError) as caught:
        read(**params)
    assert words in str(caught.value)
