"""Services from a ROS program through bridge and runtime to virtual drives, and back."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from support import ros
from support.processes import DriveProbe
from support.robots import PATIENT_ROBBY, copy_robby

pytestmark = pytest.mark.ros
FORWARD, BASE = "robby_forward_controller", "robby_base_controller"
DONE = {"success": True, "message": ""}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Robby on virtual drives with its bridge, and another ROS program; for all tests of this module."""
    folder = tmp_path_factory.mktemp("ros")
    with ros.stage(folder) as stage:
        config = copy_robby(folder, bus=PATIENT_ROBBY)
        robot = stage.start("run", config, "--ros", "--can", "local:services", **stage.environment)
        robot.until("robby runs")
        drive = DriveProbe("services", 3)
        with ros.Peer(stage.domain, "--interfaces") as peer:
            yield SimpleNamespace(peer=peer, drive=drive, robot=robot, domain=stage.domain)
        drive.close()


@pytest.fixture
def call(scene):
    return scene.peer.call


@pytest.fixture
def manager(call):
    def manager(service, kind, /, **data):
        return call(f"/controller_manager/{service}", f"controller_manager_msgs/srv/{kind}", **data)

    return manager


@pytest.fixture
def states(manager):
    return lambda: {
        item["name"]: item["state"] for item in manager("list_controllers", "ListControllers")["controller"]
    }


def test_the_spawners_sequence_brings_another_controller_up_and_back(manager, states):
    assert states()[FORWARD] == "active"
    assert manager("load_controller", "LoadController", name=BASE) == {"ok": True}
    assert manager("configure_controller", "ConfigureController", name=BASE) == {"ok": True}
    refused = manager("switch_controller", "SwitchController", activate_controllers=[BASE], strictness=2)
    assert refused["ok"] is False
    assert FORWARD in refused["message"]
    swap = {"activate_controllers": [BASE], "deactivate_controllers": [FORWARD], "strictness": 2, "activate_asap": True}
    assert manager("switch_controller", "SwitchController", **swap) == {"ok": True, "message": ""}
    assert (states()[FORWARD], states()[BASE]) == ("inactive", "active")
    back = {"activate_controllers": [FORWARD], "deactivate_controllers": [BASE], "strictness": 2}
    assert manager("switch_controller", "SwitchController", **back)["ok"]
    assert manager("cleanup_controller", "CleanupController", name=BASE)["ok"]
    assert manager("load_controller", "LoadController", name=BASE)["ok"]
    assert manager("unload_controller", "UnloadController", name=BASE)["ok"]
    assert BASE not in states()
    assert manager("load_controller", "LoadController", name="nobody") == {"ok": False}


def test_a_spawner_with_a_file_of_parameters_brings_up_a_controller_that_turns_the_wheels(
    scene, call, manager, states, tmp_path
):
    """What the spawner of Jazzy sends for --param-file and --controller-ros-args, and `ros2 param set` after it."""

    def put(node, name, **value):
        parameter = {"name": name, "value": value}
        kind = "rcl_interfaces/srv/SetParameters"
        return call(f"/{node}/set_parameters", kind, parameters=[parameter])["results"][0]

    path, kind = tmp_path / "wheels.yaml", "velocity_controllers/JointGroupVelocityController"
    path.write_text("wheels:\n  ros__parameters:\n    joints: [left_wheel_joint, right_wheel_joint]\n")
    file = put("controller_manager", "wheels.params_file", type=9, string_array_value=[str(path)])
    assert file == {"successful": True, "reason": ""}
    options = ["-r", "~/commands:=/speeds"]
    assert put("controller_manager", "wheels.node_options_args", type=9, string_array_value=options)["successful"]
    assert put("controller_manager", "wheels.type", type=4, string_value=kind)["successful"]
    assert manager("load_controller", "LoadController", name="wheels")["ok"]
    assert states()["wheels"] == "unconfigured"
    assert manager("configure_controller", "ConfigureController", name="wheels")["ok"]
    swap = {"activate_controllers": ["wheels"], "deactivate_controllers": [FORWARD], "strictness": 2}
    assert manager("switch_controller", "SwitchController", **swap)["ok"]
    names = call("/wheels/list_parameters", "rcl_interfaces/srv/ListParameters")["result"]["names"]
    assert {"joints", "update_rate"} <= set(names)
    refused = put("wheels", "joints", type=9, string_array_value=["left_wheel_joint"])
    assert "'joints' cannot be set because it is read-only" in refused["reason"]
    scene.peer.order(
        "publish", topic="/speeds", of="std_msgs/msg/Float64MultiArray", data={"data": [2.0, 2.0]}, rate=20
    )
    assert ros.eventually(lambda: abs(scene.drive.speed) > 0.5)
    scene.peer.order("silence", topic="/speeds")
    back = {"activate_controllers": [FORWARD], "deactivate_controllers": ["wheels"], "strictness": 2}
    assert manager("switch_controller", "SwitchController", **back)["ok"]
    assert manager("unload_controller", "UnloadController", name="wheels")["ok"]
    assert "wheels" not in states()


