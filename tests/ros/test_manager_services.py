"""The call sequences of `ros2 control` and of the spawner, from a ROS program with generated classes."""

from __future__ import annotations

import pytest
from support import endpoints, ros
from support.ros import Peer, bridge

from canopen_control.ros import manager_services
from canopen_control.rpc.messages.robot import HardwareReading, InterfaceReading
from canopen_control.rpc.messages.state import ControllerReading

pytestmark = pytest.mark.ros
HARDWARE = [
    {
        "name": "robby", "type": "system", "plugin": "canopen_ros2_control/RobotSystem", "state": "active", "rate": 50,
        "command_interfaces": [{"name": "left/velocity", "available": True, "claimed": True}],
        "state_interfaces": [
            {"name": "right/position", "available": True},
            {"name": "left/position", "available": False},
        ],
    }
]  # fmt: skip


@pytest.fixture(scope="module")
def scene(ros_folder):
    with pytest.MonkeyPatch.context() as patch, ros.domain() as number:
        for name, value in ros_folder.items():
            patch.setenv(name, value)
        with ros.FakeRobot() as robot, bridge(number, **ros_folder), Peer(number, "--interfaces") as peer:
            robot.answers = {
                "controller_types": ["a/B", "c/D"],
                "hardware": HARDWARE,
                "set_hardware_state": {"state": "inactive"},
            }
            yield robot, peer


@pytest.fixture
def call(scene):
    robot, peer = scene
    robot.collected.clear()
    robot.refusals.clear()

    def call(service, kind, **data):
        answer = peer.order(
            "call", service=f"/controller_manager/{service}", of=f"controller_manager_msgs/srv/{kind}", data=data
        )
        return answer["response"]

    return call


def asked(scene, method):
    return scene[0].commands(method)


def test_list_controllers_shows_type_state_and_claims(call):
    listed = {item["name"]: item for item in call("list_controllers", "ListControllers")["controller"]}
    assert set(listed) == {"joint_state_broadcaster", "forward", "base"}
    forward = listed["forward"]
    assert (forward["type"], forward["state"]) == ("forward_command_controller/ForwardCommandController", "active")
    assert (
        forward["claimed_interfaces"] == forward["required_command_interfaces"] == ["left/velocity", "right/velocity"]
    )
    assert listed["base"]["claimed_interfaces"] == []


def test_list_controllers_shows_the_chains(monkeypatch):
    monkeypatch.setattr(manager_services, "interface", endpoints.interface, raising=False)
    robot = endpoints.Ros()
    manager_services.ControllerManagerServices(robot)
    names = ("loops/left/position", "loops/right/position", "loops/left/velocity", "loops/right/velocity")
    loops = ControllerReading(name="loops", type="x/Y", state="active", reference_interfaces=names,
                              exported_state_interfaces=names[:1])  # fmt: skip
    arm = ControllerReading(name="arm", type="x/Y", state="active", claims=("gripper/position", *names[:2]))
    kind, handler = robot.services["controller_manager/list_controllers"]
    response = kind.Response()
    all_of_them = ControllerReading(name="states", type="x/Z", state="active", required_state_interfaces=("*",))
    handler(kind.Request(), response, lambda _response: None)
    states = [InterfaceReading("right/position", available=True), InterfaceReading("left/position", available=True)]
    robot.asked[-1][1]([HardwareReading(name="h", type="system", plugin="p", state="active", rate=100,
                                        command_interfaces=[], state_interfaces=states)], None)  # fmt: skip
    robot.asked[-1][1]((loops, arm, all_of_them), None)
    below, above, broadcaster = response.controller
    assert broadcaster.required_state_interfaces == ["left/position", "right/position"]
    assert (below.is_chainable, below.is_chained, above.is_chainable, above.is_chained) == (True, True, False, False)
    assert below.reference_interfaces == [item.removeprefix("loops/") for item in names]
    assert below.exported_state_interfaces == ["left/position"]
    assert (below.chain_connections, above.reference_interfaces) == ([], [])
    (connection,) = above.chain_connections
    assert (connection.name, connection.reference_interfaces) == ("loops", ["left/position", "right/position"])


