"""The API as seen by a client, byte by byte, in simulated time."""

from __future__ import annotations

import os
import re

import pytest
from support.apiclient import Client
from support.busalone import AloneBench, write_drives
from support.generic import write_generic
from support.observers import Observer
from support.robots import FORWARD, LEFT, RIGHT, Bench

from canopen_control.runtime import api
from canopen_control.runtime.api import ApiServer
from canopen_control.runtime.core import RobotState
from canopen_control.runtime.robot_clock import WallClock
from canopen_control.runtime.status import state_sample

BASE_OF_SIMULATION = "diff_drive_base_controller"
CYCLE = 0.02


class Simulated(Bench):
    """The bundled robot of Gazebo's plugin, with its API and a client of it."""

    def __init__(self, **how):
        super().__init__("simulation", config="diffbot_sim", drives=(), **how)
        self.api = ApiServer(self.robot)
        self.start()
        self.client = Client(self)
        self.run(500)

    def twist(self, speed):
        answer = self.client.ask("twist", controller=BASE_OF_SIMULATION, linear=speed, angular=0.0, dead_man=True)
        assert answer.get("result") == {}, answer

    def drive(self, speed, cycles):
        for _ in range(cycles):
            self.twist(speed)
            self.run(20)

    def ask(self, method, **params):
        answer = self.client.ask(method, **params)
        return answer["result"] if "result" in answer else answer["error"]["message"]

    @property
    def seconds(self):
        return self.ask("simulation")["seconds"]

    @property
    def pose(self):
        pose = self.robot.manager.get(BASE_OF_SIMULATION).pose
        return pose.x, pose.y, pose.heading

    @property
    def wheels(self):
        return [self.robot.registry.state(f"{side}_wheel_joint/position").value for side in ("left", "right")]


@pytest.fixture(params=[False, True], ids=["motors", "physics"])
def robot(request):
    bench = Simulated(simulate=request.param)
    yield bench
    bench.client.close()
    bench.api.close()
    bench.close()


def test_while_it_is_paused_time_and_joints_stand(robot):
    robot.drive(0.3, 40)
    assert robot.ask("pause_simulation", paused=True)["paused"]
    seconds, wheels = robot.seconds, robot.wheels
    robot.run(3000)
    assert (robot.seconds, robot.wheels) == (seconds, wheels)
    assert "canopen-control world play" in robot.ask("status")["hint"]


def test_steps_are_cycles_and_exactly_as_many_as_were_asked_for(robot):
    assert "pause it first" in robot.ask("step_simulation", steps=1)
    robot.ask("pause_simulation", paused=True)
    before = robot.seconds
    for steps in (1, 3, 250):
        before += steps * CYCLE
        assert robot.ask("step_simulation", steps=steps)["seconds"] == pytest.approx(before, abs=1e-9)
        robot.run(500)
        assert robot.seconds == pytest.approx(before, abs=1e-9)


def test_what_is_commanded_in_a_pause_is_stepped_and_expires_in_simulated_time(robot):
    robot.ask("pause_simulation", paused=True)
    robot.run(2000)
    robot.twist(0.3)
    robot.run(2000)  # its time-out is 0.5 s
    start = robot.pose[0]
    robot.ask("step_simulation", steps=20)
    moved = robot.pose[0] - start
    assert moved > 0.05
    robot.ask("step_simulation", steps=100)
    rested = robot.pose[0]
    robot.ask("step_simulation", steps=20)
    assert robot.pose[0] == pytest.approx(rested, abs=1e-3)


def test_a_command_from_before_is_not_executed_when_it_continues(robot):
    robot.ask("pause_simulation", paused=True)
    robot.twist(0.3)
    robot.ask("pause_simulation", paused=False)
    start = robot.pose[0]
    robot.run(300)
    assert robot.pose[0] == pytest.approx(start, abs=1e-3)
    robot.drive(0.3, 20)
    assert robot.pose[0] > start + 0.02


def test_after_a_pause_the_time_continues_where_it_stood(robot):
    robot.ask("pause_simulation", paused=True)
    before = robot.seconds
    robot.run(5000)
    robot.ask("pause_simulation", paused=False)
    robot.run(100)
    assert robot.seconds == pytest.approx(before + 0.1, abs=0.05)


def test_reset_brings_back_the_start_and_enables_nothing(robot):
    start = robot.wheels
    robot.ask("switch", deactivate=["joint_state_broadcaster"], activate=[])
    robot.drive(0.3, 60)
    before, states = robot.seconds, robot.robot.manager.states
    assert robot.pose[0] > 0.1
    robot.ask("reset_simulation")
    assert robot.robot.manager.states == states
    robot.run(100)
    assert robot.wheels == pytest.approx(start, abs=1e-3)
    assert robot.pose == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    assert robot.seconds > before
    robot.events.clear()
    assert "key frame 'home'" in robot.ask("reset_simulation", keyframe="home")
    assert robot.events == []


