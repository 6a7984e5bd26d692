import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.fake_client import FakeClient
from support.service_node import NodeStub

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.cia402.state import State
from canopen_control.commissioning import node_session
from canopen_control.commissioning.identity import DeviceIdentity
from canopen_control.commissioning.node_session import NodeSession, RobotTransfers, dictionary_of, session_with
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, ControlError, SdoLengthError, SdoTimeout
from canopen_control.od.codec import decode
from canopen_control.od.eds import read_eds
from canopen_control.rpc.messages.robot import (
    MAX_OBJECT,
    GetSdoProgress,
    GetStatus,
    NodePlace,
    SdoData,
    SdoPiece,
    SdoProgress,
    SdoRead,
    SdoWrite,
)
from canopen_control.rpc.messages.state import NodeReading, Status


def fake_robot(**reading):
    status = Status(nodes={"left": NodeReading(name="left", node_id=3, **reading)})
    answers = {SdoRead: SdoData(b"\1\2"), GetSdoProgress: SdoProgress(700, 1000), GetStatus: status}
    return FakeClient(answers=answers)


def test_objects_are_read_and_written_through_the_robot():
    robot = fake_robot()
    transfers = RobotTransfers(robot, 3, 0.5)
    assert transfers.read(0x6041, 0) == b"\1\2"
    transfers.write(0x6083, 0, bytes(4))
    session = robot.asked[0].session
    assert robot.asked[0] == SdoRead(node="3", index=0x6041, timeout=0.5, session=session)
    assert robot.asked[1] == SdoWrite(node="3", index=0x6083, data=bytes(4), timeout=0.5, session=session)
    RobotTransfers(robot, 3).read(0x6041, 0)
    assert robot.asked[2].session not in (None, session), "each session has a name of its own"


def test_what_is_long_goes_in_pieces_and_what_is_too_long_not_at_all():
    robot = fake_robot()
    RobotTransfers(robot, 3).write(0x2000, 0, bytes(60_000))
    assert [type(item) for item in robot.asked] == [SdoPiece, SdoPiece, SdoWrite]
    with pytest.raises(ConfigError, match="400001 bytes are more than the 400000 that a running robot can transfer"):
        RobotTransfers(robot, 3).write(0x2000, 0, bytes(MAX_OBJECT + 1))


def test_the_state_is_that_of_the_robot():
    transfers = RobotTransfers(fake_robot(nmt_state="PRE_OPERATIONAL", taken_out=True), 3)
    assert transfers.nmt_state() is NmtState.PRE_OPERATIONAL
    assert transfers.taken_out()
    unknown = RobotTransfers(fake_robot(taken_out=True), 4)
    assert unknown.nmt_state() is None
    assert not unknown.taken_out()


def test_how_far_a_transfer_is_is_asked_next_to_it(monkeypatch):
    other = fake_robot()
    other.close = lambda: other.asked.append("closed")
    monkeypatch.setattr(node_session.RobotClient, "connect", lambda name, timeout: other)
    transfers = RobotTransfers(fake_robot(), 3)
    assert [transfers.progress(), transfers.progress()] == [(700, 1000)] * 2
    transfers.close()
    assert other.asked == [GetSdoProgress(node="3"), GetSdoProgress(node="3"), "closed"]

    def gone(name, timeout):
        raise ConfigError("no robot")

    monkeypatch.setattr(node_session.RobotClient, "connect", gone)
    assert RobotTransfers(fake_robot(), 3).progress() == (0, None)


def test_an_nmt_command_is_the_robots_to_send():
    with pytest.raises(ControlError, match="NMT enter pre operational can only be sent by the robot"):
        RobotTransfers(fake_robot(), 3).command(NmtCommand.ENTER_PRE_OPERATIONAL)


def test_a_session_has_the_dictionary_of_the_nodes_eds():
    place = NodePlace(name="left", node_id=3, eds=str(data_path("eds", "TMCM-1270.eds")))
    robot = fake_robot()
    with session_with(robot, place, dictionary_of(place), source="view") as session:
        assert str(session) == "node 3 (left)"
        assert session.robot == "robby"
        session.write_value(session.dictionary[0x6083, 0], 4000)
    assert robot.asked[0].source == "view"
    assert dictionary_of(NodePlace(name="bare", node_id=4)) is None


OD = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od


def session(objects=None, od=OD, **others):
    return NodeSession(NodeStub(objects or {}), 5, od, **others)


def test_a_value_that_the_type_cannot_hold_is_reported_with_its_object():
    with pytest.raises(ConfigError, match=r"node 5 \(turn\): 0x6060:00 .*the range is -128 to 127"):
        session(name="turn").write_value(OD[0x6060, 0], 500)


def test_an_answer_of_another_length_is_reported_with_its_object():
    with pytest.raises(SdoLengthError, match=r"0x6081:00.*2 bytes \(01 02\), UNSIGNED32 has 4; is this the EDS"):
        session({(0x6081, 0): b"\1\2"}).read_value(OD[0x6081, 0])


@given(st.sampled_from([entry for entry in OD if entry.data_type.bits]), st.data())
def test_what_is_written_is_read_back(entry, data):
    size = ((entry.data_type.bits or 0) + 7) // 8
    value = decode(data.draw(st.binary(min_size=size, max_size=size)), entry.data_type)
    node = session()
    if value == value:  # a nan is read back as one, and equals nothing
        node.write_value(entry, value)
        assert node.read_value(entry) == value


def test_an_identity_is_compared_to_the_eds_where_that_reports_one():
    good = {(0x1018, 1): (0x286).to_bytes(4, "little"), (0x1018, 2): (0x4F6).to_bytes(4, "little")}
    assert session(good).identity_differences() == []
    assert session({**good, (0x1018, 1): (0x287).to_bytes(4, "little")}).identity_differences() == [
        "vendor 0x00000286 in the EDS, 0x00000287 in the device"
    ]
    assert session().identity_differences()[1] == "product 0x000004F6 in the EDS, none in the device"
    assert session(good).identity() == DeviceIdentity(None, 0x286, 0x4F6, device_name="", hardware="", software="")


@pytest.mark.parametrize(
    ("word", "state", "powered"),
    [(0x0237, State.OPERATION_ENABLED, [0]), (0x0250, State.SWITCH_ON_DISABLED, []), (0x0001, None, [0])],
)
def test_the_state_of_the_drive_is_that_of_its_statusword(word, state, powered):
    node = session({(0x6041, 0): word.to_bytes(2, "little")})
    assert node.drive_states() == {0: state}
    assert node.powered_axes() == powered


def test_a_node_that_is_not_a_drive_has_no_states():
    assert session(od=None).drive_states() == {}


def test_without_an_eds_the_user_is_reported_with_what_to_give_one():
    with pytest.raises(ConfigError, match="node 5 has no EDS; give one with --eds FILE"):
        assert session(od=None).dictionary


def test_a_silent_node_is_not_a_missing_object():
    node = session()
    node.transfers.error = SdoTimeout(5, 0x1018, 1, 0.5)
    with pytest.raises(SdoTimeout):
        node.number(0x1018, 1)
