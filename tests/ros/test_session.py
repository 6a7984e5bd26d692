from __future__ import annotations

import json
import time
from itertools import pairwise
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.ros import eventually

from canopen_control.errors import RemoteError
from canopen_control.ros.session import Mailbox, RosSession, RosTime, uses_sim_time
from canopen_control.rpc.client import ENDLESS
from canopen_control.rpc.messages.parameters import ParameterReading
from canopen_control.rpc.messages.robot import AxisRequest, GetNodes
from canopen_control.rpc.messages.samples import ImuSample, JointStatesSample, OdometrySample
from canopen_control.rpc.messages.state import RobotEvent, StateSample

TOPIC_OF_SIM_CLOCK = "/clock"


@pytest.fixture(scope="module")
def listening(stage):
    stage.peer.order("subscribe", topic=TOPIC_OF_SIM_CLOCK, of="rosgraph_msgs/msg/Clock", qos="default")
    return stage


@pytest.mark.ros
def test_a_simulated_robot_reports_its_time(listening, fresh):
    fresh.robot.more = {"sim_time": 12.5}
    message = fresh.peer.message(TOPIC_OF_SIM_CLOCK)
    assert message["clock"] == {"sec": 12, "nanosec": 500_000_000}
    fresh.robot.more = {"sim_time": 13.0}
    fresh.peer.message(TOPIC_OF_SIM_CLOCK, lambda message: message["clock"]["sec"] == 13)


UNIX = 1_700_000_000.0


class Clocks:
    def __init__(self, ros_s=None, unix=UNIX):
        self.ros, self.unix = ros_s, unix
        self.time = RosTime(lambda: self.ros, lambda: self.unix)


def sample(unix, *, base=None, sim_time=None, sim_epoch=None):
    states = JointStatesSample(time=unix, names=("a",), joints={"a": {"position": 1.0}})
    odometry = OdometrySample(time=base or unix, x=1.0, y=2.0, heading=0.5)
    return StateSample(time=unix, sim_time=sim_time, sim_epoch=sim_epoch, samples={"states": states, "base": odometry})


def times(message):
    return {name: each.time for name, each in message.samples.items()}


def test_what_comes_has_the_time_of_the_clock_and_keeps_it():
    clocks = Clocks(ros_s=42.0)
    first = clocks.time.state(sample(UNIX))
    assert (first.time, times(first)) == (42.0, {"states": 42.0, "base": 42.0})
    assert first.samples["base"].x == 1.0
    clocks.ros = 42.5
    second = clocks.time.state(sample(UNIX + 1.0, base=UNIX))  # the base has published nothing new
    assert (second.time, times(second)) == (42.5, {"states": 42.5, "base": 42.0})


def test_while_the_clock_stands_there_is_nothing_new_and_before_it_begins_the_time_is_0():
    clocks = Clocks(ros_s=0.0)
    assert times(clocks.time.state(sample(UNIX))) == {"states": 0.0, "base": 0.0}
    clocks.ros = 7.0
    assert times(clocks.time.state(sample(UNIX + 1.0))) == {"states": 7.0, "base": 7.0}
    assert times(clocks.time.state(sample(UNIX + 2.0))) == {"states": 7.0, "base": 7.0}


def test_the_stamp_of_a_command_counts_by_its_age():
    clocks = Clocks(ros_s=100.0)
    assert clocks.time.unix(99.75) == UNIX - 0.25
    assert clocks.time.unix(101.0) == UNIX + 1.0
    assert clocks.time.unix(None) is None


def test_events_have_the_time_of_the_clock():
    event = RobotEvent(time=UNIX, kind="x", node=None, level="info", text="it is so")
    assert Clocks(ros_s=5.0).time.event(event).time == 5.0
    assert Clocks().time.event(event) is event


def test_a_robot_that_is_simulated_has_its_own_time():
    clocks, reported = Clocks(ros_s=42.0), sample(UNIX, sim_time=3.0)
    assert clocks.time.state(reported) is reported
    assert clocks.time.unix(12.5) == 12.5


