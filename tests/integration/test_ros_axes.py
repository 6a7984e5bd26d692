"""A device with two axes on its bus, shown to ROS: each axis by its own services, its objects by PDO."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from support import ros
from support.generic import write_two_axes
from support.processes import DriveProbe
from support.robots import PATIENT

from canopen_control.client import RobotClient
from canopen_control.rpc.messages.robot import GetStatus, SdoRead

pytestmark = pytest.mark.ros
TARGET = "canopen_interfaces/srv/COTargetDouble"
OBJECT, DONE = "canopen_interfaces/msg/COData", {"success": True, "message": ""}
OUTPUTS = 0x60FE


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """The robot with its bridge, its drive, its API, and another ROS program."""
    folder = tmp_path_factory.mktemp("axes")
    config = write_two_axes(folder)
    bus = (config / "bus.yml").read_text().replace("sync_period: 10000", "sync_period: 20000")
    for before, after in PATIENT.items():
        bus = bus.replace(before, after)
    node = "{node_id: 2, channel_names: [shoulder], missed_syncs: 500}"
    (config / "bus.yml").write_text(bus.replace("{node_id: 2}", node))
    with ros.stage(folder) as stage:
        robot = stage.start(
            "run",
            config,
            "--as",
            "axes",
            "--can",
            "local:axes",
            "--controller",
            "velocity",
            "--ros",
            **stage.environment,
        )
        robot.until("axes runs")
        drive = DriveProbe("axes", 2)
        try:
            with RobotClient.connect("axes") as client, ros.Peer(stage.domain, "--interfaces") as peer:
                yield SimpleNamespace(peer=peer, drive=drive, client=client)
        finally:
            drive.close()


@pytest.fixture
def call(scene):
    return scene.peer.call


def powers(scene):
    return [axis.state for axis in scene.drive.state.axes]


def test_each_axis_is_disabled_and_enabled_alone(scene, call):
    both = ["OPERATION_ENABLED"] * 2
    assert ros.eventually(lambda: powers(scene) == both)
    assert call("/drive_one/two/disable") == DONE
    assert powers(scene)[0] == both[0]
    assert powers(scene)[1] != both[1]
    assert call("/drive_one/two/init") == DONE
    assert powers(scene) == both
    assert call("/shoulder/disable") == DONE
    assert powers(scene)[0] != both[0]
    assert call("/shoulder/enable") == DONE


def test_each_axis_has_a_target_of_its_own(scene, call):
    assert call("/shoulder/target", TARGET, target=1.0) == {"success": True}
    assert call("/drive_one/two/target", TARGET, target=-2.0) == {"success": True}

    def speeds():
        one, two = (axis.plant.velocity for axis in scene.drive.state.axes)
        return one > 0 and abs(two + 2 * one) < 0.1 * abs(two)

    assert ros.eventually(speeds)


def test_objects_of_both_axes_are_reported(scene):
    topic = "/drive_one/rpdo"
    scene.peer.order("subscribe", topic=topic, of=OBJECT)
    reported = {scene.peer.message(topic)["index"] for _ in range(8)}
    assert reported >= {0x6041, 0x6841, 0x6061, 0x6861, 0x6064, 0x6864, 0x606C, 0x686C}
    scene.peer.order("unsubscribe", topic=topic)


def test_a_mapped_object_travels_in_the_rpdo_without_any_sdo(scene, call):
    def writes():
        return scene.client.ask(GetStatus()).nodes["drive_one"].sdo.writes

    def outputs():
        return scene.client.ask(SdoRead(node="drive_one", index=OUTPUTS, subindex=1)).data.hex()

    topic, before = "/drive_one/tpdo", writes()
    assert outputs() == "00000000"
    data = {"index": OUTPUTS, "subindex": 1, "data": 0x50000}
    scene.peer.order("publish", topic=topic, of=OBJECT, data=data, rate=20)
    assert ros.eventually(lambda: outputs() == "00000500")
    scene.peer.order("publish", topic=topic, of=OBJECT, data={"index": 0x6040, "data": 0}, rate=20)
    scene.peer.order("subscribe", topic="/rosout", of="rcl_interfaces/msg/Log", qos="latched")
    scene.peer.message("/rosout", lambda message: "0x6040:00 moves the drive" in message["msg"])
    scene.peer.order("silence", topic=topic)
    assert writes() == before
    assert powers(scene)[0] == "OPERATION_ENABLED"
