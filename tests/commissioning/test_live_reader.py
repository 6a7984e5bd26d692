"""The reader of live objects, on a clock made by hand: its thread is this test's."""

import contextlib

import pytest
from support.fake_client import FakeClient
from support.pages import StubDesk
from support.service_node import NodeStub

from canopen_control.commissioning import live_reader
from canopen_control.commissioning.live_reader import LiveReader, NodeObjects
from canopen_control.commissioning.object_rows import READS_PER_S, LiveObject
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, EdsError, RemoteError, SdoTimeout
from canopen_control.od.eds import read_eds
from canopen_control.rpc.messages.robot import NodePlace, SdoData, SdoRead

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 3).od


def test_a_session_is_on_a_connection_of_its_own_and_writes_by_its_name():
    robot = FakeClient(answers={SdoRead: SdoData(bytes(4))})
    place = NodePlace(name="left", node_id=3, eds=str(data_path("eds", "TMCM-1270.eds")))
    node = NodeObjects("robby", place, "view", lambda name, timeout: robot)
    with node.session() as session:
        assert session.read_value(session.dictionary[0x6081, 0]) == 0
        session.write(0x6081, 0, bytes(4))
    assert robot.asked[1].source == "view"
    assert robot.closed


def test_an_eds_is_read_once_and_one_that_cannot_be_read_is_reported(tmp_path):
    path = tmp_path / "a.eds"
    path.write_bytes(data_path("eds", "TMCM-1270.eds").read_bytes())
    place = NodeObjects("robby", NodePlace(name="left", node_id=3, eds=str(path)), "view")
    result = place.dictionary()
    path.unlink()
    assert place.dictionary() is result
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


STATUS, SPEED, RAMP = OD[0x6041, 0], OD[0x6081, 0], OD[0x6083, 0]
HELD = {(0x6041, 0): b"\x50\2", (0x6081, 0): bytes(4), (0x6083, 0): bytes(4)}


class Bench:
    """A reader whose sleeps let the clock go on, and which ends at `end` s."""

    def __init__(self, monkeypatch, end=1.0):
        self.now, self.end = 100.0, 100.0 + end
        monkeypatch.setattr(live_reader.threading.Thread, "start", lambda _thread: None)
        self.reader = LiveReader(lambda: self.now, self.sleep)
        self.pages = {}

    def desk(self, held=HELD, name="left_drive"):
        return StubDesk(NodeStub(held), OD, name)

    def watch(self, page, desk, *entries):
        self.pages[page] = desk
        self.reader.watch(page, desk, entries)

    def sleep(self, seconds):
        self.now += seconds
        if self.now >= self.end:
            for page, desk in self.pages.items():
                self.reader.watch(page, desk, ())


@pytest.fixture
def bench(monkeypatch):
    return Bench(monkeypatch)


def test_two_pages_and_two_nodes_share_the_rate(bench):
    left, right = bench.desk(), bench.desk(name="right_drive")
    bench.watch("1", left, STATUS)
    bench.watch("2", left, STATUS)
    bench.watch("3", right, STATUS)
    bench.reader.run()
    assert len(left.stub.reads) + len(right.stub.reads) == pytest.approx(READS_PER_S, abs=2)
    assert len(left.stub.reads) == pytest.approx(len(right.stub.reads), abs=1)


def test_what_a_node_refuses_is_not_asked_all_the_time(bench):
    desk = bench.desk({(0x6041, 0): b"\x50\2"})
    bench.watch("1", desk, STATUS, SPEED)
    bench.reader.run()
    assert desk.stub.reads.count(SPEED.address) == 1
    assert desk.live[0x6081, 0][1].why.startswith("abort 0x06020000")


def test_what_was_written_is_read_next(bench):
    desk = bench.desk()
    bench.watch("1", desk, STATUS, SPEED, RAMP)
    read = desk.stub.read

    def once(index, subindex, *, block=False):
        if len(desk.stub.reads) == 1:
            bench.reader.soon(desk, RAMP)
        return read(index, subindex)

    desk.stub.read = once
    bench.reader.run()
    assert desk.stub.reads[2] == RAMP.address or desk.stub.reads[1] == RAMP.address


def test_a_silent_node_is_left_alone_for_a_while_and_the_other_continues(bench):
    dead, alive = bench.desk(), bench.desk(name="right_drive")
    requests = []

    def silent(index, subindex, *, block=False):
        requests.append(index)
        raise SdoTimeout(3, index, subindex, 0.5)

    dead.stub.read = silent
    bench.watch("1", dead, STATUS, SPEED)
    bench.watch("2", alive, STATUS)
    bench.reader.run()
    assert len(requests) == 1
    assert "no answer" in dead.lost
    assert len(alive.stub.reads) > 40
    assert alive.lost == ""


def test_a_robot_that_is_gone_is_reported_and_asked_again_later(monkeypatch):
    bench = Bench(monkeypatch, end=5.0)
    desk, tries = bench.desk(), []

    @contextlib.contextmanager
    def gone():
        tries.append(bench.now)
        if len(tries) < 2:
            raise RemoteError("BusClosed", "the robot has ended")
        with StubDesk.session(desk) as session:
            yield session

    desk.session = gone
    bench.watch("1", desk, STATUS)
    bench.reader.run()
    assert tries[1] - tries[0] >= 2.0
    assert (desk.lost, desk.live[0x6041, 0][1].value) == ("", 0x0250)


def test_what_no_scan_reads_is_not_read(bench):
    bench.watch("1", bench.desk(), OD[0x6041, 0])
    assert bench.reader._requests
    domain = next((entry for entry in OD if entry.data_type.name == "DOMAIN"), None)
    bench.watch("1", bench.desk(), *([domain] if domain is not None else []))
    assert not bench.reader._requests
