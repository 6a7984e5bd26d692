import pytest
from support.samples import sample_of, status_of
from support.service_node import NodeStub

from canopen_control.commissioning import scope_signals
from canopen_control.commissioning.node_session import NodeSession
from canopen_control.commissioning.scope_signals import (
    PolledSource,
    RobotSource,
    SignalValues,
    joint_signal_of,
    node_of,
    signal_of,
)
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, SdoTimeout
from canopen_control.od.eds import read_eds
from canopen_control.rpc.messages.robot import GetStatus, MappedValue, ProcessData
from canopen_control.rpc.messages.state import JointReading

STATUS = status_of({"joints": {"wheel": {}}, "cycle": {"period_s": 0.02, "count": 50, "missed": 3, "work_s": 0.001}})
HELD = {(0x6064, 0): (7).to_bytes(4, "little"), (0x606C, 0): (9).to_bytes(4, "little")}


class Clock:
    """Virtual time: who sleeps or waits lets it pass."""

    def __init__(self, monkeypatch):
        self.now = 0.0
        monkeypatch.setattr(scope_signals.time, "monotonic", lambda: self.now)
        monkeypatch.setattr(scope_signals.time, "time", lambda: 1000.0 + self.now)
        monkeypatch.setattr(scope_signals.time, "sleep", self.sleep)

    def sleep(self, seconds):
        self.now += seconds


class FakeRobot:
    def __init__(self, clock, *batches):
        self.clock, self.batches, self.asked = clock, list(batches), []

    robot = "pair"

    def ask(self, request):
        self.asked.append(request)
        return STATUS if isinstance(request, GetStatus) else None

    def messages(self, timeout):
        if self.batches:
            yield from self.batches.pop(0)
        self.clock.sleep(timeout)


@pytest.fixture
def clock(monkeypatch):
    return Clock(monkeypatch)


def bench():
    node = NodeSession(NodeStub(HELD), 5, read_eds(data_path("eds", "TMCM-1270.eds"), 5).od, name="left")
    return node, SignalValues([signal_of("5:0x6064", node), signal_of("5:0x606C", node)])


def test_a_bare_bus_is_polled_at_its_rate(clock):
    node, values = bench()
    source = PolledSource(values, {5: node}, 10.0)
    taken = [sample for _ in range(30) for sample in source.samples(0.05)]
    assert taken[0] == (1000.0, (7.0, 9.0))
    assert len(taken) == pytest.approx(clock.now * 10, abs=1.5)


def test_what_a_node_refuses_has_no_value_and_a_silent_node_ends_it(clock):
    node, values = bench()
    del node.transfers.objects[0x606C, 0]
    source = PolledSource(values, {5: node}, 10.0)
    assert [row for _, row in source.samples(0.1)] == [(7.0, None)]
    node.transfers.error = SdoTimeout(5, 0x6064, 0, 0.5)
    with pytest.raises(SdoTimeout):
        list(source.samples(1.0))


def test_what_tpdos_carry_comes_with_the_robots_time_and_only_the_rest_is_polled(clock):
    node, values = bench()
    data = ProcessData(900.0, {"left": [MappedValue(0x6064, 0, (5).to_bytes(4, "little"))], "other": []})
    robot = FakeRobot(clock, [data], [ProcessData(901.0, {"right": []})])
    source = RobotSource(robot, values, {5: node}, 50.0)
    assert robot.asked[0].pdos
    assert next(source.samples(0.01)) == (900.0, (5.0, None))
    assert [item.index for item in source.polled] == [0x606C]
    taken = [row for _ in range(10) for _, row in source.samples(0.1)]
    assert taken[-1] == (5.0, 9.0)
    assert set(node.transfers.reads) == {(0x606C, 0)}


def test_joints_come_with_every_cycle_of_the_robot_and_must_be_its_own(clock):
    sample = sample_of({"time": 900.5, "joints": {"wheel": {"velocity": 2.0}}})
    robot = FakeRobot(clock, [sample])
    source = RobotSource(robot, SignalValues([joint_signal_of("wheel:velocity")]), {}, 50.0)
    assert (robot.asked[-1].state_rate, robot.asked[-1].pdos) == (1000.0, False)
    assert list(source.samples(0.1)) == [(900.5, (2.0,))]
    assert source.cycles() == (50, 3)
    with pytest.raises(ConfigError, match="has no joint 'arm'; its joints: wheel"):
        RobotSource(robot, SignalValues([joint_signal_of("arm:velocity")]), {}, 50.0)


def test_a_bare_bus_has_no_cycle(clock):
    node, values = bench()
    assert PolledSource(values, {5: node}, 10.0).cycles() is None


NODE = NodeSession(NodeStub({}), 5, read_eds(data_path("eds", "TMCM-1270.eds"), 5).od, name="left")


def test_a_signal_is_meant_by_address_or_name():
    speed = signal_of("left:0x606C", NODE)
    assert (speed.key, speed.name, speed.unit) == ((5, 0x606C, 0), "left:0x606C", "counts/s")
    assert signal_of("left:Velocity actual value", NODE) == speed
    assert signal_of("left:0x1018:01", NODE).name == "left:0x1018:01"


@pytest.mark.parametrize("text", ["", "5", "5:", ":0x6064"])
def test_what_is_not_a_signal_is_reported_with_what_one_is(text):
    with pytest.raises(ConfigError, match="is not a signal; write NODE:OBJECT"):
        node_of(text)


@pytest.mark.parametrize(("text", "why"), [("5:0x1008", "is not a readable number"), ("5:0x5FFE", "has no 0x5FFE:00")])
def test_what_cannot_be_shown_is_reported(text, why):
    with pytest.raises(ConfigError, match=why):
        signal_of(text, NODE)


def test_values_are_signed_as_their_type_and_none_for_another_length():
    values = SignalValues([signal_of("5:0x6064", NODE), signal_of("5:0x6064", NODE), signal_of("5:0x6041", NODE)])
    assert values.row == (None, None, None)
    assert values.put(5, 0x6064, 0, (-7).to_bytes(4, "little", signed=True))
    assert not values.put(6, 0x6064, 0, bytes(4))
    assert values.row == (-7.0, -7.0, None)
    values.put(5, 0x6064, 0, b"")
    assert values.row[0] is None


def test_joints_of_a_robot_are_signals_too():
    speed = joint_signal_of("wheel:velocity")
    assert (speed.name, speed.unit, speed.key, speed.topic) == (
        "wheel:velocity", "rad/s or m/s", ("wheel", "velocity"), "velocity",
    )  # fmt: skip
    assert joint_signal_of("5:0x6064") is None
    assert joint_signal_of(":velocity") is None
    values = SignalValues([signal_of("5:0x6064", NODE), speed, joint_signal_of("arm:position")])
    assert (values.joints, [item.index for item in values.objects]) == (["wheel", "arm"], [0x6064])
    assert values.put_joints({"wheel": JointReading(velocity=2.5)})
    assert values.row == (None, 2.5, None)
    assert not SignalValues([signal_of("5:0x6064", NODE)]).put_joints({})