def test_a_disturbance_is_reported_with_its_client(robot):
    if not robot.ask("simulation")["changeable"]:
        assert "simple motors move" in robot.ask("push", force=[0.0, 30.0, 0.0])
        return
    robot.events.clear()
    assert robot.ask("payload", mass=5.0) == {}
    assert robot.ask("push", force=[0.0, 30.0, 0.0], on="base_link") == {}
    assert robot.ask("block", joint="left_wheel_joint") == {}
    assert robot.ask("grip", friction=0.2) == {}
    texts = [event.text for event in robot.events if event.kind == "world"]
    assert [text.split(",")[0].split(" (by client")[0] for text in texts] == [
        "a payload of 5 kg is put on the heaviest link",
        "base_link is pushed with 0",
        "left_wheel_joint is blocked",
        "the floor has a friction of 0.2",
    ]
    assert all(re.search(r"\(by client .*\)$", text) for text in texts)
    robot.drive(0.3, 50)
    left, right = robot.wheels
    assert abs(left) < 0.05 < 1.0 < right
    robot.ask("reset_simulation")
    robot.drive(0.3, 50)
    assert robot.wheels[0] == pytest.approx(robot.wheels[1], rel=0.1)
    robot.events.clear()
    assert "no drive moves a joint 'left'; known: left_wheel_joint" in robot.ask("block", joint="left")
    assert robot.events == []


def test_a_stop_and_the_end_work_in_a_pause(robot):
    robot.ask("pause_simulation", paused=True)
    robot.twist(0.3)
    assert robot.ask("stop") == {}
    start = robot.pose[0]
    robot.ask("step_simulation", steps=20)
    assert robot.pose[0] == pytest.approx(start, abs=1e-3)
    robot.robot.shutdown("the test is over")
    robot.run(100)
    assert robot.robot.state.value == "stopped"


def test_stamps_are_the_simulations_after_every_pause(robot):
    for _ in range(2):
        robot.ask("pause_simulation", paused=True)
        robot.run(700)
        robot.ask("step_simulation", steps=2)
        robot.ask("pause_simulation", paused=False)
        robot.run(60)
        sample = state_sample(robot.robot)
        reported = sample.samples["joint_state_broadcaster"].time - sample.sim_epoch
        assert reported == pytest.approx(sample.sim_time, abs=1e-6)


@pytest.mark.parametrize(("method", "params"), [("simulation", {}), ("step_simulation", {"steps": 1})])
def test_drives_on_a_bus_have_a_time_of_their_own(robby, client, method, params):
    assert "robby has drives on a bus" in client.ask(method, **params)["error"]["message"]


BASE = "robby_base_controller"
KIND = "velocity_controllers/JointGroupVelocityController"


@pytest.fixture
def base(client):
    client.ask("load", controller=BASE)
    return BASE


def read(client, name):
    return {item["name"]: item for item in client.ask("parameters", controller=name)["result"]}


def put(client, controller, **values):
    expected = [
        {"name": name.replace("__", "."), "kind": kind, "value": value} for name, (kind, value) in values.items()
    ]
    return client.ask("set_parameters", controller=controller, values=expected)


def test_a_controllers_parameters_have_types_and_state_which_may_be_set(client, base):
    result = read(client, base)
    assert (result["wheel_radius"]["kind"], result["wheel_radius"]["read_only"]) == ("double", True)
    assert "read_only" not in result["cmd_vel_timeout"]
    assert (result["cmd_vel_timeout"]["low"], result["cmd_vel_timeout"]["high"]) == (0.0, 1e9)
    assert read(client, FORWARD)["interface_name"]["value"] == "velocity"
    assert read(client, FORWARD)["update_rate"]["value"] == 50, "the manager's"


def test_what_is_set_is_read_back_and_reaches_the_controller(robby, client, base):
    assert put(client, base, cmd_vel_timeout=("double", 1.5), linear__x__max_velocity=("double", 0.3))["result"] == {}
    assert read(client, base)["cmd_vel_timeout"]["value"] == 1.5
    assert robby.robot.manager.get(base).command_timeout.limit_ns == 1_500_000_000
    client.ask("configure", controller=base)
    assert read(client, base)["cmd_vel_timeout"]["value"] == 1.5, "it is kept when it is configured again"
    client.ask("unload", controller=base)
    client.ask("load", controller=base)
    assert read(client, base)["cmd_vel_timeout"]["value"] != 1.5, "loaded again it is that of the file"


