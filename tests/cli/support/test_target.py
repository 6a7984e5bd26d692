import os

import pytest
from support.onbus import GENERIC, TMCM, OnBus

from canopen_control.cli.main import main
from canopen_control.cli.support import target
from canopen_control.cli.support.target import BusTarget, RobotTarget, find_eds, robot_on
from canopen_control.client import RobotClient
from canopen_control.errors import ConfigError, RemoteError
from canopen_control.frame import CanFrame
from canopen_control.host.lineclient import MAX_REQUEST
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.messages.robot import (
    BusPlace,
    GetNodes,
    NodeListing,
    NodePlace,
    SdoData,
    SdoPiece,
    SdoRead,
    SdoWrite,
)
from canopen_control.rpc.wire import request_line

NODES = [
    NodePlace(name="left", node_id=3, bus="can", eds="/x/a.eds"),
    NodePlace(name="right", node_id=2, bus="can", eds="/x/b.eds"),
]
LISTING = NodeListing({"can": BusPlace("local:robby", 1)}, NODES)


class FakeRobot:
    """Answers as RobotClient does; `kind` is the error it raises instead."""

    robot = "robby"

    def __init__(self, kind=None, channel="local:robby"):
        self.kind, self.requests, self.channel = kind, [], channel

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        self.requests.append("close")

    sdo_write = RobotClient.sdo_write

    def ask(self, request, timeout=None):
        if self.kind is not None:
            raise RemoteError(self.kind, "the robot has not answered")
        self.requests.append(request)
        listing = NodeListing({"can": BusPlace(self.channel, 1)}, NODES)
        return {GetNodes: listing, SdoRead: SdoData(b"\1\2")}.get(type(request), Done())


@pytest.fixture
def running(monkeypatch):
    robots = {"robby": FakeRobot()}
    monkeypatch.setattr(target, "find_robots", lambda: sorted(robots))
    monkeypatch.setattr(target.RobotClient, "connect", lambda name, timeout=10.0: robots[name])
    return robots


def test_nodes_are_found_by_name_and_id_and_come_in_order():
    robot = RobotTarget(FakeRobot())
    assert [str(node) for node in robot.sessions] == ["node 2 (right)", "node 3 (left)"]
    assert robot.session("left") is robot.session("3")
    assert str(robot.session("left")._eds) == "/x/a.eds"
    with pytest.raises(ConfigError, match="has no node 'up'; its nodes: 2 right, 3 left"):
        robot.session("up")


def test_a_long_object_goes_through_a_robot_in_pieces_that_a_request_can_hold():
    fake = FakeRobot()
    with RobotTarget(fake) as robot:
        robot.session("3").write(0x2000, 0, bytes(range(256)) * 1000)
    sent = [request for request in fake.requests[1:] if request != "close"]
    assert [type(item) for item in sent] == [SdoPiece] * 10 + [SdoWrite]
    assert sent[-1].source.startswith("canopen-control (pid ")  # the name in the robot's events
    assert all(len(request_line(1, "sdo_write", item)) < MAX_REQUEST - 1000 for item in sent)
    assert b"".join(item.data for item in sent) == bytes(range(256)) * 1000


def test_transfers_through_a_robot_carry_block_and_timeout():
    who = f"canopen-control (pid {os.getpid()})"
    fake = FakeRobot()
    with RobotTarget(fake, timeout=2.0) as robot:
        assert robot.session("3").read(0x1008, 1, block=True) == b"\1\2"
        robot.session("3").write(0x2000, 0, b"\xff")
        with pytest.raises(ConfigError, match="400000"):
            robot.session("3").write(0x2000, 0, bytes(400_001))
    session = fake.requests[1].session
    assert fake.requests[1:] == [
        SdoRead(node="3", index=0x1008, subindex=1, block=True, timeout=2.0, session=session),
        SdoWrite(node="3", index=0x2000, subindex=0, data=b"\xff", timeout=2.0, source=who, session=session),
        "close",
    ]


def test_the_robot_on_a_channel_is_known_by_its_channel(running):
    assert robot_on("local:robby") == ("robby", LISTING)
    assert robot_on("local:other") is None


def test_a_robot_that_has_ended_owns_nothing_and_one_that_hangs_is_reported(running):
    running["robby"] = FakeRobot("BusClosed")
    assert robot_on("local:robby") is None
    running["robby"] = FakeRobot("Timeout")
    with pytest.raises(RemoteError, match="has not answered"):
        robot_on("local:robby")


def test_a_bare_bus_keeps_off_the_nodes_of_a_robot(running):
    running["robby"] = FakeRobot(channel="memory:target")
    with OnBus("memory:target", {3: TMCM}), target.BusTarget("memory:target") as bus:
        with pytest.raises(ConfigError, match="belongs to the running robot robby"):
            bus.session("3")
        assert bus.session("0x10").node_id == 16