@pytest.mark.parametrize("ros_s", [None, 42.0], ids=["of its file", "of the bridge"])
def test_with_use_sim_time_the_stamps_of_a_simulated_robot_are_the_simulations(ros_s):
    clocks = Clocks(ros_s=ros_s)
    clocks.time.in_simulation = ros_s is None
    reported = clocks.time.state(sample(UNIX + 3.0, base=UNIX + 2.98, sim_time=3.0, sim_epoch=UNIX))
    assert (reported.time, times(reported)) == (3.0, {"states": 3.0, "base": 2.98})
    assert clocks.time.event(RobotEvent(time=UNIX + 3.5, kind="x", node=None, level="info", text="it is")).time == 3.0
    paused = clocks.time.state(sample(UNIX + 3.0, base=UNIX + 2.98, sim_time=3.0, sim_epoch=UNIX))
    assert times(paused) == times(reported)


def test_the_stamp_of_a_command_is_of_the_clock_that_it_is_nearer_to():
    clocks = Clocks(unix=UNIX + 3.5)
    clocks.time.in_simulation = True
    clocks.time.state(sample(UNIX + 3.0, sim_time=3.0, sim_epoch=UNIX))
    assert clocks.time.unix(2.75) == UNIX + 2.75
    assert clocks.time.unix(UNIX + 3.25) == UNIX + 3.25
    assert clocks.time.unix(None) is None


class Answers:
    """A client whose robot's controller manager has parameters, or none that it tells."""

    def __init__(self, *result):
        self.found = result

    def ask(self, _request):
        if not self.found:
            raise RemoteError("UnknownName", "no method parameters")
        return [ParameterReading(name="use_sim_time", kind="bool", value=value) for value in self.found]


@pytest.mark.parametrize(("client", "expected"), [(Answers(True), True), (Answers(False), False), (Answers(), False)])
def test_the_controller_manager_of_the_file_specifies_whether_stamps_are_simulated(client, expected):
    assert uses_sim_time(client) is expected


class ClosedSession(RosSession):
    """A session without ROS: `done` are the steps of its end, `looks` the looks until the last result is requested."""

    def __init__(self, looks):
        self.done, self.looks = [], looks
        self._ended, self._endpoints = False, {}
        self._common = [
            SimpleNamespace(
                abort_goals=lambda: self.note("goals aborted"),
                awaits_result_requests=lambda: self.looks > 0,
                close=lambda: None,
            )
        ]
        self._spinner = SimpleNamespace(stop=lambda _timeout: self.note("ROS thread stopped"))
        self._reactor = SimpleNamespace(remove_reader=lambda _fd: None)
        self._client = SimpleNamespace(fileno=lambda: -1, close=lambda: None)
        self._nodes = self._asker = SimpleNamespace(close=lambda: None)

    def note(self, step):
        self.done.append((step, self._ended))
        return True


@pytest.mark.parametrize("looks", [0, 3])
def test_the_ros_thread_stops_when_no_request_for_the_result_of_an_aborted_goal_is_awaited(monkeypatch, looks):
    session = ClosedSession(looks)

    def sleep(_seconds):
        session.looks -= 1
        session.note("requests answered")

    monkeypatch.setattr(time, "sleep", sleep)
    assert session.close()
    assert session.done == [
        ("goals aborted", False),
        *[("requests answered", False)] * looks,
        ("requests answered", False),  # the clients read the results
        ("ROS thread stopped", True),
    ]


def test_a_controller_that_comes_again_is_stamped_again():
    clocks = Clocks(ros_s=1.0)
    imu = ImuSample(time=UNIX, frame_id="i", orientation=(), angular_velocity=(), linear_acceleration=())
    clocks.time.state(StateSample(time=UNIX, samples={"imu": imu}))
    clocks.time.state(StateSample(time=UNIX))
    clocks.ros = 2.0
    assert times(clocks.time.state(StateSample(time=UNIX, samples={"imu": imu}))) == {"imu": 2.0}


@pytest.mark.ros
def test_it_is_kept_by_a_reliable_publisher(stage):
    publisher = stage.peer.publisher("/robot_description")
    assert (publisher["reliability"], publisher["durability"]) == ("RELIABLE", "TRANSIENT_LOCAL")
    assert publisher["node"] == "canopen_control_bridge"


