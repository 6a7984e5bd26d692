"""The calls of ros2_canopen's launch tests, on its unchanged configurations, from another ROS program."""

from __future__ import annotations

import contextlib
from types import SimpleNamespace

import pytest
from support import ros
from support.peerfiles import write_peer_files

# a drive that hears nothing of its master for too long, which a busy machine held up, stops as it should
pytestmark = [pytest.mark.ros, pytest.mark.timed]
DONE = {"success": True, "message": ""}
READ, WRITE = "canopen_interfaces/srv/CORead", "canopen_interfaces/srv/COWrite"
READ_ID, WRITE_ID = "canopen_interfaces/srv/COReadID", "canopen_interfaces/srv/COWriteID"
TARGET, DATA = "canopen_interfaces/srv/COTargetDouble", "canopen_interfaces/msg/COData"
UNSIGNED32 = 7


@contextlib.contextmanager
def running(folder, name):
    """Run a configuration on virtual devices, with its bridge and another ROS program."""
    with ros.stage(folder) as stage:
        robot = stage.start(
            "run", write_peer_files(folder, name), "--ros", "--can", f"local:{name}", **stage.environment
        )
        robot.until(f"{name} runs")
        with ros.Peer(stage.domain, "--interfaces") as peer:
            yield SimpleNamespace(peer=peer, call=peer.call, robot=robot)


@pytest.fixture(scope="module")
def proxies(tmp_path_factory):
    with running(tmp_path_factory.mktemp("proxies"), "simple_lifecycle") as scene:
        yield scene


def test_a_proxy_has_the_services_and_topics_of_a_proxy_and_no_others(proxies):
    assert proxies.call("/proxy_device_1/sdo_read", READ, index=0x1000)["success"]  # the bridge is there
    graph = proxies.peer.order("graph")
    for node in ("proxy_device_1", "proxy_device_2"):
        own = {name.rpartition("/")[2] for name in graph["services"] if name.rpartition("/")[0] == f"/{node}"}
        assert {"nmt_reset_node", "nmt_start_node", "sdo_read", "sdo_write"} <= own
        assert not own & {"init", "enable", "disable", "halt", "recover", "target", "position_mode"}
        assert {f"/{node}/{name}" for name in ("nmt_state", "rpdo", "tpdo")} <= set(graph["topics"])
        assert f"/{node}/joint_states" not in graph["topics"]


@pytest.mark.parametrize("who", ["lifecycle_manager", "proxy_device_1"])
def test_its_lifecycle_is_brought_up_and_down_twice(proxies, who):
    for _ in range(2):
        for label in ("configure", "activate", "deactivate", "cleanup"):
            change = {"transition": {"id": 0, "label": label}}
            answer = proxies.call(f"/{who}/change_state", "lifecycle_msgs/srv/ChangeState", **change)
            assert answer["success"], label


def test_its_lifecycle_follows_the_numbers_of_transitions_from_the_states_that_it_reports(proxies):
    for state, transition in ((1, 1), (2, 3), (3, 4), (2, 2)):  # configure, activate, deactivate, cleanup
        reported = proxies.call("/lifecycle_manager/get_state", "lifecycle_msgs/srv/GetState")["current_state"]
        assert reported["id"] == state
        change = {"transition": {"id": transition, "label": ""}}
        assert proxies.call("/lifecycle_manager/change_state", "lifecycle_msgs/srv/ChangeState", **change)["success"]


def expect_changed(scene, *labels):
    for label in labels:
        change = {"transition": {"id": 0, "label": label}}
        assert scene.call("/lifecycle_manager/change_state", "lifecycle_msgs/srv/ChangeState", **change)["success"], (
            label
        )


def test_it_is_configured_and_cleaned_up_without_being_activated(proxies):
    expect_changed(proxies, "configure", "cleanup")


def test_what_is_written_while_it_is_active_is_there_when_it_is_active_again(proxies):
    devices = ("proxy_device_1", "proxy_device_2")
    expect_changed(proxies, "configure", "activate")
    for node in devices:
        assert proxies.call(f"/{node}/sdo_write", WRITE, index=0x4000, data=100) == {"success": True}
        assert proxies.call(f"/{node}/sdo_read", READ, index=0x4000) == {"success": True, "data": 100}
    expect_changed(proxies, "deactivate", "cleanup", "configure", "activate")
    for node in devices:
        assert proxies.call(f"/{node}/sdo_read", READ, index=0x4000) == {"success": True, "data": 100}
    expect_changed(proxies, "deactivate", "cleanup")


def test_process_data_goes_out_in_a_cycle_of_the_lifecycle(proxies):
    expect_changed(proxies, "configure", "activate")
    topic = "/proxy_device_1/tpdo"
    for value in (200, 0):
        proxies.peer.order("publish", topic=topic, of=DATA, data={"index": 0x4000, "data": value}, rate=20)
        assert ros.eventually(
            lambda expected=value: proxies.call("/proxy_device_1/sdo_read", READ, index=0x4000)["data"] == expected
        )
        proxies.peer.order("silence", topic=topic)
    expect_changed(proxies, "deactivate", "cleanup")


