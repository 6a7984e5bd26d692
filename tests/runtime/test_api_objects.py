"""Objects of the nodes through the API, byte by byte, in simulated time."""

from base64 import b64decode
from types import SimpleNamespace

import pytest
from support.apiclient import Client, base64_of
from support.generic import write_generic
from support.robots import Bench

from canopen_control.data_files import data_path
from canopen_control.errors import ControlError
from canopen_control.host.sockets import socket_path
from canopen_control.master.config import read_bus
from canopen_control.master.event_log import Event, EventLog
from canopen_control.od.eds import read_eds
from canopen_control.runtime import api_objects
from canopen_control.runtime.api import ApiServer
from canopen_control.runtime.api_objects import (
    FEW,
    WINDOW_NS,
    ProcessDataFeed,
    WriteLog,
    refuse_unsupervised,
    write_mapped,
    written_words,
)
from canopen_control.virtual.quirks import switches_of

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 3).od
MS = 1_000_000


def test_a_write_is_reported_with_its_value_and_client():
    what = written_words(OD, 0x6083, 0, (4000).to_bytes(4, "little"))
    assert WriteLog().words(0, "left", "view", what).startswith("view wrote 4000 to 0x6083:00 ")
    what = written_words(OD, 0x1017, 0, (200).to_bytes(2, "little"))
    assert WriteLog().words(0, "left", "view", what).startswith("view wrote 0x00C8 to 0x1017:00 ")


def test_what_has_no_words_is_reported_by_its_length():
    assert written_words(OD, 0x5FF0, 1, b"\1\2") == "2 bytes to 0x5FF0:01"
    assert written_words(OD, 0x6083, 0, b"\1\2").startswith("2 bytes to 0x6083:00")


def test_many_writes_of_one_client_are_summed_up():
    log, events = WriteLog(), EventLog()
    for number in range(300):
        text = log.words(number * MS, "left", "restore", f"1 to 0x{0x2000 + number:04X}:00 x")
        events.add(Event(number * MS, "object_written", "left", text))
    assert len(events.recent) == FEW + 1
    assert events.recent[-1].sentence.startswith("restore wrote more objects (295 times in")


def test_others_and_what_comes_later_are_reported_one_by_one():
    log = WriteLog()
    for number in range(FEW + 1):
        log.words(number, "left", "restore", "x")
    assert log.words(FEW, "left", "view", "y") == "view wrote y"
    assert log.words(FEW, "right", "restore", "y") == "restore wrote y"
    assert log.words(FEW, "left", "restore", "y") == "restore wrote more objects"
    assert log.words(FEW + WINDOW_NS + 1, "left", "restore", "y") == "restore wrote y"


def test_what_is_remembered_is_bounded():
    log = WriteLog()
    for number in range(1000):
        log.words(number, "left", f"client {number}", "x")
    assert len(log._counts) <= 64


STATUSWORD, POSITION, OUTPUTS = 0x6041, 0x6064, 0x60FE


@pytest.fixture
def robot(tmp_path):
    bench = Bench("pdos", config=write_generic(tmp_path), drives=(2, 3), controllers=["velocity"])
    bench.start()
    bench.one = bench.robot.node("drive_one")
    yield bench
    bench.close()


def objects(collected):
    return {(item.index, item.subindex): item.data for item in collected}


def test_everything_that_has_come_is_reported_with_the_width_it_was_mapped_with(robot):
    reported = ProcessDataFeed(robot.robot.nodes.values()).everything()
    assert set(reported) == {"drive_one", "drive_two"}
    one = objects(reported["drive_one"])
    assert {address: len(data) for address, data in one.items()} == {
        (0x6041, 0): 2, (0x6061, 0): 1, (0x60FD, 0): 4, (0x6064, 0): 4, (0x606C, 0): 4, (0x6077, 0): 2, (0x603F, 0): 2,
    }  # fmt: skip
    assert int.from_bytes(one[STATUSWORD, 0], "little") & 0x6F == 0x27
    assert one[0x6061, 0] == b"\x09"