def test_one_that_is_wrong_keeps_all_as_they_were(robby, client, base):
    before = read(client, base)
    answer = put(client, base, cmd_vel_timeout=("double", 1.5), linear__x__max_velocity=("double", -1.0))
    assert "linear.x.max_velocity: -1.0 is out of range" in answer["error"]["message"]
    answer = put(client, base, cmd_vel_timeout=("double", 1.5), wheel_radius=("double", 1.0))
    assert "'wheel_radius' cannot be set because it is read-only" in answer["error"]["message"]
    assert read(client, base) == before
    assert robby.robot.manager.get(base).params.cmd_vel_timeout == before["cmd_vel_timeout"]["value"]


def test_a_limit_is_taken_away_by_a_nan_and_a_text_is_not_a_number(client, base):
    assert put(client, base, linear__x__min_velocity=("double", ".nan"))["result"] == {}
    assert read(client, base)["linear.x.min_velocity"]["value"] == ".nan"
    assert "'linear.x.max_jerk'" in put(client, base, linear__x__max_jerk=("double", "fast"))["error"]["message"]


def test_a_controller_that_is_not_loaded_has_none(client):
    assert client.ask("parameters", controller="nobody")["error"]["kind"] == "UnknownName"
    assert put(client, "nobody", x=("double", 1.0))["error"]["kind"] == "UnknownName"


def test_the_managers_parameters_are_those_of_its_block_and_the_types(robby, client):
    result = read(client, "controller_manager")
    assert result["update_rate"]["value"] == robby.robot.setup.controllers.update_rate
    assert result[f"{BASE}.type"]["value"] == "diff_drive_controller/DiffDriveController"
    answer = put(client, "controller_manager", update_rate=("integer", 10))
    assert "'update_rate' cannot be set because it is read-only" in answer["error"]["message"]
    answer = put(client, "controller_manager", nonsense=("integer", 10))
    assert "'nonsense' cannot be set because it was not declared" in answer["error"]["message"]


def test_a_spawners_file_makes_a_controller_that_moves(robby, client, tmp_path):
    path = tmp_path / "wheels.yaml"
    path.write_text(
        "wheels:\n  ros__parameters:\n    joints: [left_wheel_joint, right_wheel_joint]\n    command_timeout: 0.5\n"
    )
    assert put(client, "controller_manager", wheels__params_file=("string_array", [str(path)]))["result"] == {}
    assert put(client, "controller_manager", wheels__type=("string", KIND))["result"] == {}
    assert read(client, "controller_manager")["wheels.params_file"]["value"] == [str(path)]
    options = ["-r", "~/commands:=/speeds"]
    put(client, "controller_manager", wheels__node_options_args=("string_array", options))
    assert read(client, "controller_manager")["wheels.node_options_args"]["value"] == options
    assert client.ask("load", controller="wheels")["result"] == {}
    listed = {item["name"]: item for item in client.ask("controllers")["result"]}
    assert (listed["wheels"]["node_options"], listed[FORWARD]["node_options"]) == (options, [])
    assert read(client, "wheels")["command_timeout"]["value"] == 0.5
    client.ask("switch", activate=["wheels"], deactivate=[FORWARD])
    assert "wheels" in robby.robot.manager.active


def states(client):
    return {item["name"]: item["state"] for item in client.ask("controllers")["result"]}


def test_a_controller_is_loaded_switched_and_unloaded(robby, client):
    assert "forward_command_controller/ForwardCommandController" in client.ask("controller_types")["result"]
    assert client.ask("load", controller=BASE)["result"] == {}
    assert states(client)[BASE] == "inactive"
    assert client.ask("switch", activate=[BASE], deactivate=[FORWARD])["result"] == {}
    assert (states(client)[BASE], states(client)[FORWARD]) == ("active", "inactive")
    assert "active" in client.ask("unload", controller=BASE)["error"]["message"]
    client.ask("switch", activate=[FORWARD], deactivate=[BASE])
    assert client.ask("configure", controller=BASE)["result"] == {}
    assert client.ask("unload", controller=BASE)["result"] == {}
    assert BASE not in states(client)


def test_ros_loads_a_controller_before_it_is_configured(client):
    assert client.ask("load", controller=BASE, configure=False)["result"] == {}
    assert states(client)[BASE] == "unconfigured"
    result = {item["name"]: item for item in client.ask("parameters", controller=BASE)["result"]}
    assert (result["wheel_radius"]["value"], result["wheel_radius"]["read_only"]) == (0.035, True)
    assert "it is unconfigured" in client.ask("switch", activate=[BASE], deactivate=[FORWARD])["error"]["message"]
    assert client.ask("configure", controller=BASE)["result"] == {}
    assert states(client)[BASE] == "inactive"