def test_rclpys_own_client_of_parameters_lists_describes_gets_sets_and_loads(scene, manager, tmp_path):
    """What `ros2 param list`, `describe`, `get`, `set` and `load` are made of."""
    assert manager("load_controller", "LoadController", name=BASE)["ok"]
    assert manager("configure_controller", "ConfigureController", name=BASE)["ok"]
    file, node = tmp_path / "base.yaml", f"/{BASE}"
    file.write_text(f"{node}:\n  ros__parameters:\n    cmd_vel_timeout: 0.75\n    wheel_radius: 1.0\n")
    values = {"linear.x.max_velocity": 0.25, "wheel_radius": 0.5, "no_such": 1.0}

    def collected(part):
        return scene.peer.message(node, lambda message: part in message)[part]

    assert scene.peer.order("parameters", node=node, values=values, file=str(file), name=node)["ready"]
    known = collected("values")
    assert known["wheel_radius"]["double_value"] == 0.035
    assert known["left_wheel_names"]["string_array_value"] == ["left_wheel_joint"]
    result = collected("descriptors")
    assert set(result) == set(known)
    assert (result["wheel_radius"]["type"], result["wheel_radius"]["read_only"]) == (3, True)
    assert not result["cmd_vel_timeout"]["read_only"]
    results = collected("results")
    assert [result["successful"] for result in results] == [True, False, False]
    assert "read-only" in results[1]["reason"]
    assert "not declared" in results[2]["reason"]
    assert [item["successful"] for item in collected("loaded")] == [True, False]
    assert manager("unload_controller", "UnloadController", name=BASE)["ok"]


def test_types_and_interfaces_are_those_of_the_robot(manager):
    assert (
        "diff_drive_controller/DiffDriveController" in manager("list_controller_types", "ListControllerTypes")["types"]
    )
    interfaces = manager("list_hardware_interfaces", "ListHardwareInterfaces")
    assert [interface["name"] for interface in interfaces["command_interfaces"] if interface["is_claimed"]] == [
        "left_wheel_joint/velocity", "right_wheel_joint/velocity",
    ]  # fmt: skip


def test_a_hardware_component_goes_inactive_and_active_again(manager, states):
    def component(label):
        kind = "SetHardwareComponentState"
        return manager("set_hardware_component_state", kind, name="robby", target_state={"label": label})

    assert component("inactive") == {"ok": True, "state": {"id": 2, "label": "inactive"}}
    assert states()[FORWARD] == "inactive"
    assert component("finalized")["ok"] is False
    assert component("active")["ok"] is True
    assert manager("switch_controller", "SwitchController", activate_controllers=[FORWARD], strictness=2)["ok"]
    (reported,) = manager("list_hardware_components", "ListHardwareComponents")["component"]
    assert reported["state"]["label"] == "active"


def test_a_drive_is_disabled_enabled_halted_and_given_a_target(scene, call):
    assert call("/left_drive/disable") == DONE
    assert ros.eventually(lambda: scene.drive.power != "OPERATION_ENABLED")
    assert call("/left_drive/init") == DONE
    assert ros.eventually(lambda: scene.drive.power == "OPERATION_ENABLED")
    assert call("/left_drive/target", "canopen_interfaces/srv/COTargetDouble", target=5.0) == {"success": True}
    assert ros.eventually(lambda: scene.drive.speed < -1000)
    assert call("/left_drive/halt") == DONE
    assert ros.eventually(lambda: scene.drive.speed == 0.0)
    assert call("/left_drive/quick_stop")["success"]
    assert call("/left_drive/enable") == DONE
    assert call("/left_drive/velocity_mode") == DONE
    refused = call("/left_drive/torque_mode")
    assert refused["success"] is False
    assert refused["message"].startswith("mode TQ is not supported")