def test_of_a_node_that_has_reported_nothing_nothing_is_reported(robot):
    robot.power_off(2)
    robot.until(lambda: not robot.one.ready)
    assert set(ProcessDataFeed(robot.robot.nodes.values()).everything()) == {"drive_two"}


def test_only_what_changed_is_reported_and_a_negative_number_as_it_travels(robot):
    feed = ProcessDataFeed(robot.robot.nodes.values())
    assert len(feed.changes()["drive_one"]) == 7
    robot.run(100)
    assert feed.changes() == {}
    robot.robot.command("velocity", [0.0, -1.0], "test")
    robot.run(500)
    for bus in robot.robot.buses.values():
        bus.watch()  # else what the drives have sent since the last edge is read at the next one
    robot.run(1)
    reported = feed.changes()
    assert set(reported) == {"drive_two"}
    position = objects(reported["drive_two"])[POSITION, 0]
    assert int.from_bytes(position, "little", signed=True) == robot.drives[3].get(POSITION) < 0
    assert (0x6061, 0) not in objects(reported["drive_two"])


def test_what_is_written_travels_in_the_rpdo_of_the_next_cycle_and_stays(robot):
    observed = len(robot.bus.history)
    write_mapped(robot.robot, robot.one, OUTPUTS, 1, bytes.fromhex("00000300"))
    robot.run(20)
    sent = [frame for label, frame in robot.bus.history[observed:] if label == "master" and frame.can_id == 0x502]
    assert sent[0].data == bytes.fromhex("00000300")
    robot.run(500)
    assert robot.drives[2].get(OUTPUTS, 1) == 0x30000
    assert robot.drives[3].get(OUTPUTS, 1) == 0


@pytest.mark.parametrize("index", [0x6040, 0x6060, 0x607A, 0x60FF, 0x6071, 0x6042])
def test_what_moves_the_drive_is_the_controllers_alone(robot, index):
    with pytest.raises(ControlError, match="moves the drive and is written by controllers only"):
        write_mapped(robot.robot, robot.one, index, 0, bytes(2))
    robot.run(100)
    assert robot.robot.state.value == "running"


@pytest.mark.parametrize(
    ("index", "data", "words"),
    [
        (0x6083, "00000000", "is not mapped in an RPDO"),
        (0x6041, "0000", "is not mapped in an RPDO"),
        (OUTPUTS, "00", "4 bytes"),
    ],
)
def test_what_no_rpdo_could_carry_is_refused_before_the_cycle_meets_it(robot, index, data, words):
    with pytest.raises(ControlError, match=words):
        write_mapped(robot.robot, robot.one, index, 1 if index == OUTPUTS else 0, bytes.fromhex(data))


def test_a_node_that_is_not_operational_takes_none_and_gets_none_when_it_is_back(robot):
    robot.power_off(2)
    robot.until(lambda: not robot.one.ready)
    with pytest.raises(ControlError, match=r"node 2 \(drive_one\): 0x60FE:01 cannot be sent: .* no heartbeat"):
        write_mapped(robot.robot, robot.one, OUTPUTS, 1, bytes.fromhex("00000300"))
    robot.power_on(2)
    robot.until(lambda: robot.one.ready)
    robot.run(200)
    assert robot.drives[2].get(OUTPUTS, 1) == 0


def test_outputs_that_a_controller_commands_are_its_own(robot):
    joint = robot.joint(2)
    command = joint.commands["digital_outputs"]
    robot.robot.registry.claim([command.name], "gpio")
    with pytest.raises(ControlError, match="is commanded by gpio"):
        write_mapped(robot.robot, robot.one, OUTPUTS, 1, bytes(4))


class Watcher(Client):
    """A client that keeps the process data it receives."""

    def watch(self, ms):
        self._bench.run(ms)
        return [message["pdos"]["nodes"] for message in self.messages() if "pdos" in message]


@pytest.fixture
def api(robot, monkeypatch):
    monkeypatch.setattr("support.apiclient.socket_path", lambda kind, _: socket_path(kind, robot.setup.name))
    server = ApiServer(robot.robot)
    yield robot
    server.close()