def test_the_hardware_is_listed_with_what_is_claimed(client):
    (component,) = client.ask("hardware")["result"]
    assert component["state"] == "active"
    assert component["plugin"].endswith("RobotSystem")
    claimed = {item["name"]: item["claimed"] for item in component["command_interfaces"]}
    assert claimed == {"left_wheel_joint/velocity": True, "right_wheel_joint/velocity": True}
    assert all(item["available"] for item in component["state_interfaces"])


def test_inactive_hardware_commands_nothing_and_its_controllers_stop(robby, client):
    robby.hold(10.0, 10.0, ms=300)
    name = client.ask("hardware")["result"][0]["name"]
    assert client.ask("set_hardware_state", component=name, state="inactive")["result"] == {"state": "inactive"}
    assert states(client)[FORWARD] == "inactive"
    robby.run(1500)
    assert robby.speed(LEFT) == 0
    assert client.ask("set_hardware_state", component=name, state="active")["result"] == {"state": "active"}
    robby.run(500)
    assert not robby.joint(LEFT).machine.enabled


def test_best_effort_omits_unknown_names_and_reports_them(robby, client):
    answer = client.ask("switch", activate=["nobody", BASE], deactivate=["nothing", FORWARD], strict=False)
    assert answer["result"] == {}
    assert (states(client)[BASE], states(client)[FORWARD]) == ("active", "inactive")
    robby.run(50)
    assert robby.texts("left_out") == [
        "the switch ignores unknown controllers: nobody, nothing; see canopen-control controller list"
    ]
    answer = client.ask("switch", activate=["nobody", FORWARD], deactivate=[BASE], strict=True)
    assert "no controller 'nobody'" in answer["error"]["message"]
    assert (states(client)[BASE], states(client)[FORWARD]) == ("active", "inactive"), "a strict one changes nothing"


def test_hardware_is_unconfigured_and_configured_again(robby, client):
    robby.hold(10.0, 10.0, ms=300)
    name = client.ask("hardware")["result"][0]["name"]
    assert client.ask("set_hardware_state", component=name, state="unconfigured")["result"] == {"state": "unconfigured"}
    robby.run(1500)
    assert robby.speed(LEFT) == 0
    assert states(client)[FORWARD] == "inactive"
    (component,) = client.ask("hardware")["result"]
    assert not any(item["available"] for item in component["state_interfaces"])
    assert "must be active" in client.ask("switch", activate=[FORWARD])["error"]["message"]
    assert client.ask("set_hardware_state", component=name, state="inactive")["result"] == {"state": "inactive"}
    assert client.ask("set_hardware_state", component=name, state="active")["result"] == {"state": "active"}
    assert client.ask("switch", activate=[FORWARD])["result"] == {}


def test_the_server_sends_its_identity_first(client):
    hello = client.hello["hello"]
    assert (hello["robot"], hello["protocol"]) == ("robby", 2)
    assert hello["pid"] > 0


def test_status_has_the_documented_shape(robby, client):
    robby.hold(0.0, 0.0, ms=200)
    status = client.ask("status")["result"]
    assert status["robot"] == "robby"
    assert status["state"] == "running"
    assert set(status["cycle"]) >= {"period_s", "count", "missed"}
    assert set(status["buses"]["can"]) >= {"channel", "rx", "tx", "lost", "load"}
    node = status["nodes"]["left_drive"]
    assert (node["bus"], node["node_id"], node["nmt_state"], node["error"]) == ("can", 3, "OPERATIONAL", None)
    assert set(node["axes"][0]) >= {"cia402_state", "statusword", "mode", "error"}
    assert node["axes"][0]["cia402_state"] == "OPERATION_ENABLED"
    joint = status["joints"]["left_wheel_joint"]
    assert set(joint) == {"name", "position", "velocity", "effort", "command", "others", "tracking"}
    assert set(joint["tracking"]) >= {"interface", "error_max", "error_rms", "repeated", "skipped"}
    assert status["joints"]["left_wheel_joint"]["effort"] is None
    assert status["controllers"][FORWARD] == "active"
    assert {step["step"] for step in status["boot"]} == {"reset", "identify", "configure", "heartbeat", "start"}
    assert status["events"]


def test_subscribers_receive_the_pdo_mappings(client):
    layout = client.ask("layout")["result"]["buses"]["can"]
    assert layout["channel"] == "memory:api"
    left = next(node for node in layout["nodes"] if node["name"] == "left_drive")
    assert [(pdo["direction"], pdo["cob_id"]) for pdo in left["pdos"]] == [
        ("rpdo", 0x203),
        ("rpdo", 0x303),
        ("tpdo", 0x183),
        ("tpdo", 0x283),
    ]


