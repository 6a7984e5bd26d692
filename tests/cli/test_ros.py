"""`canopen-control ros` without ros2cli, with other ROS programs."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from support import ros

from canopen_control.cli.ros import _data
from canopen_control.errors import ConfigError

TOPIC, TYPE = "/chatter", "std_msgs/msg/Float64MultiArray"


@pytest.fixture(scope="module")
def scene():
    with ros.domain() as number, ros.Peer(number) as peer:
        yield number, peer


@pytest.fixture
def program(scene):
    def program(*arguments, code=0, **more):
        command = [sys.executable, "-m", "canopen_control", "ros", *arguments]
        environment = ros.ros_environment(scene[0], **more)
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
        assert done.returncode == code, done.stdout + done.stderr
        return done.stdout or done.stderr

    return program


@pytest.mark.ros
def test_topics_and_services_are_listed_with_their_types(scene, program):
    scene[1].order("publish", topic=TOPIC, of=TYPE, data={"data": [1.0]})
    topics = program("topic", "list", "--types").splitlines()
    assert f"{TOPIC} [{TYPE}]" in topics
    assert "/peer/get_parameters" in program("service", "list").splitlines()
    assert json.loads(program("topic", "list", "--json"))[TOPIC] == [TYPE]


@pytest.mark.ros
def test_a_message_is_shown_as_yaml_also_where_the_environment_is_another_programs(scene, program):
    scene[1].order("publish", topic=TOPIC, of=TYPE, data={"data": [1.0, 2.5]}, rate=50)
    # the guard of the ROS wheels alone, without their libraries, is what a program that was started without ROS has
    text = program("topic", "echo", TOPIC, "--once", _ROS_WHEELS_BOOTSTRAP_COMPLETE="1")
    assert text.endswith("data:\n- 1.0\n- 2.5\n---\n")
    assert "average rate: " in program("topic", "hz", TOPIC, "--for", "1.5")
    assert json.loads(program("topic", "echo", TOPIC, "--once", "--json"))["data"] == [1.0, 2.5]
    rates = json.loads(program("topic", "hz", TOPIC, "--for", "1", "--json").splitlines()[-1])
    assert 20.0 < rates["rate"] < 80.0
    assert rates["min"] <= 1 / rates["rate"] <= rates["max"]
    scene[1].order("silence", topic=TOPIC)


@pytest.mark.ros
def test_a_file_of_the_users_folder_is_not_a_module_of_ours(scene, tmp_path):
    (tmp_path / "statistics.py").write_text("raise SystemExit('the wrong statistics')")
    environment = ros.ros_environment(scene[0], _ROS_WHEELS_BOOTSTRAP_COMPLETE="1")
    environment.pop("LD_LIBRARY_PATH", None)  # so that it restarts itself
    program = [sys.executable, "-P", "-m", "canopen_control", "ros", "topic", "list"]
    done = subprocess.run(program, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert (done.returncode, "wrong" in done.stderr) == (0, False), done.stderr


@pytest.mark.ros
def test_a_message_is_published_once_there_is_a_subscriber(scene, program):
    scene[1].order("subscribe", topic="/from_cli", of=TYPE)
    program("topic", "pub", "/from_cli", TYPE, "{data: [10.0, 10]}", "--once")
    assert scene[1].message("/from_cli")["data"] == [10.0, 10.0]
    program("topic", "pub", "/from_cli", "std_msgs/Float64MultiArray", "{data: [3.0]}", "--rate", "50", "--for", "0.5")
    assert len([scene[1].message("/from_cli"), *scene[1].waiting("/from_cli")]) > 10


@pytest.mark.ros
def test_a_service_is_called_and_its_answer_shown(scene, program):
    text = program("service", "call", "/peer/list_parameters", "rcl_interfaces/srv/ListParameters", "{depth: 1}")
    assert text.startswith("result:\n  names:\n  - 'use_sim_time'")
    kind = "rcl_interfaces/srv/ListParameters"
    answer = json.loads(program("service", "call", "/peer/list_parameters", kind, "{depth: 1}", "--json"))
    assert answer["result"]["names"][0] == "use_sim_time"


@pytest.mark.ros
def test_a_nodes_parameters_are_listed_read_and_set(program):
    assert program("param", "list", "/peer").splitlines()[0] == "use_sim_time"
    assert program("param", "get", "peer", "use_sim_time") == "False\n"
    assert json.loads(program("param", "get", "/peer", "use_sim_time", "--json")) is False
    assert program("param", "set", "/peer", "use_sim_time", "false") == ""
    text = program("param", "set", "/peer", "use_sim_time", "3", code=1)
    assert text.startswith("canopen-control: /peer did not set use_sim_time: ")


@pytest.mark.ros
@pytest.mark.parametrize(
    ("arguments", "code", "sentence"),
    [
        (["topic", "echo", "/nobody", "--timeout", "0.5"], 1, "topic /nobody does not exist"),
        (["topic", "pub", "/nobody", TYPE, "--timeout", "0.5"], 1, "/nobody has no subscriber"),
        (["topic", "pub", "/x", TYPE, "{speed: 1}"], 2, "speed is not a field of the message"),
        (["topic", "pub", "/x", TYPE, "{data: ["], 2, "<data>:1"),
        (["topic", "pub", "/x", "std_msgs/msg/Nothing"], 2, "this ROS installation lacks the interface std_msgs"),
        (["param", "get", "/peer", "speed"], 1, "/peer has no parameter speed; see: canopen-control ros param list"),
        (["param", "set", "/peer", "speed", "{a: 1}"], 1, "/peer has no parameter speed"),
        (["param", "set", "/peer", "use_sim_time", "{a: 1}"], 2, "a parameter cannot be {'a': 1}: give true, false"),
        (["param", "list", "/nobody", "--timeout", "0.5"], 1, "no node serves /nobody/list_parameters"),
        (["service", "call", "/nobody", "std_srvs/srv/Trigger", "--timeout", "0.5"], 1, "no node serves /nobody"),
    ],
)
def test_what_does_not_work_is_one_sentence(program, arguments, code, sentence):
    text = program(*arguments, code=code)
    assert text.startswith(f"canopen-control: {sentence}")
    assert "Traceback" not in text


@pytest.mark.ros
def test_the_bridge_is_started_by_hand_with_arguments_for_ros(program):
    text = program("bridge", "--name", "nobody", "--ros-args", "-r", "__ns:=/x", code=1)
    assert text.startswith("canopen-control: no robot 'nobody' is running; start one: ")


@pytest.mark.process
def test_without_ros_it_suggests_how_to_get_it(tmp_path):
    code = f"""
import importlib.util, sys
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, *more: None if name == "rclpy" else found(name, *more)
from canopen_control.cli.main import main
sys.exit(main({json.dumps(["ros", "topic", "list"])}))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("canopen-control: ROS 2 is not installed")
    assert 'pip install "canopen-control[ros]"' in done.stderr


def test_data_is_yaml_and_a_repeated_key_is_an_error():
    assert _data("{data: [10.0, 10]}") == {"data": [10.0, 10]}
    assert _data("{}") == {}
    with pytest.raises(ConfigError, match="duplicate key"):
        _data("{data: [1], data: [2]}")
