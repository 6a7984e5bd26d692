import pytest

from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, EdsError
from canopen_control.od.eds import read_eds
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.messages.robot import NodePlace, SdoData, SdoRead
from canopen_control.service.live_reader import NodeObjects
from canopen_control.service.object_rows import LiveObject

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 3).od


class FakeRobot:
    robot = "robby"

    def __init__(self):
        self.asked, self.closed = [], False

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.closed = True

    def ask(self, request, timeout=None):
        self.asked.append(request)
        return SdoData(bytes(4)) if isinstance(request, SdoRead) else Done()

    def sdo_write(self, request, timeout):
        self.ask(request)


def test_a_session_is_on_a_connection_of_its_own_and_writes_by_its_name():
    robot = FakeRobot()
    place = NodePlace(name="left", node_id=3, eds=str(data_path("eds", "TMCM-1270.eds")))
    node = NodeObjects("robby", place, "view", lambda name, timeout: robot)
    with node.session() as session:
        assert session.read_value(session.dictionary[0x6081, 0]) == 0
        session.write(0x6081, 0, bytes(4))
    assert robot.asked[1].source == "view"
    assert robot.closed


def test_an_eds_is_read_once_and_one_that_cannot_be_read_is_told(tmp_path):
    path = tmp_path / "a.eds"
    path.write_bytes(data_path("eds", "TMCM-1270.eds").read_bytes())
    place = NodeObjects("robby", NodePlace(name="left", node_id=3, eds=str(path)), "view")
    found = place.dictionary()
    path.unlink()
    assert place.dictionary() is found
    gone = NodeObjects("robby", NodePlace(name="left", node_id=3, eds=str(path)), "view")
    with pytest.raises((EdsError, ConfigError)):
        gone.dictionary()


def test_what_was_read_is_news_only_where_it_has_changed():
    node = NodeObjects("robby", NodePlace(name="left", node_id=3), "view")
    for value in (5, 5, 6):
        node.keep(LiveObject(OD[0x6081, 0], value))
    node.keep(LiveObject(OD[0x6083, 0], None, "abort"))
    assert node.live[0x6081, 0] == (2, LiveObject(OD[0x6081, 0], 6))
    assert node.live[0x6083, 0][0] == 3