def test_objects_are_read_and_written_through_each_service(call):
    read, write = "canopen_interfaces/srv/CORead", "canopen_interfaces/srv/COWrite"
    assert call("/left_drive/sdo_write", write, index=0x6083, data=12345) == {"success": True}
    assert call("/left_drive/sdo_read", read, index=0x6083) == {"success": True, "data": 12345}
    master = {"nodeid": 3, "index": 0x6083, "canopen_datatype": 7}
    assert call("/master/sdo_write", "canopen_interfaces/srv/COWriteID", **master, data=16000) == {"success": True}
    assert call("/master/sdo_read", "canopen_interfaces/srv/COReadID", **master) == {"success": True, "data": 16000}
    names = ["0x1008 str", "0x1000 u32", "0x4FFF"]
    values = call("/left_drive/get_objects", "rcl_interfaces/srv/GetParameters", names=names)["values"]
    assert values[0]["string_value"] == "TMCM-1270"
    assert values[1]["integer_value"] == 0xFFFF0192
    assert "abort 0x06020000" in values[2]["string_value"]


def test_a_reset_of_a_node_is_seen_as_it_happens_and_a_start_boots_it(scene, call):
    topic = "/right_drive/nmt_state"
    scene.peer.order("subscribe", topic=topic, of="std_msgs/msg/String", qos="latched")
    assert scene.peer.message(topic) == {"data": "START"}
    assert call("/right_drive/nmt_reset_node") == DONE
    assert scene.peer.message(topic) == {"data": "PREOP"}, "where a node goes by itself when it has booted"
    assert call("/right_drive/nmt_start_node") == DONE
    assert scene.peer.message(topic) == {"data": "START"}


def test_the_objects_of_the_tpdos_are_reported_as_they_change_and_an_unmapped_one_is_written(scene, call):
    kind, rpdo, tpdo = "canopen_interfaces/msg/COData", "/left_drive/rpdo", "/left_drive/tpdo"
    scene.peer.order("subscribe", topic=rpdo, of=kind)
    first = [scene.peer.message(rpdo) for _ in range(4)]
    assert {item["index"] for item in first} == {0x6041, 0x6061, 0x6064, 0x606C}
    assert call("/left_drive/disable") == DONE
    scene.peer.message(rpdo, lambda message: message["index"] == 0x6041 and message["data"] & 0x6F != 0x27)
    assert call("/left_drive/enable") == DONE
    scene.peer.message(rpdo, lambda message: message["index"] == 0x6041 and message["data"] & 0x6F == 0x27)
    scene.peer.order("publish", topic=tpdo, of=kind, data={"index": 0x6083, "data": 15000}, rate=20)
    read = "canopen_interfaces/srv/CORead"
    assert ros.eventually(lambda: call("/left_drive/sdo_read", read, index=0x6083)["data"] == 15000)
    scene.peer.order("silence", topic=tpdo)
    scene.peer.order("unsubscribe", topic=rpdo)


def test_an_emergency_of_a_drive_is_reported_on_its_topic(scene, call):
    scene.peer.order("subscribe", topic="/left_drive/emcy", of="diagnostic_msgs/msg/DiagnosticArray")
    scene.peer.order("subscribe", topic="/rosout", of="rcl_interfaces/msg/Log")
    scene.drive.fault("drive_fault")
    (status,) = scene.peer.message("/left_drive/emcy")["status"]
    assert (status["name"], status["level"]) == ("left_drive", 1)
    values = {item["key"]: item["value"] for item in status["values"]}
    assert (values["error_code"], int(values["error_register"], 16) & 9) == ("0x4310", 9), "temperature, generic"
    assert f"EMCY {values['error_code']} (" in status["message"]
    logged = scene.peer.message("/rosout", lambda message: "EMCY 0x4310" in message["msg"])
    assert (logged["name"], logged["level"]) == ("left_drive", 30)
    scene.drive.fault("drive_fault", on=False)
    assert ros.eventually(lambda: call("/left_drive/recover")["success"])
    assert scene.drive.power != "OPERATION_ENABLED"