def test_the_spawners_sequence_loads_configures_and_switches_strictly(scene, call):
    call("list_controllers", "ListControllers")
    assert call("load_controller", "LoadController", name="new") == {"ok": True}
    assert call("configure_controller", "ConfigureController", name="new") == {"ok": True}
    switched = call(
        "switch_controller", "SwitchController",
        activate_controllers=["new"], deactivate_controllers=["base"], strictness=2, activate_asap=True,
        timeout={"sec": 5},
    )  # fmt: skip
    assert switched == {"ok": True, "message": ""}
    assert asked(scene, "load") == [{"controller": "new", "configure": False}]
    assert asked(scene, "configure") == [{"controller": "new"}]
    assert asked(scene, "switch") == [{"activate": ["new"], "deactivate": ["base"], "strict": True}]


@pytest.mark.parametrize("strictness", [0, 1, 3, 4])
def test_any_other_strictness_is_best_effort(scene, call, strictness):
    call("switch_controller", "SwitchController", activate_controllers=["forward"], strictness=strictness)
    assert asked(scene, "switch")[0]["strict"] is False


def test_what_the_robot_refuses_is_not_ok_and_reports_why(scene, call):
    scene[0].refusals["switch"] = {"kind": "InterfaceConflict", "message": "left/velocity is claimed"}
    answer = call("switch_controller", "SwitchController", activate_controllers=["base"], strictness=2)
    assert answer == {"ok": False, "message": "left/velocity is claimed"}
    scene[0].refusals["load"] = {"kind": "ControlError", "message": "no such type"}
    assert call("load_controller", "LoadController", name="x") == {"ok": False}


def test_types_are_listed_with_their_base_class(call):
    answer = call("list_controller_types", "ListControllerTypes")
    assert answer["types"] == ["a/B", "c/D"]
    assert answer["base_classes"] == ["controller_interface::ControllerInterface"] * 2


def test_hardware_is_listed_with_its_interfaces(call):
    (component,) = call("list_hardware_components", "ListHardwareComponents")["component"]
    assert (component["name"], component["plugin_name"]) == ("robby", "canopen_ros2_control/RobotSystem")
    assert component["state"] == {"id": 3, "label": "active"}
    assert component["rw_rate"] == 50
    interfaces = call("list_hardware_interfaces", "ListHardwareInterfaces")
    assert [interface["name"] for interface in interfaces["state_interfaces"]] == ["left/position", "right/position"]
    assert [interface["is_available"] for interface in interfaces["state_interfaces"]] == [False, True]
    (command,) = interfaces["command_interfaces"]
    assert command == {"name": "left/velocity", "data_type": "double", "is_available": True, "is_claimed": True}


@pytest.mark.parametrize("target", [{"id": 2}, {"label": "inactive"}])
def test_a_hardware_component_is_set_by_number_or_by_label(scene, call, target):
    answer = call("set_hardware_component_state", "SetHardwareComponentState", name="robby", target_state=target)
    assert answer == {"ok": True, "state": {"id": 2, "label": "inactive"}}
    assert asked(scene, "set_hardware_state") == [{"component": "robby", "state": "inactive"}]


def test_an_answer_of_another_shape_is_not_an_answer_and_the_bridge_continues(scene, call):
    robot, _ = scene
    before, robot.answers = robot.answers, {**robot.answers, "hardware": [{"name": "robby"}]}
    assert call("list_hardware_components", "ListHardwareComponents") == {"component": []}
    robot.answers = before
    assert call("list_controllers", "ListControllers")["controller"]


def test_a_spawners_param_file_goes_to_the_robot(scene):
    robot, peer = scene
    robot.collected.clear()
    parameter = {"name": "base.params_file", "value": {"type": 9, "string_array_value": ["/tmp/base.yaml"]}}
    answer = peer.order(
        "call", service="/controller_manager/set_parameters", of="rcl_interfaces/srv/SetParameters",
        data={"parameters": [parameter]},
    )  # fmt: skip
    assert answer["response"]["results"] == [{"successful": True, "reason": ""}]
    value = {"name": "base.params_file", "kind": "string_array", "value": ["/tmp/base.yaml"]}
    assert asked(scene, "set_parameters") == [{"controller": "controller_manager", "values": [value]}]