def test_a_command_moves_the_wheels(robby, client):
    assert client.ask("command", controller=FORWARD, values=[10, 10], source="test") == {"id": 1, "result": {}}
    robby.run(500)
    assert robby.velocity(LEFT) == pytest.approx(10.0, rel=0.01)
    assert client.ask("status")["result"]["commander"] == "test"


def test_two_clients_that_command_one_controller_alternately_are_named_in_one_warning(robby, client):
    other, mine = Client(robby), os.getpid()
    for _ in range(20):
        for who, source, speed in ((client, "teleop", 1.0), (other, "command", 2.0)):
            assert who.ask("command", controller=FORWARD, values=[speed, speed], source=source)["result"] == {}
            robby.run(50)
    other.close()
    (reported,) = [event for event in client.ask("status")["result"]["events"] if event["kind"] == "two_senders"]
    assert (reported["level"], reported["controller"]) == ("warning", FORWARD)
    assert reported["text"].startswith(
        f"{FORWARD}: teleop (pid {mine}) and command (pid {mine}) command it alternately"
    )


def test_one_client_with_several_sources_is_one_sender(robby, client):
    """As the bridge is: the services `target` of two drives command one controller in turn."""
    for turn in range(20):
        source = ("ros left_drive/target", "ros right_drive/target")[turn % 2]
        client.ask("command", controller=FORWARD, values=[1.0, 1.0], source=source)
        robby.run(50)
    assert robby.texts("two_senders") == []


def test_the_answer_to_a_command_names_the_joints_that_do_not_follow(robby, client):
    assert client.ask("axis", action="halt", node="left_drive")["result"] == {}
    reason = "left_drive is halted: canopen-control axis enable left_drive"
    done = client.ask("command", controller=FORWARD, values=[10, 10])["result"]
    assert done == {"idle": {"left_wheel_joint": reason}}
    assert client.ask("command", controller=FORWARD, values=[0, 10])["result"] == {}


@pytest.mark.parametrize(
    ("method", "params", "answer"),
    [
        ("dance", {}, "LocalProtocolError: no method 'dance'"),
        ("command", {}, "LocalProtocolError: missing required field `controller`"),
        ("command", {"controller": FORWARD}, "LocalProtocolError: missing required field `values`"),
        ("command", {"controller": "nobody", "values": [1.0]}, "UnknownName: nobody"),
        ("command", {"controller": FORWARD, "values": [1.0]}, "WrongValueCount: "),
        (
            "command",
            {"controller": FORWARD, "values": [1, "slow"]},
            "LocalProtocolError: Expected `float`, got `str` - at `$.values[1]`",
        ),
        (
            "command",
            {"controller": FORWARD, "values": 3},
            "LocalProtocolError: Expected `array`, got `int` - at `$.values`",
        ),
        ("command", {"controller": FORWARD, "values": [1, 1], "speed": 3}, "LocalProtocolError: unknown field `speed`"),
        ("twist", {"controller": "nobody", "linear": 0, "angular": 0}, "UnknownName: nobody"),
        ("subscribe", {"state_rate": -1}, "LocalProtocolError: state_rate"),
        ("axis", {"action": "explode", "node": "all"}, "UnknownName: enable"),
        ("axis", {"action": "enable", "node": "nobody"}, "UnknownName: left_drive"),
        (
            "axis",
            {"action": "enable", "node": "left_drive", "joint": "right_wheel_joint"},
            "UnknownName: left_drive has no joint 'right_wheel_joint'",
        ),
        (
            "axis",
            {"action": "mode", "node": "left_drive", "mode": "FLY"},
            "UnknownName: no mode of operation 'FLY'; available: PP",
        ),
        ("touch_probe", {"node": "nobody"}, "UnknownName: no node 'nobody'"),
        ("touch_probe", {"node": "left_drive"}, "ControlError: node 3 (left_drive) has no touch probe"),
        ("load", {"controller": "nobody"}, "UnknownName: nobody"),
        ("configure", {"controller": "nobody"}, "UnknownName: nobody"),
        ("switch", {"activate": ["nobody"]}, "UnknownName: nobody"),
        ("switch", {"deactivate": ["nobody"]}, "UnknownName: nobody"),
        ("set_hardware_state", {"component": "nobody", "state": "active"}, "UnknownName: nobody"),
        ("set_hardware_state", {"component": "robby", "state": "finalized"}, "ControlError: inactive"),
        ("nmt", {"command": "explode", "node": "all"}, "UnknownName: reset-node"),
        ("nmt", {"command": "stop", "node": "nobody"}, "UnknownName: no node 'nobody'"),
        ("sdo_read", {"node": "left_drive"}, "LocalProtocolError: index"),
        ("sdo_read", {"node": "nobody", "index": 0x1000}, "UnknownName: no node 'nobody'"),
        ("sdo_write", {"node": "left_drive", "index": 0x6083, "data": "xyz"}, "LocalProtocolError: base64"),
        ("sdo_write", {"node": "nobody", "index": 0x6083, "data": "AA=="}, "UnknownName: no node 'nobody'"),
        ("pdo_write", {"node": "nobody", "index": 0x6083, "data": "AA=="}, "UnknownName: no node 'nobody'"),
        (
            "pdo_write",
            {"node": "left_drive", "index": 0x6083, "data": "AA=="},
            "ControlError: 0x6083:00 is not mapped in an RPDO",
        ),
    ],
)
def test_what_cannot_be_done_is_refused_with_kind_and_sentence_and_the_robot_goes_on(
    robby, client, method, params, answer
):
    error = client.ask(method, **params)["error"]
    kind, words = answer.split(": ", 1)
    assert error["kind"] == kind
    assert words in error["message"]
    assert client.ask("status")["result"]["state"] == "running"