def test_a_subscriber_to_pdos_gets_everything_first_and_then_changes(api):
    watcher, other = Watcher(api), Client(api)
    watcher.send(id=1, method="subscribe", params={"pdos": True})
    reported = watcher.watch(100)
    assert [len(nodes["drive_one"]) for nodes in reported[:2]] == [7, 7], "the first change is from nothing"
    assert watcher.watch(200) == []
    other.ask("command", controller="velocity", values=[1.0, 0.0])
    reported = watcher.watch(200)
    assert 15 <= len(reported) <= 20, "one per cycle of 10 ms, while it accelerates"
    assert {node for nodes in reported for node in nodes} == {"drive_one"}
    assert other.messages() == []
    other.ask("pdo_write", node="drive_one", index=0x60FE, subindex=1, data=base64_of("00000300"))
    assert (
        "written by controllers only"
        in other.ask("pdo_write", node=2, index=0x6040, data=base64_of("0f00"))["error"]["message"]
    )
    api.run(20)
    assert api.drives[2].get(OUTPUTS, 1) == 0x30000
    watcher.send(method="subscribe", params={"pdos": False})
    watcher.watch(20)
    other.ask("command", controller="velocity", values=[0.0, 0.0])
    assert watcher.watch(200) == []
    watcher.close()
    other.close()


def test_nothing_is_sampled_without_a_subscriber(api, monkeypatch):
    monkeypatch.setattr(ProcessDataFeed, "changes", lambda self: pytest.fail("looked"))
    client = Client(api)
    client.ask("subscribe", state_rate=10, events=True)
    api.run(200)
    client.close()


def test_objects_are_read_and_written_through_the_robots_own_client(client):
    assert client.ask("sdo_read", node="left_drive", index=0x6083)["result"] == {"data": base64_of("803e0000")}
    assert client.ask("sdo_write", node="3", index=0x6083, data=base64_of("a00f0000"))["result"] == {}
    assert client.ask("sdo_read", node=3, index=0x6083, subindex=0)["result"] == {"data": base64_of("a00f0000")}
    read = client.ask("sdo_read", node="left_drive", index=0x1008, block=True, timeout=2.0)["result"]
    assert b64decode(read["data"]).startswith(b"TMCM-1270")
    assert "timeout" in client.ask("sdo_read", node="left_drive", index=0x1008, timeout=-1)["error"]["message"]
    error = client.ask("sdo_read", node="left_drive", index=0x5FF0)["error"]
    assert error["kind"] == "SdoAbort"
    assert "0x06020000" in error["message"]


@pytest.mark.sources
def test_a_long_object_is_written_in_pieces(client, robby):
    written = []
    robby.robot.node("left_drive").sdo.write = lambda *args, **_: written.append(args) or SimpleNamespace(done=True)
    for piece in (base64_of("01" * 24_000), base64_of("02" * 24_000)):
        assert client.ask("sdo_data", data=piece)["result"] == {}
    client.send(id=2, method="sdo_write", params={"node": "left_drive", "index": 0x2000, "data": base64_of("03")})
    robby.run(100)
    assert written == [(0x2000, 0, b"\1" * 24_000 + b"\2" * 24_000 + b"\3")]
    client.send(id=3, method="sdo_write", params={"node": "left_drive", "index": 0x2000, "data": base64_of("04")})
    robby.run(100)
    assert written[1] == (0x2000, 0, b"\4")


def test_more_pieces_than_an_object_may_have_are_refused_and_forgotten(client, robby, monkeypatch):
    monkeypatch.setattr(api_objects, "MAX_OBJECT", 1000)
    assert client.ask("sdo_data", data=base64_of("00" * 600))["result"] == {}
    assert "more than 1000 bytes" in client.ask("sdo_data", data=base64_of("00" * 600))["error"]["message"]
    assert client.ask("sdo_data", data=base64_of("00" * 600))["result"] == {}


def test_the_events_report_what_was_written_and_by_whom(client, robby):
    for source in ({"source": "view"}, {}):
        answer = client.ask("sdo_write", node="left_drive", index=0x6083, data=base64_of("a00f0000"), **source)
        assert answer["result"] == {}
    reported = [event for event in robby.robot.events.recent if event.kind == "object_written"]
    assert [event.node for event in reported] == ["left_drive", "left_drive"]
    assert reported[0].text == "view wrote 4000 to 0x6083:00 Profile acceleration"
    assert reported[1].text.startswith("client ")
    assert "(pid " in reported[1].text


