"""Classes made at run time against the real package, compiled by ROS's own generators: an independent counterpart."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support import ros
from support.compiled_interfaces import missing

pytestmark = [pytest.mark.ros, pytest.mark.skipif(missing() is not None, reason=str(missing()))]
BUILDER = Path(ros.__file__).with_name("compiled_interfaces.py")
# as ROS Jazzy has them; the hashes are upstream's published ones
TF, TF_HASH = "tf2_msgs/msg/TFMessage", "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
DATA, READ = "canopen_interfaces/msg/COData", "canopen_interfaces/srv/CORead"
DATA_HASH = "RIHS01_734aa4992e7102aa6fa1d5796932c1d7e2976ce7c59e8ac2c04ec162d7909798"
PACKAGES = {
    "tf2_msgs": (
        {"msg/TFMessage": ["geometry_msgs/TransformStamped[] transforms"]},
        ["geometry_msgs", "std_msgs", "builtin_interfaces"],
    ),
    "canopen_interfaces": (
        {
            "msg/COData": ["uint16 index", "uint8 subindex", "uint32 data"],
            "srv/CORead": ["uint16 index", "uint8 subindex", "---", "bool success", "uint32 data"],
        },
        ["service_msgs", "builtin_interfaces"],
    ),
}


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Compile the packages; returns the variables by which a ROS program finds them, as from a sourced ROS."""
    folder = tmp_path_factory.mktemp("compiled")
    for package, (definitions, dependencies) in PACKAGES.items():
        subprocess.run(
            [sys.executable, str(BUILDER), str(folder), package, *dependencies],
            input=json.dumps(definitions), text=True, check=True, stdout=subprocess.DEVNULL,
            env={**os.environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"},
        )  # fmt: skip
    return {"PYTHONPATH": f"{folder}:{ros.ROOT}", "LD_LIBRARY_PATH": str(folder)}


@pytest.fixture(scope="module")
def both(installed):
    """A ROS program with the compiled packages, and one with those made at run time."""
    with ros.domain() as number, ros.Peer(number, **installed) as compiled, ros.Peer(number, "--interfaces") as created:
        yield {"compiled": compiled, "made": created}


@pytest.mark.parametrize(("sender", "receiver"), [("made", "compiled"), ("compiled", "made")])
def test_messages_pass_between_a_made_and_a_compiled_class_both_ways(both, sender, receiver):
    topic = f"/of_{sender}"
    stamp = {"sec": 7, "nanosec": 999_999_999}
    transforms = [
        {"header": {"stamp": stamp, "frame_id": "odom"}, "child_frame_id": "b" * length,
         "transform": {"translation": {"x": length / 7, "y": -0.0, "z": 1e300}, "rotation": {"z": 0.6, "w": 0.8}}}
        for length in range(9)
    ]  # fmt: skip
    both[receiver].order("subscribe", topic=topic, of=TF)
    both[sender].order("publish", topic=topic, of=TF, data={"transforms": transforms}, rate=20)
    reported = both[receiver].message(topic)["transforms"]
    both[sender].order("silence", topic=topic)
    assert [item["child_frame_id"] for item in reported] == [transform["child_frame_id"] for transform in transforms]
    assert [item["transform"]["translation"] for item in reported] == [
        transform["transform"]["translation"] for transform in transforms
    ]
    assert {json.dumps(item["header"]) for item in reported} == {json.dumps({"stamp": stamp, "frame_id": "odom"})}
    assert reported[0]["transform"]["rotation"] == {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8}


@pytest.mark.parametrize("sender", ["made", "compiled"])
@pytest.mark.parametrize(("kind", "expected"), [(TF, TF_HASH), (DATA, DATA_HASH)])
def test_both_announce_the_published_hash_of_the_type(both, sender, kind, expected):
    topic = f"/hash_{sender}_{kind.split('/')[-1]}"
    both[sender].order("publish", topic=topic, of=kind, data={})
    for looker in both.values():
        assert ros.eventually(lambda looker=looker: looker.order("endpoints", topic=topic)["publishers"])
        assert [item["hash"] for item in looker.order("endpoints", topic=topic)["publishers"]] == [expected]


@pytest.mark.parametrize(("server", "client"), [("made", "compiled"), ("compiled", "made")])
def test_services_pass_between_them_both_ways(both, server, client):
    both[server].order("serve", service=f"/read_of_{server}", of=READ, response={"success": True, "data": 0xDEADBEEF})
    answer = both[client].order("call", service=f"/read_of_{server}", of=READ, data={"index": 0x6041, "subindex": 255})
    assert answer["response"] == {"success": True, "data": 0xDEADBEEF}
    assert both[server].order("served") == {"done": "served", "requests": [{"index": 0x6041, "subindex": 255}]}


def test_where_the_real_package_is_installed_ours_is_not_used(installed):
    code = """
from canopen_control.ros.interfaces import interface, provide
assert provide(["tf2_msgs", "canopen_interfaces"]) == []
for name in ("tf2_msgs/msg/TFMessage", "canopen_interfaces/srv/CORead", "canopen_interfaces/msg/COData"):
    print(interface(name).__module__)
"""
    text = ros.run_ros(code, **installed).split()
    assert text == ["tf2_msgs.msg._tf_message", "canopen_interfaces.srv._co_read", "canopen_interfaces.msg._co_data"]
    assert set(ros.run_ros(code.replace("== []", "!= []")).split()).isdisjoint(text), "without it they are made"


def test_the_bridge_publishes_tf_with_the_real_package_where_it_is_installed(installed, private_folders):
    with (
        ros.domain() as number,
        ros.FakeRobot() as robot,
        ros.bridge(number, **installed),
        ros.Peer(number, "--interfaces") as peer,
    ):
        robot.bus_nodes = []
        sample = {"kind": "odometry", "time": 1.0, "x": 2.5, "y": 0.0, "heading": 0.0, "linear": 0.0, "angular": 0.0}
        robot.samples = {"base": {**sample, "frame_id": "odom", "child_frame_id": "base_link"}}
        peer.order("subscribe", topic="/tf", of=TF)
        robot.samples["base"]["time"] += 0.01
        (transform,) = _told(peer, robot)
        assert transform["transform"]["translation"]["x"] == 2.5


def _told(peer, robot):
    """Return the transforms of the first message with odometry; each new sample is published once."""
    results = []

    def collected():
        robot.samples["base"]["time"] += 0.01
        results.extend(item["transforms"] for item in peer.waiting("/tf"))
        return results

    assert ros.eventually(collected)
    return results[0]