@pytest.mark.parametrize("line", [b"not json\n", b"[1, 2]\n", b"\xff\xfe\n"])
def test_garbage_ends_that_connection_only(robby, client, line):
    other = Client(robby)
    other.socket.send(line)
    assert "error" in other.next()
    other.close()
    assert client.ask("status")["result"]["state"] == "running"


def test_a_notification_is_not_answered(robby, client):
    client.send(method="command", params={"controller": FORWARD, "values": [3.0, 3.0]})
    client.send(method="command", params={"controller": "nobody", "values": [3.0]})
    robby.run(500)
    assert client.messages() == []
    assert robby.velocity(LEFT) == pytest.approx(3.0, rel=0.01)


def test_the_state_stream_comes_at_its_rate(robby, client):
    client.ask("subscribe", state_rate=10, events=False)
    robby.run(1000)
    states = client.messages()
    assert len(states) == 10
    assert states[0]["state"]["joints"]["left_wheel_joint"]["position"] is not None


def test_what_clients_are_notified_is_made_between_the_cycles(robby, client, monkeypatch):
    order = []
    client.ask("subscribe", state_rate=50)
    robby.robot.observers.append(Observer(after_cycle=lambda _now: order.append("cycle")))
    monkeypatch.setattr(api, "state_sample", lambda robot: order.append("state") or state_sample(robot))
    robby.run(100)
    reported = [order[at - 1 : at + 2] for at, what in enumerate(order[:-1]) if what == "state"]
    assert reported
    assert all(item == ["cycle", "state", "cycle"] for item in reported)
    assert order[0] == "cycle"


def test_events_come_as_they_happen(robby, client):
    client.ask("subscribe", state_rate=None, events=True)
    robby.power_off(LEFT)
    robby.run(1000)
    kinds = [message["event"]["kind"] for message in client.messages()]
    assert "heartbeat_lost" in kinds
    assert "stop" in kinds


def test_a_subscriber_to_requests_receives_those_of_other_clients(robby, client):
    watcher = Client(robby)
    watcher.ask("subscribe", requests=True)
    client.ask("command", controller=FORWARD, values=[1, 2])
    client.ask("status")
    client.ask("command", controller="nobody", values=[1, 2])
    reported = [message["asked"] for message in watcher.messages()]
    watcher.close()
    assert [(item["method"], item["params"]) for item in reported] == [
        ("command", {"controller": FORWARD, "values": [1, 2]})
    ]
    assert reported[0]["time"] > 0


def test_two_subscribers_of_one_rate_get_the_same_sample(robby, client):
    other = Client(robby)
    for item in (client, other):
        item.ask("subscribe", state_rate=5)
    robby.run(400)
    assert client.messages()[-1] == other.messages()[-1]
    other.close()


@pytest.mark.rest
def test_a_client_that_never_reads_is_dropped_with_an_event_and_the_cycle_continues(robby):
    stalled = Client(robby)
    stalled.ask("subscribe", state_rate=50, events=True)
    robby.until(lambda: robby.texts("client_dropped"), ms=60_000)
    assert "too slowly" in robby.texts("client_dropped")[0]
    assert robby.robot.pacer.missed == 0
    stalled.close()


