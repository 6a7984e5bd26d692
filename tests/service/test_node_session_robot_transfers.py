import pytest

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.client import RobotClient
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, ControlError
from canopen_control.rpc.messages.declare import Done
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
from canopen_control.service import node_session
from canopen_control.service.node_session import RobotTransfers, dictionary_of, session_with


class FakeRobot:
    robot = "robby"
    sdo_write = RobotClient.sdo_write

    def __init__(self, **reading):
        self.requests = []
        self.reading = NodeReading(name="left", node_id=3, **reading)

    def ask(self, request, timeout=None):
        self.requests.append(request)
        answers = {
            SdoRead: SdoData(b"\1\2"),
            GetSdoProgress: SdoProgress(700, 1000),
            GetStatus: Status(nodes={"left": self.reading}),
        }
        return answers.get(type(request), Done())


def test_objects_are_read_and_written_through_the_robot():
    robot = FakeRobot()
    transfers = RobotTransfers(robot, 3, 0.5)
    assert transfers.read(0x6041, 0) == b"\1\2"
    transfers.write(0x6083, 0, bytes(4))
    assert robot.requests[0] == SdoRead(node="3", index=0x6041, timeout=0.5)
    assert robot.requests[1] == SdoWrite(node="3", index=0x6083, data=bytes(4), timeout=0.5)


def test_what_is_long_goes_in_pieces_and_what_is_too_long_not_at_all():
    robot = FakeRobot()
    RobotTransfers(robot, 3).write(0x2000, 0, bytes(60_000))
    assert [type(each) for each in robot.requests] == [SdoPiece, SdoPiece, SdoWrite]
    with pytest.raises(ConfigError, match="400001 bytes are more than the 400000 a running robot passes on"):
        RobotTransfers(robot, 3).write(0x2000, 0, bytes(MAX_OBJECT + 1))


def test_the_state_is_what_the_robot_knows():
    transfers = RobotTransfers(FakeRobot(nmt_state="PRE_OPERATIONAL", taken_out=True), 3)
    assert transfers.nmt_state() is NmtState.PRE_OPERATIONAL
    assert transfers.taken_out()
    unknown = RobotTransfers(FakeRobot(taken_out=True), 4)
    assert unknown.nmt_state() is None
    assert not unknown.taken_out()


def test_how_far_a_transfer_is_is_asked_beside_it(monkeypatch):
    other = FakeRobot()
    other.close = lambda: other.requests.append("closed")
    monkeypatch.setattr(node_session.RobotClient, "connect", lambda name, timeout: other)
    transfers = RobotTransfers(FakeRobot(), 3)
    assert [transfers.progress(), transfers.progress()] == [(700, 1000)] * 2
    transfers.close()
    assert other.requests == [GetSdoProgress(node="3"), GetSdoProgress(node="3"), "closed"]

    def gone(name, timeout):
        raise ConfigError("no robot")

    monkeypatch.setattr(node_session.RobotClient, "connect", gone)
    assert RobotTransfers(FakeRobot(), 3).progress() == (0, None)


def test_an_nmt_command_is_the_robots_to_send():
    with pytest.raises(ControlError, match="NMT enter pre operational is the robot's to send"):
        RobotTransfers(FakeRobot(), 3).command(NmtCommand.ENTER_PRE_OPERATIONAL)


def test_a_session_has_the_dictionary_of_the_nodes_eds():
    place = NodePlace(name="left", node_id=3, eds=str(data_path("eds", "TMCM-1270.eds")))
    robot = FakeRobot()
    with session_with(robot, place, dictionary_of(place), source="view") as session:
        assert str(session) == "node 3 (left)"
        assert session.robot == "robby"
        session.write_value(session.dictionary[0x6083, 0], 4000)
    assert robot.requests[0].source == "view"
    assert dictionary_of(NodePlace(name="bare", node_id=4)) is None
