"""The bridge with the interface packages of other releases: only missing interfaces are omitted, and they are reported.

`tests/data/ros_interfaces`: control_msgs and controller_manager_msgs of Jazzy's first release, of a later one and of
rolling, by their versions.
"""

from __future__ import annotations

import json

import pytest
from support import ros

pytestmark = pytest.mark.ros
SETS = sorted((ros.ROOT / "tests/data/ros_interfaces").glob("*.json"))
#: has the package make the interfaces of another release, as if its host had that one
OTHER = """
import json, sys
from canopen_control.ros.interfaces import definition
told = json.load(open({path!r}))["definitions"]
packages = ("control_msgs/", "controller_manager_msgs/")
for name in [each for each in definition.DEFINITIONS if each.startswith(packages)]:
    del definition.DEFINITIONS[name]
definition.DEFINITIONS.update(told)
"""
#: of every kind of controller, what is made of it and what is left out
ENDPOINTS = """
from canopen_control.ros import action_goals
from canopen_control.ros import controller_endpoints
action_goals.AsyncActionServer = lambda *args, **more: None  # which needs a node
from canopen_control.ros.sample_topics import SAMPLE_TOPICS
from canopen_control.rpc.messages.samples import kind_of
from canopen_control.rpc.messages.state import ControllerReading
class Ros:
    def __init__(self): self.lacking = []
    def __getattr__(self, name): return lambda *args, **more: None
    def serve(self, kind, name, handler):
        from canopen_control.ros.interfaces import MissingInterface, interface
        try:
            return interface(kind)
        except MissingInterface as error:
            self.leave_out(error.name)
    def leave_out(self, name): self.lacking.append(name)
    @property
    def node(self): return self
TOPICS = {"odometry": "cmd_vel", "steering": "reference", "mecanum": "reference", "gpio": "gpio_commands"}
TOPICS |= {"pid": "reference"}
def of(tells, type="x/Y", publishes=(), offers=()):
    reading = ControllerReading(
        name="c", type=type, state="active", tells=tells, topic=TOPICS.get(tells), publishes=publishes,
        offers=offers,
    )
    made = Ros()
    names = [each.__class__.__name__ for each in controller_endpoints.endpoints_for(made, reading)]
    return names, made.lacking
samples = {kind_of(row.kind) for row in SAMPLE_TOPICS} - {'joint_states'} | controller_endpoints.BY_SAMPLE.keys()
kinds = {tells: of(tells) for tells in sorted(samples)}
kinds |= {offer: of(None, offers=(offer,)) for offer in controller_endpoints.BY_OFFER}
kinds["broadcaster"] = of("joint_states", publishes=("joint_states", "dynamic_joint_states"))
print(json.dumps(kinds))
"""
HARDWARE = [
    {"name": "drives", "type": "system", "plugin": "package/System", "state": "active", "rate": 100,
     "command_interfaces": [{"name": "left/velocity", "available": True}], "state_interfaces": []},
]  # fmt: skip
LACKING = {
    "jazzy_first": {
        "odometry": {"control_msgs/srv/SetOdometry"},
        "gpio": {"control_msgs/msg/DynamicInterfaceGroupValues"},
        "trajectory": {"control_msgs/msg/SpeedScalingFactor"},
        "batteries": {"control_msgs/msg/BatteryStateArray"},
    },
    "jazzy_4_20": {"odometry": {"control_msgs/srv/SetOdometry"}, "batteries": {"control_msgs/msg/BatteryStateArray"}},
    "rolling": {},
}


@pytest.fixture(scope="module")
def whole():
    """Return the endpoints of each kind of controller on this host."""
    return json.loads(ros.run_ros("import json" + ENDPOINTS))


@pytest.mark.parametrize("path", SETS, ids=lambda path: path.stem)
def test_what_a_host_lacks_is_left_out_alone(path, whole):
    kinds = json.loads(ros.run_ros(OTHER.format(path=str(path)) + ENDPOINTS))
    assert all(not missing for _, missing in whole.values())
    missing = {kind: set(each) for kind, (_, each) in kinds.items() if each}
    assert missing == LACKING[path.stem]
    for kind, (names, _) in whole.items():
        lost = set(names) - set(kinds[kind][0])
        assert len(lost) <= len(missing.get(kind, ())) + (kind == "gpio"), (kind, lost)


@pytest.fixture(scope="module", params=SETS, ids=lambda path: path.stem)
def host(request, tmp_path_factory):
    """A robot, its bridge on a host of another release, and another program there."""
    folder = tmp_path_factory.mktemp("release")
    folder.chmod(0o700)
    (folder / "sitecustomize.py").write_text(OTHER.format(path=str(request.param)))
    own = {"XDG_RUNTIME_DIR": str(folder), "XDG_STATE_HOME": str(folder), "ROS_LOG_DIR": str(folder)}
    with pytest.MonkeyPatch.context() as patch, ros.domain() as number:
        for name, value in own.items():
            patch.setenv(name, value)
        own["PYTHONPATH"] = f"{folder}:{ros.ROOT}"
        with ros.FakeRobot() as robot, ros.bridge(number, **own), ros.Peer(number, "--interfaces", **own) as peer:
            robot.answers = {"hardware": HARDWARE}
            yield request.param.stem, robot, peer


def test_controllers_and_hardware_are_listed_and_odometry_continues(host):
    name, robot, peer = host
    kind = "controller_manager_msgs/srv"
    reported = peer.call("/controller_manager/list_controllers", f"{kind}/ListControllers")["controller"]
    assert [item["name"] for item in reported] == [controller["name"] for controller in robot.controllers]
    parts = peer.call("/controller_manager/list_hardware_components", f"{kind}/ListHardwareComponents")["component"]
    assert [(part["name"], part["plugin_name"]) for part in parts] == [("drives", "package/System")]
    assert [part["name"] for part in parts[0]["command_interfaces"]] == ["left/velocity"]
    services = peer.order("graph")["services"]
    assert ("/controller_manager/cleanup_controller" in services) == (name == "rolling")
    assert {"/controller_manager/set_hardware_component_state", "/controller_manager/unload_controller"} <= set(
        services
    )
    if name != "rolling":
        missing = "ROS: topics and services of these interfaces are left out, which ROS lacks on this host: "

        def said():  # all that comes up within a second is one sentence
            return [command["text"] for command in robot.commands("tell") if command["text"].startswith(missing)]

        assert ros.eventually(said)
        reported = said()
        assert len(reported) == 1
        assert "controller_manager_msgs/srv/CleanupController" in reported[0]
    robot.switch(base="active")
    sample = {"kind": "odometry", "x": 1.0, "y": 0.0, "heading": 0.0, "linear": 0.0, "angular": 0.0}
    peer.order("subscribe", topic="/base/odom", of="nav_msgs/msg/Odometry")

    def comes():
        robot.samples = {"base": {**sample, "time": robot.samples.get("base", {"time": 1.0})["time"] + 0.01}}
        return list(peer.waiting("/base/odom"))

    assert ros.eventually(comes)