def test_stop_and_axis_are_answered_when_they_are_done(robby, client):
    robby.hold(10.0, 10.0, ms=300)
    assert client.ask("stop") == {"id": 1, "result": {}}
    assert robby.speed(LEFT) == 0
    assert client.ask("axis", action="enable", node="3") == {"id": 1, "result": {}}
    assert robby.joint(LEFT).enabled
    assert client.ask("axis", action="disable", node="left_drive") == {"id": 1, "result": {}}
    assert not robby.joint(LEFT).machine.enabled


def test_an_axis_request_is_reported_with_its_client(robby, client):
    client.ask("axis", action="disable", node="left_drive", source="monitor")
    client.ask("axis", action="enable", node="all")
    client.ask("axis", action="enable", node="nobody")
    client.ask("axis", action="mode", node="left_drive", joint="left_wheel_joint", mode="PV", source="jog")
    reported = [event for event in robby.events if event.kind == "axis_asked"]
    assert [event.node for event in reported] == ["left_drive", "", "left_drive"]
    assert reported[2].text == "jog requested mode PV of left_drive (left_wheel_joint)"
    assert reported[0].text == "monitor requested disable of left_drive"
    assert re.fullmatch(r"client .* \(pid \d+\) requested enable of all axes", reported[1].text)


def test_an_axis_that_a_base_controller_holds_is_answered_for_with_the_whole_base(robby, client):
    client.ask("switch", activate=["robby_base_controller"], deactivate=["robby_forward_controller"])
    robby.until(lambda: robby.joint(LEFT).enabled)
    reported = "robby_base_controller moves left_drive and right_drive together: disable applies to all of them"
    assert client.ask("axis", action="disable", node="left_drive")["result"] == {"text": reported}
    assert not robby.joint(RIGHT).machine.enabled
    assert client.ask("axis", action="enable", node="all")["result"] == {}


def test_shutdown_is_answered_and_then_the_robot_ends(robby, client):
    assert client.ask("shutdown") == {"id": 1, "result": {}}
    robby.until(lambda: robby.robot.state is RobotState.STOPPED)


def test_a_client_that_dies_leaves_its_command_to_the_timeout(robby):
    client = Client(robby)
    client.ask("command", controller=FORWARD, values=[10, 10])
    client.close()
    robby.run(1500)
    assert robby.velocity(LEFT) == pytest.approx(10.0, rel=0.01)
    robby.run(1000)
    assert robby.speed(LEFT) == 0


def test_the_description_and_the_controllers_are_there_for_the_asking(client):
    assert "<robot" in client.ask("description")["result"]["urdf"]
    controllers = {item["name"]: item for item in client.ask("controllers")["result"]}
    assert controllers[FORWARD]["topic"] == "commands"
    assert controllers["joint_state_broadcaster"]["topic"] is None


def test_a_base_is_driven_by_stamped_twists_and_put_somewhere_else():
    base = Bench("apibase", controllers=["robby_base_controller"])
    base.api = ApiServer(base.robot)
    base.start()
    client = Client(base)
    now = (base.reactor.now() + base.robot.wall_offset_ns) / 1e9
    twist = {"controller": "robby_base_controller", "linear": 0.2, "angular": 0.0}
    assert client.ask("twist", **twist, stamp=now)["result"] == {}
    assert "0.5 s" in client.ask("twist", **twist, stamp=now - 1.0)["error"]["message"]
    pose = {"x": 1.0, "y": 2.0, "heading": 0.5}
    assert client.ask("set_odometry", controller="robby_base_controller", **pose)["result"] == {}
    assert base.robot.manager.get("robby_base_controller").odometry.heading == 0.5
    refused = client.ask("set_odometry", controller="joint_state_broadcaster", **pose)["error"]
    assert "has no odometry" in refused["message"]
    refused = client.ask("set_feed_forward", controller="robby_base_controller", enabled=True)["error"]
    assert "has no feed-forward to switch" in refused["message"]
    refused = client.ask("set_measured_states", controller="robby_base_controller", values=[0.0])["error"]
    assert "accepts no measured states" in refused["message"]
    client.close()
    base.api.close()
    base.close()


@pytest.mark.parametrize("step", [-2.0, 3600.0])
def test_stamps_are_judged_by_the_time_that_the_clock_was_set_to(step):
    base = Bench("apisteps", controllers=["robby_base_controller"])
    set_to = [0.0]
    base.robot.wall = WallClock(base.reactor.now, follows=True, unix=lambda: base.reactor.now() + int(set_to[0] * 1e9))
    base.api = ApiServer(base.robot)
    base.start()
    client = Client(base)
    twist = {"controller": "robby_base_controller", "linear": 0.2, "angular": 0.0}
    assert client.ask("twist", **twist, stamp=base.reactor.now() / 1e9)["result"] == {}
    set_to[0] = step
    now = base.reactor.now() / 1e9 + step
    assert client.ask("twist", **twist, stamp=now)["result"] == {}
    assert "check the clocks" in client.ask("twist", **twist, stamp=now - 1.0)["error"]["message"]
    assert state_sample(base.robot).time == pytest.approx(now, abs=0.5)
    assert [event.kind for event in base.robot.events.recent].count("clock_step") == 1
    client.close()
    base.api.close()
    base.close()