def test_within_an_interval_the_newest_waits_and_the_others_are_superseded():
    box = Mailbox(20)
    box.put("forward", 1)
    box.take(1000)
    assert box.put("forward", 2)
    assert box.take(1005) == ({}, 1020)
    assert not box.put("forward", 3), "somebody comes at 1020 anyway"
    assert box.take(1020) == ({"forward": 3}, None)


def test_what_waits_under_a_name_that_is_gone_is_dropped():
    box = Mailbox(20)
    box.put("a", 1)
    box.forget("a")
    assert box.take(1000) == ({}, None)
    assert box.put("b", 1), "somebody must be woken again"


@given(st.lists(st.tuples(st.sampled_from("ab"), st.integers(0, 30)), max_size=60), st.integers(1, 20))
def test_a_caller_that_obeys_wakes_and_times_gets_the_last_value_and_never_two_in_an_interval(puts, interval):
    box, now, timer, sent = Mailbox(interval), 0, None, []

    def take():
        nonlocal timer
        due, timer = box.take(now)
        sent.extend((now, name, value) for name, value in due.items())

    for number, (name, pause) in enumerate(puts):
        end = now + pause
        while timer is not None and timer <= end:
            now = max(now, timer)
            take()
        now = end
        if box.put(name, number):
            take()
    while timer is not None:
        now = max(now, timer)
        take()
    for name in {name for name, _ in puts}:
        times = [time for time, which, _ in sent if which == name]
        assert all(b - a >= interval for a, b in pairwise(times))
        values = [value for _, which, value in sent if which == name]
        assert values == sorted(values)
        assert values[-1] == max(number for number, (which, _) in enumerate(puts) if which == name)


TOPIC, TYPE_OF_ACTIVITY = "/controller_manager/activity", "controller_manager_msgs/msg/ControllerManagerActivity"


def hardware(state):
    rest = {"type": "system", "plugin": "p", "rate": 50, "command_interfaces": [], "state_interfaces": []}
    return [{"name": "robby", "state": state, **rest}]


@pytest.fixture
def heard(fresh, maker):
    fresh.robot.answers = {**fresh.robot.answers, "hardware": hardware("active")}
    maker.order("subscribe", topic=TOPIC, of=TYPE_OF_ACTIVITY, qos="latched")
    yield lambda expected: maker.message(TOPIC, expected)
    maker.order("unsubscribe", topic=TOPIC)


def states(named):
    return {item["name"]: (item["state"]["id"], item["state"]["label"]) for item in named}


@pytest.mark.ros
def test_it_is_latched_and_changes_with_controllers_and_hardware(fresh, heard):
    first = heard(lambda message: True)
    assert states(first["controllers"])["forward"] == (3, "active")
    assert states(first["controllers"])["base"] == (2, "inactive")
    fresh.robot.switch(forward="inactive")
    heard(lambda message: states(message["controllers"])["forward"] == (2, "inactive"))
    fresh.robot.switch(forward="active")
    fresh.robot.answers["hardware"] = hardware("unconfigured")
    fresh.robot.event(time=12.5, kind="error", node=None, level="error", text="the hardware has failed")
    failed = heard(lambda message: states(message["hardware_components"]) == {"robby": (1, "unconfigured")})
    assert failed["header"]["stamp"] == {"sec": 1_700_000_000, "nanosec": 250_000_000}
    assert states(failed["controllers"])["forward"] == (3, "active")


def topics(stage):
    return stage.peer.order("graph")["topics"]


@pytest.mark.ros
def test_the_topics_of_a_controller_appear_and_disappear_with_it(fresh):
    loaded = {"name": "later", "type": "x/Y", "state": "inactive", "topic": "commands", "joints": []}
    fresh.robot.controllers.append(loaded)
    assert eventually(lambda: "/later/commands" in topics(fresh))
    fresh.robot.controllers.remove(loaded)
    assert eventually(lambda: "/later/commands" not in topics(fresh))


