"""`/NODE/*` services: names and answers of ros2_canopen, and stop services that never wait."""

from __future__ import annotations

import math

import pytest
from support import ros

from canopen_control.ros.drive_services import TRIGGERS
from canopen_control.rpc.messages.robot import ROBOT
from canopen_control.rpc.wire import plain

pytestmark = pytest.mark.ros
NODES = [
    {"name": "left_drive", "node_id": 3},
    {"name": "right_drive", "node_id": 2, "namespace": "/test1", "remappings": {"~/init": "/start"}},
]
NODES.append({"name": "odd", "node_id": 9, "remappings": {"~/init": "/no name"}})  # it has none, the others have
NODES.append({"name": "terminals", "node_id": 7})
NODES.append({"name": "arm", "node_id": 5, "channel_names": ["shoulder"]})
NODE_STATES = {"arm": {**ros.node(5, "left"), "axes": [{"joint": "left", "axis": 0}, {"joint": "right", "axis": 1}]}}
TRIGGER, TARGET = "std_srvs/srv/Trigger", "canopen_interfaces/srv/COTargetDouble"


@pytest.fixture
def call(fresh, maker):
    def call(service, of=TRIGGER, **data):
        return maker.order("call", service=service, of=of, data=data)["response"]

    return call


@pytest.mark.parametrize("name", TRIGGERS)
def test_a_trigger_that_is_done_answers_with_an_empty_message(fresh, call, name):
    assert call(f"/left_drive/{name}") == {"success": True, "message": ""}
    request = TRIGGERS[name]("left_drive", None)
    text = {key: value for key, value in plain(request).items() if value is not None}
    assert fresh.robot.commands(ROBOT.of(type(request)).name) == [text]


def test_each_axis_of_a_node_with_several_is_commanded_alone_below_its_channel(fresh, call):
    for service in ("/shoulder/halt", "/arm/right/init", "/arm/right/velocity_mode", "/arm/disable"):
        assert call(service)["success"], service
    assert fresh.robot.commands("axis") == [
        {"node": "arm", "action": "halt", "source": "ros", "joint": "left"},
        {"node": "arm", "action": "enable", "source": "ros", "joint": "right"},
        {"node": "arm", "action": "mode", "source": "ros", "mode": "PV", "joint": "right"},
        {"node": "arm", "action": "disable", "source": "ros"},
    ]


def test_each_axis_of_a_node_with_several_has_a_target_and_the_node_has_none(fresh, call):
    assert call("/arm/right/target", TARGET, target=3.0) == {"success": True}
    assert fresh.robot.commands()[-1]["values"][1] == 3.0
    services = fresh.peer.order("graph")["services"]
    assert "/shoulder/target" in services
    assert "/arm/target" not in services
    assert "/arm/right/nmt_reset_node" not in services


def test_the_names_are_those_of_ros2_canopen_and_more():
    modes = ["position", "velocity", "torque", "cyclic_velocity", "cyclic_position", "cyclic_torque"]
    modes = [f"{mode}_mode" for mode in (*modes, "interpolated_position")]
    theirs = ["nmt_reset_node", "nmt_start_node", "init", "enable", "disable", "halt", "recover", *modes]
    assert set(TRIGGERS) == {*theirs, "home", "quick_stop"}


def test_recover_resets_the_fault_and_does_not_enable(fresh, call):
    call("/left_drive/recover")
    assert [command["action"] for command in fresh.robot.commands("axis")] == ["fault-reset"]


@pytest.mark.parametrize(("state", "success"), [("SWITCHED_ON", True), ("FAULT", False), (None, False)])
def test_recover_without_a_fault_is_a_success_as_in_ros2_canopen(fresh, call, state, success):
    nothing = "nothing was reset, because node 3 (left_drive) has no fault"
    fresh.robot.refusals["axis"] = {"kind": "ControlError", "message": nothing}
    left = {**ros.node(3, "left"), "axes": [{"joint": "left", "cia402_state": state}]}
    nodes = {**fresh.robot.nodes, "left_drive": left}
    fresh.robot.more = {"nodes": {name: {"name": name, **fields} for name, fields in nodes.items()}}
    assert ros.eventually(lambda: call("/left_drive/recover") == {"success": success, "message": nothing})
    assert call("/left_drive/halt")["success"] is False