def test_what_a_node_refuses_was_not_written(client, robby):
    answer = client.ask("sdo_write", node="left_drive", index=0x1018, subindex=1, data=base64_of("00000000"))
    assert answer["error"]["kind"] == "SdoAbort"
    assert not [event for event in robby.robot.events.recent if event.kind == "object_written"]


def test_a_client_may_ask_how_far_a_transfer_is(client, robby):
    assert client.ask("sdo_progress", node="left_drive")["result"] == {"done": 0, "total": None}
    assert client.ask("sdo_progress", node="nobody")["error"]["kind"] == "UnknownName"


def begin_long_write(bench, client, session=None):
    """Send a long write to a node that answers late, and wait until a part of it is in the node."""
    switches_of(bench.drives[2]).set("sdo_late=0.002", on=True, now=bench.reactor.now())
    for _ in range(2):
        assert client.ask("sdo_data", data=base64_of("01" * 24_000))["result"] == {}
    params = {"node": "drive_one", "index": 0x2000, "data": base64_of("03"), "session": session}
    client.send(id=2, method="sdo_write", params=params)
    bench.until(lambda: bench.one.sdo.progress[0] > 100)


def test_a_cancel_ends_the_long_transfers_of_its_session_alone(api):
    client, other = Client(api), Client(api)
    begin_long_write(api, client, "mine")
    assert other.ask("sdo_cancel", node="drive_one", session="yours")["result"] == {}
    assert api.one.sdo.busy
    assert other.ask("sdo_cancel", node="drive_one", session="mine")["result"] == {}
    error = client.next()["error"]
    assert error == {"kind": "SdoCancelled", "message": "node 2 (drive_one): 0x2000:00: the transfer was cancelled"}
    assert not api.one.sdo.busy
    client.close()
    other.close()


def test_a_client_that_is_gone_does_not_keep_a_node_busy(api):
    client = Client(api)
    begin_long_write(api, client)
    client.close()
    api.run(20)
    assert not api.one.sdo.busy


def test_the_events_name_the_client_that_took_a_node_out(client, robby):
    for source in ({"source": "view"}, {}):
        assert client.ask("nmt", node="left_drive", command="preop", **source)["result"] == {}
    reported = [event for event in robby.robot.events.recent if event.kind == "nmt_asked"]
    assert [event.node for event in reported] == ["left_drive", "left_drive"]
    assert reported[0].text == "view requested NMT preop"
    assert reported[1].text.startswith("client ")


@pytest.mark.parametrize(
    ("index", "subindex", "data", "refused"),
    [
        (0x1016, 1, (0).to_bytes(4, "little"), True),
        (0x1016, 1, (0x00050000 | 500).to_bytes(4, "little"), True),  # monitors node 5
        (0x1016, 1, (0x00010000 | 700).to_bytes(4, "little"), False),  # the master, for longer
        (0x6007, 0, (0).to_bytes(2, "little"), True),
        (0x6007, 0, (1).to_bytes(2, "little"), False),
        (0x1017, 0, (0).to_bytes(2, "little"), False),  # only the master loses the drive, which is reported
        (0x6081, 0, (0).to_bytes(4, "little"), False),
    ],
)
def test_a_write_after_which_a_drive_would_outlive_the_master_is_refused(index, subindex, data, refused):
    plan = read_bus(data_path("config", "arm6") / "bus.yml").plans["joint_1_drive"]
    node = SimpleNamespace(node_id=2, name="joint_1_drive", plan=plan, is_taken_out=False)
    if refused:
        with pytest.raises(ControlError, match="no longer stop if the master died; first take the node out: canopen"):
            refuse_unsupervised(node, index, subindex, data)
    else:
        refuse_unsupervised(node, index, subindex, data)
    refuse_unsupervised(SimpleNamespace(**{**vars(node), "is_taken_out": True}), index, subindex, data)
