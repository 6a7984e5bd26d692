from __future__ import annotations

from canopen_control.controllers.base import ALL_STATES, Controller, StateCopy
from canopen_control.controllers.params import Params
from canopen_control.hardware.interfaces import ReturnType, StateInterface


def test_a_copy_is_of_the_moment_it_was_taken_and_keeps_its_layout():
    turn, heat = StateInterface("a", "angle", 1.0), StateInterface("a", "temperature")
    copy = StateCopy({"b": {"position": None}, "a": {"position": turn, "temperature": heat}, "empty": {}})
    first = {"b": {"position": 0.0}, "a": {"position": 1.0, "temperature": None}, "empty": {}}
    assert copy.by_joint() == first
    assert [*copy.by_joint()] == copy.joints == ["b", "a", "empty"]
    turn.value, heat.value = 2.0, 41.5
    assert copy.by_joint() == first
    copy.refresh()
    assert copy.by_joint()["a"] == {"position": 2.0, "temperature": 41.5}


def test_the_least_controller_claims_nothing_and_does_nothing():
    idle = Controller("idle")
    idle.on_configure(Params.of({"update_rate": 5, "use_sim_time": True}))
    assert (idle.command_interface_names(), idle.state_interface_names(), idle.update_rate) == ([], [], 5)
    assert idle.update(0, 0.01) is ReturnType.OK
    assert idle.reference_interfaces() == ()
    assert (idle.sample_type, idle.sample(0), idle.wheel_base()) == (None, None, None)
    idle.stamp = 250_000_000
    assert idle.published(1_000_000_000) == 1.25
    assert ALL_STATES == "*"


def test_parameters_that_change_nothing_are_reported_unless_they_are_what_is_done_anyway():
    for inputs in ({"is_async": False, "thread_priority": 50}, {"use_sim_time": True}):
        params = Params.of(inputs, "idle")
        Controller("idle").on_configure(params)
        assert params.warnings == []
    params = Params.of({"is_async": True, "thread_priority": 80}, "idle")
    Controller("idle").on_configure(params)
    assert [warning.split(";")[0] for warning in params.warnings] == [
        "idle: is_async: is_async has no effect: all controllers run in the cycle, in one thread",
        "idle: thread_priority: thread_priority has no effect: all controllers run in the cycle",
    ]