def test_a_command_that_is_not_finite_is_refused_as_that(robby, client):
    refused = client.ask("command", controller=FORWARD, values=[1.0, None])["error"]
    assert "NaN or an infinite number" in refused["message"]
    assert "$.values[1]" in refused["message"]


def test_a_client_may_publish_an_event_with_a_level(robby, client):
    client.ask("subscribe", events=True)
    client.send(method="tell", params={"kind": "ros_warning", "text": "dropped", "level": "warning"})
    assert client.next()["event"]["level"] == "warning"
    assert "no level" in client.ask("tell", kind="x", text="y", level="loud")["error"]["message"]


def test_a_command_to_a_controller_that_is_not_active_is_reported_once(robby, client):
    for _ in range(2):
        assert (
            "activate it"
            in client.ask("command", controller="robby_base_controller", values=[0.1, 0.0])["error"]["message"]
        )
    robby.run(20)
    assert [event.kind for event in robby.robot.events.recent].count("refused") == 1


def test_a_client_may_publish_an_event_to_all_subscribers(robby, client):
    client.ask("subscribe", events=True)
    client.send(method="tell", params={"kind": "flight", "text": "it is\nwritten"})
    event = client.next()["event"]
    assert (event["kind"], event["level"], event["text"], event["node"]) == ("flight", "info", "it is written", None)


@pytest.mark.parametrize(
    ("kind", "text"), [("", "x"), ("two words", "x"), ("x", ""), ("x", "y" * 501), ("x", "\x1b[2J")]
)
def test_what_a_client_reports_is_a_word_and_a_printable_line(client, kind, text):
    assert "printable" in client.ask("tell", kind=kind, text=text)["error"]["message"]


def test_subscribers_and_holders_leave_connections_for_others(client, robby, monkeypatch):
    monkeypatch.setattr(api, "MAX_KEPT", 1)
    other = Client(robby)
    assert client.ask("subscribe", events=True)["result"] == {}
    assert client.ask("subscribe", state_rate=10)["result"] == {}
    assert "end one of them" in other.ask("subscribe", events=True)["error"]["message"]
    twist = {"controller": FORWARD, "values": [1.0, 1.0]}
    assert "end one of them" in other.ask("command", **twist, dead_man=True)["error"]["message"]
    assert other.ask("command", **twist)["result"] == {}
    other.close()


def test_values_that_are_taken_for_something_else_than_they_are_now_are_refused(tmp_path):
    drives = AloneBench("target", config=write_drives(tmp_path), drives=(2, 3))
    drives.api = ApiServer(drives.robot)
    drives.start()
    client = Client(drives)
    drives.enable("drive_one")
    drives.mode("PV")
    drives.run(50)
    speed = {"controller": "drive_one", "values": [2.0], "interface": "velocity"}
    assert client.ask("command", **speed)["result"] == {}
    drives.mode("PP")
    drives.run(50)
    here = drives.at("position")
    assert "currently accepts position, not velocity" in client.ask("command", **speed)["error"]["message"]
    drives.run(1000)
    assert drives.at("position") == pytest.approx(here, abs=0.05)
    assert "no controller" in client.ask("command", **{**speed, "controller": "nobody"})["error"]["message"]
    client.close()
    drives.api.close()
    drives.close()


@pytest.mark.parametrize("waits", [True, False])
def test_the_homing_of_a_client_that_is_gone_ends(tmp_path, waits):
    servo = Bench("homes", config=write_generic(tmp_path), drives=(2, 3), controllers=["velocity"])
    server = ApiServer(servo.robot)
    servo.start()
    homing, other, joint = Client(servo), Client(servo), servo.joint(2)
    request = {"method": "axis", "params": {"action": "home", "node": "drive_one", "method": 17}}
    homing.send(**({"id": 1} if waits else {}), **request)
    servo.until(lambda: abs(servo.speed(2)) > 100)
    other.close()
    servo.run(20)
    assert joint.homing is not None
    homing.close()
    servo.run(60)
    assert (joint.homing is None) is waits
    servo.run(1000)
    assert joint.machine.enabled is not waits
    assert servo.texts("commander_gone") == (
        ["the client that enables or homes one is gone, so its drives are stopped and disabled"] if waits else []
    )
    server.close()
    servo.close()