@pytest.mark.ros
def test_a_controller_of_another_kind_under_the_same_name_has_other_topics(fresh):
    loaded = {"name": "later", "type": "x/Y", "state": "inactive", "topic": "commands", "joints": []}
    fresh.robot.controllers.append(loaded)
    assert eventually(lambda: "/later/commands" in topics(fresh))
    loaded.update(topic=None, state="active")
    assert eventually(lambda: "/later/commands" not in topics(fresh))
    fresh.robot.controllers.remove(loaded)


@pytest.mark.ros
def test_a_controller_whose_name_ros_refuses_has_no_topics_and_the_next_one_has(fresh):
    odd = {"name": "not-ros", "type": "x/Y", "state": "active", "topic": "commands", "joints": []}
    later = {**odd, "name": "later"}
    fresh.peer.order("subscribe", topic="/rosout", of="rcl_interfaces/msg/Log", qos="latched")
    fresh.robot.controllers += [odd, later]
    try:
        assert eventually(lambda: "/later/commands" in topics(fresh))
        reported = fresh.peer.message("/rosout", lambda message: "not-ros" in message["msg"])["msg"]
    finally:
        del fresh.robot.controllers[-2:]
    assert reported.startswith("not-ros has no topics, because ROS refuses them: Invalid node name")
    assert "\n" not in reported


def knows_that_base_is_inactive(robot):
    """Wait until the bridge has asked for the controllers, and for nothing of them since."""
    assert eventually(lambda: robot.listed.get("base") == "inactive")
    samples = robot.pushed
    assert eventually(lambda: robot.pushed > samples + 10)


@pytest.mark.ros
def test_a_controller_that_is_switched_while_the_bridge_asks_is_not_taken_for_what_it_was_then(fresh):
    robot = fresh.robot
    knows_that_base_is_inactive(robot)
    robot.holds = ("controllers",)
    robot.switch(base="active")
    assert eventually(lambda: robot._held)  # a sample has reported it, and the bridge requests all of them
    robot.switch(base="inactive")
    answer = json.loads(json.dumps(robot._list_controllers()))
    robot.switch(base="active")
    robot.holds = ()
    robot.release_one(answer)
    assert eventually(lambda: robot.listed["base"] == "active")


@pytest.mark.ros
def test_a_controller_publishing_faster_than_the_bridge_is_reported_once(fresh):
    knows_that_base_is_inactive(fresh.robot)
    states = fresh.robot.controllers[0]
    states["publish_rate"] = 500.0
    try:
        for state in ("active", "inactive", "active"):  # the bridge asks for the controllers each time
            fresh.robot.switch(base=state)
            assert eventually(lambda state=state: fresh.robot.listed.get("base") == state)
            assert eventually(lambda: fresh.robot.commands("tell"))
    finally:
        del states["publish_rate"]
    (reported,) = fresh.robot.commands("tell")
    assert reported["kind"] == "ros_rate"
    assert reported["text"].startswith("ROS: joint_state_broadcaster (500 Hz): published more often than the samples")


@pytest.mark.ros
def test_what_the_bridge_cannot_make_of_a_sample_does_not_end_it(fresh):
    fresh.peer.order("subscribe", topic="/joint_states", of="sensor_msgs/msg/JointState", qos="default")
    before = fresh.robot.joints
    fresh.robot.joints = {"left": {"position": "garbage"}}
    assert eventually(lambda: fresh.bridge.poll() is None and _warned(fresh))
    fresh.robot.joints = before
    fresh.peer.waiting("/joint_states")
    assert fresh.peer.message("/joint_states")["name"] == ["left", "right"]


def _warned(stage):
    if not hasattr(stage, "logging"):
        stage.logging = stage.peer.order("subscribe", topic="/rosout", of="rcl_interfaces/msg/Log", qos="latched")
    return any("sent an invalid message" in message["msg"] for message in stage.peer.waiting("/rosout"))


@pytest.mark.sources
def test_an_axis_action_is_waited_for_as_long_as_the_robot_needs():
    asked, session = [], object.__new__(RosSession)
    session._asker = SimpleNamespace(ask=lambda _request, _answer, timeout_ns=None: asked.append(timeout_ns))
    session.ask(AxisRequest(action="home", node="left_drive"), print)
    session.ask(GetNodes(), print)
    assert asked == [ENDLESS, None], "a homing that goes on must not seem to have failed"