def test_an_eds_is_a_path_or_a_bundled_name(tmp_path):
    assert find_eds(TMCM).name == TMCM
    path = tmp_path / "my.eds"
    path.write_text("")
    assert find_eds(str(path)) == path
    with pytest.raises(ConfigError, match=r"no EDS file generic_cia40\.eds \(did you mean 'generic_cia40\d\.eds'\?\)"):
        find_eds("generic_cia40.eds")
    with pytest.raises(ConfigError, match=r"no EDS file nope\.eds"):
        find_eds("nope.eds")


def test_the_progress_of_a_transfer_is_that_of_its_client(private_folders):
    with OnBus("memory:progress", {5: GENERIC}), BusTarget("memory:progress") as target:
        node = target.session("5")
        assert node.transfers.progress() == (0, None)
        client = target.bus.client(5)
        client.read(0x1008, now=0)
        client.frames()  # the request has left
        client.receive(CanFrame(0x585, bytes.fromhex("410810000A000000")), 0)
        assert node.transfers.progress() == (0, 10)


EXCHANGED = {
    "restore 3 left.dcf": "left.dcf is a file, not a node; write: canopen-control restore left.dcf 3",
    "restore left left --can local:x": None,  # a robot's node, which is not there; and no file
    "restore 3 ./gone": "./gone is a file, not a node; write: canopen-control restore ./gone 3",
    "backup left.dcf -o 3": "left.dcf is a file, not a node; write: canopen-control backup 3 -o left.dcf",
    "backup a.dcf -o b.dcf": "a.dcf is a file, not a node; write: canopen-control backup NODE -o b.dcf",
    "clone left.dcf 4": "left.dcf is a file, not a node; write: canopen-control restore left.dcf 4",
    "clone 3 left.dcf": "left.dcf is a file, not a node; write: canopen-control backup 3 -o left.dcf",
    "firmware image 3": "image is a file, not a node; write: canopen-control firmware 3 image",
    "firmware drive.bin 3 --can local:x --eds generic_cia402.eds": (
        "drive.bin is a file, not a node; "
        "write: canopen-control firmware 3 drive.bin --can local:x --eds generic_cia402.eds"
    ),
    "sdo read 0x6041 left": "0x6041 is an object, not a node; write: canopen-control sdo read left 0x6041",
    "sdo read 6041:00 3": "6041:00 is an object, not a node; write: canopen-control sdo read 3 6041:00",
    "sdo write 0x60FF 3 -500": "0x60FF is an object, not a node; write: canopen-control sdo write 3 0x60FF -500",
    "sdo read left.dcf 0x6041 --can local:x": (
        "left.dcf is a file, not a node; write: canopen-control sdo read NODE 0x6041 --eds left.dcf --can local:x; "
        "to show the object in the file: canopen-control eds show left.dcf 0x6041"
    ),
    "sdo read 0x6041 left.dcf": (
        "0x6041 is an object, not a node; write: canopen-control sdo read NODE 0x6041 --eds left.dcf"
    ),
    "sdo write left.dcf 0x60FF -500": (
        "left.dcf is a file, not a node; write: canopen-control sdo write NODE 0x60FF -500 --eds left.dcf"
    ),
    "sdo read drive.bin 0x6041": "drive.bin is a file, not a node; write: canopen-control sdo read NODE 0x6041",
    "sdo upload left.dcf 5 1021": "left.dcf is a file, not a node; write: canopen-control sdo upload 5 1021 left.dcf",
    "sdo upload 1021 left.dcf 5": "1021 is an object, not a node; write: canopen-control sdo upload 5 1021 left.dcf",
    "sdo download 0x1F50:1 5 drive.bin": (
        "0x1F50:1 is an object, not a node; write: canopen-control sdo download 5 0x1F50:1 drive.bin"
    ),
}


@pytest.mark.parametrize("line", EXCHANGED)
def test_words_in_the_wrong_order_are_refused_with_the_right_order(
    line, private_folders, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    for name in ("left.dcf", "drive.bin", "image"):
        (tmp_path / name).write_bytes(b"x")
    assert main(line.split()) == 2
    error = capsys.readouterr().err
    sentence = EXCHANGED[line]
    assert "not a node" not in error if sentence is None else error == f"canopen-control: {sentence}\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.bin", "image", "left.dcf"]


@pytest.mark.parametrize("word", ["3", "0x7F", "0x0005", "left_drive", "face", "arm.left"])
def test_a_name_or_a_node_id_may_be_a_node(word, private_folders, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "left_drive").write_bytes(b"x")
    (tmp_path / "image").write_bytes(b"x")
    for line in (["sdo", "read", word, "0x6041"], ["firmware", word, "image"]):
        assert main(line) == 2
        assert capsys.readouterr().err.startswith("canopen-control: no robot is running"), "that is what is missing"
