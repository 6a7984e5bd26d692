import pytest
from support.service_node import NodeStub

from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.od.eds import read_eds
from canopen_control.rpc.messages.state import JointReading
from canopen_control.service.node_session import NodeSession
from canopen_control.service.scope_signals import (
    SignalValues,
    joint_signal_of,
    node_of,
    signal_of,
    statuswords_of,
)

NODE = NodeSession(NodeStub({}), 5, read_eds(data_path("eds", "TMCM-1270.eds"), 5).od, name="left")


def test_a_signal_is_meant_by_address_or_name():
    speed = signal_of("left:0x606C", NODE)
    assert (speed.key, speed.name, speed.unit) == ((5, 0x606C, 0), "left:0x606C", "counts/s")
    assert signal_of("left:Velocity actual value", NODE) == speed
    assert signal_of("left:0x1018:01", NODE).name == "left:0x1018:01"


@pytest.mark.parametrize("text", ["", "5", "5:", ":0x6064"])
def test_what_is_no_signal_is_told_with_what_one_is(text):
    with pytest.raises(ConfigError, match="is no signal; write NODE:OBJECT"):
        node_of(text)


@pytest.mark.parametrize(
    ("text", "why"), [("5:0x1008", "is no number that can be read"), ("5:0x5FFE", "has no 0x5FFE:00")]
)
def test_what_cannot_be_shown_is_told(text, why):
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


def test_a_trigger_on_faults_looks_at_the_statusword_of_each_node_once():
    signals = [signal_of("5:0x6064", NODE), signal_of("5:0x606C", NODE)]
    assert [each.index for each in statuswords_of(signals, {5: NODE})] == [0x6041]


def test_joints_of_a_robot_are_signals_too():
    speed = joint_signal_of("wheel:velocity")
    assert (speed.name, speed.unit, speed.key, speed.topic) == (
        "wheel:velocity", "rad/s or m/s", ("wheel", "velocity"), "velocity",
    )  # fmt: skip
    assert joint_signal_of("5:0x6064") is None
    assert joint_signal_of(":velocity") is None
    values = SignalValues([signal_of("5:0x6064", NODE), speed, joint_signal_of("arm:position")])
    assert (values.joints, [each.index for each in values.objects]) == (["wheel", "arm"], [0x6064])
    assert values.put_joints({"wheel": JointReading(velocity=2.5)})
    assert values.row == (None, 2.5, None)
    assert not SignalValues([signal_of("5:0x6064", NODE)]).put_joints({})


def test_a_trigger_on_faults_needs_a_drive():
    with pytest.raises(ConfigError, match="no signal is an object of one"):
        statuswords_of([joint_signal_of("wheel:velocity")], {})