def test_a_trigger_that_was_done_to_the_whole_base_reports_this(fresh, call):
    together = "base moves left_drive and right_drive together: halt applies to all of them"
    fresh.robot.answers["axis"] = {"text": together}
    assert call("/left_drive/halt") == {"success": True, "message": together}


def test_namespace_and_remappings_of_a_node_are_followed(fresh, call):
    assert call("/test1/right_drive/enable")["success"]
    assert call("/start")["success"]
    assert [command["node"] for command in fresh.robot.commands("axis")] == ["right_drive"] * 2


@pytest.mark.parametrize("stop", ["halt", "disable", "quick_stop"])
def test_a_stop_is_not_behind_an_init_that_takes_its_time(fresh, maker, call, stop):
    fresh.robot.holds = ("enable", "home")
    with ros.Peer(fresh.domain) as other:
        waiting = ros.in_thread(lambda: other.order("call", service="/left_drive/init", of=TRIGGER, data={}))
        assert ros.eventually(lambda: fresh.robot.commands("axis"))
        assert call(f"/left_drive/{stop}")["success"]
        assert waiting.is_alive()
        fresh.robot.release()
        waiting.join(ros.TIMEOUT)
        assert not waiting.is_alive()


def test_a_target_goes_through_the_controller_and_leaves_the_other_joint_what_it_has(fresh, call):
    fresh.robot.joints["right"]["command"] = 4.0
    try:
        assert ros.eventually(lambda: _commands(fresh, call, 7.5) == [[7.5, 4.0]])
    finally:
        fresh.robot.joints["right"]["command"] = None
    assert fresh.robot.commands()[0]["controller"] == "forward"


def _commands(stage, call, target):
    stage.robot.collected.clear()
    assert call("/left_drive/target", TARGET, target=target) == {"success": True}
    return [command["values"] for command in stage.robot.commands()]


def test_a_target_is_refused_without_a_controller_or_when_it_is_not_a_number(fresh, call):
    assert call("/left_drive/target", TARGET, target=math.nan) == {"success": False}
    fresh.robot.switch(forward="inactive")
    assert ros.eventually(lambda: call("/left_drive/target", TARGET, target=1.0) == {"success": False})
    assert all(math.isfinite(command["values"][0]) for command in fresh.robot.commands())


def test_a_node_that_moves_nothing_has_the_services_of_a_proxy_alone(fresh, call):
    assert call("/terminals/nmt_start_node")["success"]
    services = fresh.peer.order("graph")["services"]
    own = {name.rpartition("/")[2] for name in services if name.startswith("/terminals/")}
    assert own == {"nmt_reset_node", "nmt_start_node", "sdo_read", "sdo_write", "get_objects", "set_objects"}


def test_a_reset_is_asked_for_with_the_boot_after_it(fresh, call):
    assert call("/terminals/nmt_reset_node")["success"]
    assert fresh.robot.commands("nmt") == [{"node": "terminals", "command": "reset-node", "boot": True}]


def test_a_target_of_a_drive_that_does_not_follow_is_answered_false_with_the_reason_as_a_warning(fresh, call):
    reason = "left_drive is halted: canopen-control axis enable left_drive"
    fresh.robot.answers["command"] = {"idle": {"left": reason}}
    try:
        assert ros.eventually(lambda: _refused_with(fresh, call, reason))  # one warning a second
        assert call("/test1/right_drive/target", TARGET, target=1.0) == {"success": True}
    finally:
        del fresh.robot.answers["command"]


def _refused_with(stage, call, reason):
    assert call("/left_drive/target", TARGET, target=1.0) == {"success": False}
    return any(reason in command["text"] for command in stage.robot.commands("tell"))
