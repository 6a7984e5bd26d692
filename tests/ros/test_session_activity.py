"""The states of controllers and hardware, as a program hears them that comes when everything has been said."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.ros
TOPIC, TYPE = "/controller_manager/activity", "controller_manager_msgs/msg/ControllerManagerActivity"


def hardware(state):
    rest = {"type": "system", "plugin": "p", "rate": 50, "command_interfaces": [], "state_interfaces": []}
    return [{"name": "robby", "state": state, **rest}]


@pytest.fixture
def heard(fresh, maker):
    fresh.robot.answers = {**fresh.robot.answers, "hardware": hardware("active")}
    maker.order("subscribe", topic=TOPIC, of=TYPE, qos="latched")
    yield lambda wanted: maker.message(TOPIC, wanted)
    maker.order("unsubscribe", topic=TOPIC)


def states(named):
    return {each["name"]: (each["state"]["id"], each["state"]["label"]) for each in named}


def test_it_is_there_for_who_comes_late_and_changes_with_controllers_and_hardware(fresh, heard):
    first = heard(lambda message: True)
    assert states(first["controllers"])["forward"] == (3, "active")
    assert states(first["controllers"])["base"] == (2, "inactive")
    fresh.robot.switch(forward="inactive")
    heard(lambda message: states(message["controllers"])["forward"] == (2, "inactive"))
    fresh.robot.switch(forward="active")
    fresh.robot.answers["hardware"] = hardware("unconfigured")
    fresh.robot.event(time=12.5, kind="error", node=None, level="error", text="the hardware has failed")
    failed = heard(lambda message: states(message["hardware_components"]) == {"robby": (1, "unconfigured")})
    assert failed["header"]["stamp"] == {"sec": 1_700_000_000, "nanosec": 250_000_000}
    assert states(failed["controllers"])["forward"] == (3, "active")
