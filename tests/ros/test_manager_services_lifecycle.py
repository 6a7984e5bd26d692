from __future__ import annotations

import pytest

pytestmark = pytest.mark.ros
NODES = [{"name": "left_drive", "node_id": 3, "driver": "ros2_canopen::LifecycleCia402Driver"}]
CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE, SHUTDOWN = 1, 2, 3, 4, 7


@pytest.fixture
def call(fresh, maker):
    def call(path, service, kind, **data):
        return maker.order("call", service=f"{path}/{service}", of=f"lifecycle_msgs/srv/{kind}", data=data)["response"]

    return call


@pytest.fixture(params=["/lifecycle_manager", "/master", "/left_drive"])
def change(request, call):
    def change(number=0, label=""):
        expected = {"id": number, "label": label}
        return call(request.param, "change_state", "ChangeState", transition=expected)["success"]

    change.path = request.param
    change.state = lambda: call(request.param, "get_state", "GetState")["current_state"]["label"]
    yield change
    for number in (DEACTIVATE, CLEANUP):
        change(number)


def test_it_comes_up_and_goes_down_twice_as_ros2_canopens_own_test_does(fresh, change):
    for _ in range(2):
        assert change(CONFIGURE)
        assert change.state() == "inactive"
        assert change(ACTIVATE)
        assert change.state() == "active"
        assert change(DEACTIVATE)
        assert change(CLEANUP)
        assert change.state() == "unconfigured"


def test_deactivating_stops_and_disables(fresh, change):
    assert change(CONFIGURE)
    assert change(ACTIVATE)
    assert change(label="deactivate")
    if change.path != "/left_drive":
        assert len(fresh.robot.commands("stop")) == 1
    else:
        assert fresh.robot.commands("axis") == [{"action": "disable", "node": "left_drive", "source": "ros"}]


def test_a_state_that_is_reached_is_not_an_error_and_an_impossible_one_is(fresh, change):
    assert not change(ACTIVATE)
    assert not change(99)
    assert change(CONFIGURE)
    assert change(CONFIGURE)
    assert change.state() == "inactive"


def test_it_is_not_active_while_a_node_is_not_ready(fresh, change):
    node = fresh.robot.nodes["left_drive"]
    node["ready"] = False
    try:
        assert change(CONFIGURE)
        for _ in range(100):
            if not change(ACTIVATE):
                break
            change(DEACTIVATE)  # the sample before
        assert change.state() == "inactive"
    finally:
        node["ready"] = True