@pytest.mark.parametrize("node", ["proxy_device_1", "proxy_device_2"])
def test_objects_of_every_width_are_read_and_written(proxies, node):
    call = proxies.call
    assert call(f"/{node}/sdo_write", WRITE, index=0x4000, data=0) == {"success": True}
    assert call(f"/{node}/sdo_read", READ, index=0x4000) == {"success": True, "data": 0}
    assert call(f"/{node}/sdo_write", WRITE, index=0x4000, data=100) == {"success": True}
    assert call(f"/{node}/sdo_read", READ, index=0x4000) == {"success": True, "data": 100}
    for subindex in range(2, 8):
        address = {"index": 0x4004, "subindex": subindex}
        assert call(f"/{node}/sdo_write", WRITE, **address, data=100) == {"success": True}
        assert call(f"/{node}/sdo_read", READ, **address) == {"success": True, "data": 100}


@pytest.mark.parametrize("node_id", [2, 3])
def test_the_master_reads_and_writes_by_node_id(proxies, node_id):
    address = {"nodeid": node_id, "index": 0x4000, "subindex": 0, "canopen_datatype": UNSIGNED32}
    assert proxies.call("/master/sdo_write", WRITE_ID, **address, data=100) == {"success": True}
    assert proxies.call("/master/sdo_read", READ_ID, **address) == {"success": True, "data": 100}


def test_a_reset_is_done_and_the_node_is_operational_again_by_itself(proxies):
    topic = "/proxy_device_1/nmt_state"
    proxies.peer.order("subscribe", topic=topic, of="std_msgs/msg/String", qos="latched")
    assert proxies.peer.message(topic) == {"data": "START"}
    assert proxies.call("/proxy_device_1/nmt_reset_node") == DONE
    assert proxies.peer.message(topic, lambda message: message["data"] != "START")
    assert proxies.peer.message(topic, lambda message: message["data"] == "START")
    assert proxies.call("/proxy_device_1/nmt_start_node") == DONE


def test_an_object_goes_out_in_its_pdo_and_one_that_comes_is_reported(proxies):
    rpdo, tpdo = "/proxy_device_2/rpdo", "/proxy_device_2/tpdo"
    proxies.peer.order("subscribe", topic=rpdo, of=DATA)
    proxies.peer.order("publish", topic=tpdo, of=DATA, data={"index": 0x4000, "data": 999}, rate=20)
    assert ros.eventually(lambda: proxies.call("/proxy_device_2/sdo_read", READ, index=0x4000)["data"] == 999)
    proxies.peer.order("silence", topic=tpdo)
    assert proxies.peer.message(rpdo) == {"index": 0x4001, "subindex": 0, "data": 0}  # of the TPDO at its start


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    with running(tmp_path_factory.mktemp("drive"), "cia402") as scene:
        yield scene


def position(scene):
    topic = "/test1/cia402_device_1/joint_states"
    return scene.peer.message(topic)["position"][0]


def test_a_drive_has_the_services_of_a_drive_below_its_namespace(drive):
    call = drive.call
    name = "/test1/cia402_device_1"
    drive.peer.order("subscribe", topic=f"{name}/joint_states", of="sensor_msgs/msg/JointState")
    assert call(f"{name}/sdo_read", READ, index=0x1000) == {"success": True, "data": 0xFFFF0192}
    assert call(f"{name}/target", TARGET, target=1.0) == {"success": False}  # it was not enabled
    assert call(f"{name}/init") == DONE
    assert call(f"{name}/position_mode") == DONE
    assert call(f"{name}/target", TARGET, target=float("nan")) == {"success": False}
    assert call(f"{name}/target", TARGET, target=1.0) == {"success": True}, str(drive.robot)
    assert ros.eventually(lambda: position(drive) == pytest.approx(1.0, abs=0.01))
    assert drive.peer.message(f"{name}/joint_states")["name"] == ["cia402_device_1"]
    assert call(f"{name}/velocity_mode") == DONE
    assert call(f"{name}/target", TARGET, target=0.5) == {"success": True}
    assert ros.eventually(lambda: position(drive) > 1.2)
    assert call(f"{name}/halt") == DONE
    assert call(f"{name}/recover")["success"]  # it has no fault: nothing was reset
    assert call(f"{name}/disable") == DONE
    assert call(f"{name}/target", TARGET, target=0.5) == {"success": False}


@pytest.fixture(scope="module")
def controlled(tmp_path_factory):
    with running(tmp_path_factory.mktemp("controlled"), "robot_control") as scene:
        yield scene


def test_a_drive_below_a_controller_is_read_by_its_own_service(controlled):
    device_type = {"success": True, "data": 0x60192}
    for node in ("joint_1", "joint_2"):
        assert controlled.call(f"/{node}/sdo_read", READ, index=0x1000) == device_type


def test_a_forward_controller_moves_the_drives_on_its_topic_and_its_bare_name_is_none(controlled):
    states, numbers = "/joint_states", "std_msgs/msg/Float64MultiArray"
    controlled.peer.order("subscribe", topic=states, of="sensor_msgs/msg/JointState")

    def places():
        reported = controlled.peer.message(states)
        return dict(zip(reported["name"], reported["position"], strict=True))

    publish = {"of": numbers, "rate": 20}
    controlled.peer.order("publish", topic="/forward_position_controller", data={"data": [2.0, 0.0]}, **publish)
    topic = "/forward_position_controller/commands"
    controlled.peer.order("publish", topic=topic, data={"data": [1.0, 0.0]}, **publish)
    assert ros.eventually(lambda: places()["joint1"] == pytest.approx(1.0, abs=0.01)), str(controlled.robot)
    assert places()["joint2"] == pytest.approx(0.0, abs=0.01)
