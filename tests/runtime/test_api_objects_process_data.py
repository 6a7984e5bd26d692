"""Process data as the API's clients see and send them, byte by byte, in simulated time."""

import pytest
from support.apiclient import Client, base64_of
from support.generic import write_generic
from support.robots import Bench

from canopen_control.errors import ControlError
from canopen_control.host.sockets import socket_path
from canopen_control.runtime.api import ApiServer
from canopen_control.runtime.api_objects import ProcessDataFeed, write_mapped

STATUSWORD, POSITION, OUTPUTS = 0x6041, 0x6064, 0x60FE


@pytest.fixture
def robot(tmp_path):
    bench = Bench("pdos", config=write_generic(tmp_path), drives=(2, 3), controllers=["velocity"])
    bench.start()
    bench.one = bench.robot.node("drive_one")
    yield bench
    bench.close()


def objects(told):
    return {(each.index, each.subindex): each.data for each in told}


def test_everything_that_has_come_is_told_with_the_width_it_was_mapped_with(robot):
    told = ProcessDataFeed(robot.robot.nodes.values()).everything()
    assert set(told) == {"drive_one", "drive_two"}
    one = objects(told["drive_one"])
    assert {address: len(data) for address, data in one.items()} == {
        (0x6041, 0): 2, (0x6061, 0): 1, (0x60FD, 0): 4, (0x6064, 0): 4, (0x606C, 0): 4, (0x6077, 0): 2, (0x603F, 0): 2,
    }  # fmt: skip
    assert int.from_bytes(one[STATUSWORD, 0], "little") & 0x6F == 0x27
    assert one[0x6061, 0] == b"\x09"


def test_of_a_node_that_has_said_nothing_nothing_is_told(robot):
    robot.power_off(2)
    robot.until(lambda: not robot.one.ready)
    assert set(ProcessDataFeed(robot.robot.nodes.values()).everything()) == {"drive_two"}


def test_only_what_changed_is_told_and_a_negative_number_as_it_travels(robot):
    feed = ProcessDataFeed(robot.robot.nodes.values())
    assert len(feed.changes()["drive_one"]) == 7
    robot.run(100)
    assert feed.changes() == {}
    robot.robot.command("velocity", [0.0, -1.0], "test")
    robot.run(500)
    for bus in robot.robot.buses.values():
        bus.watch()  # else what the drives have sent since the last edge is read at the next one
    robot.run(1)
    told = feed.changes()
    assert set(told) == {"drive_two"}
    position = objects(told["drive_two"])[POSITION, 0]
    assert int.from_bytes(position, "little", signed=True) == robot.drives[3].get(POSITION) < 0
    assert (0x6061, 0) not in objects(told["drive_two"])


def test_what_is_written_travels_in_the_rpdo_of_the_next_cycle_and_stays(robot):
    seen = len(robot.bus.history)
    write_mapped(robot.robot, robot.one, OUTPUTS, 1, bytes.fromhex("00000300"))
    robot.run(20)
    sent = [frame for label, frame in robot.bus.history[seen:] if label == "master" and frame.can_id == 0x502]
    assert sent[0].data == bytes.fromhex("00000300")
    robot.run(500)
    assert robot.drives[2].get(OUTPUTS, 1) == 0x30000
    assert robot.drives[3].get(OUTPUTS, 1) == 0


@pytest.mark.parametrize("index", [0x6040, 0x6060, 0x607A, 0x60FF, 0x6071, 0x6042])
def test_what_moves_the_drive_is_the_controllers_alone(robot, index):
    with pytest.raises(ControlError, match="moves the drive and belongs to the controllers"):
        write_mapped(robot.robot, robot.one, index, 0, bytes(2))
    robot.run(100)
    assert robot.robot.state.value == "running"


@pytest.mark.parametrize(
    ("index", "data", "words"),
    [(0x6083, "00000000", "none of its RPDOs"), (0x6041, "0000", "none of its RPDOs"), (OUTPUTS, "00", "4 bytes")],
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
    """A client that keeps what it is told of process data."""

    def watch(self, ms):
        self._bench.run(ms)
        return [message["pdos"]["nodes"] for message in self.messages() if "pdos" in message]


@pytest.fixture
def api(robot, monkeypatch):
    monkeypatch.setattr("support.apiclient.socket_path", lambda kind, _: socket_path(kind, robot.setup.name))
    server = ApiServer(robot.robot)
    yield robot
    server.close()


def test_who_subscribes_to_pdos_gets_everything_first_and_then_what_changes(api):
    watcher, other = Watcher(api), Client(api)
    watcher.send(id=1, method="subscribe", params={"pdos": True})
    told = watcher.watch(100)
    assert [len(nodes["drive_one"]) for nodes in told[:2]] == [7, 7], "the first change is from nothing"
    assert watcher.watch(200) == []
    other.ask("command", controller="velocity", values=[1.0, 0.0])
    told = watcher.watch(200)
    assert 15 <= len(told) <= 20, "one per cycle of 10 ms, while it accelerates"
    assert {node for nodes in told for node in nodes} == {"drive_one"}
    assert other.messages() == []
    other.ask("pdo_write", node="drive_one", index=0x60FE, subindex=1, data=base64_of("00000300"))
    assert (
        "belongs to the controllers"
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


def test_nothing_is_looked_at_while_nobody_watches(api, monkeypatch):
    monkeypatch.setattr(ProcessDataFeed, "changes", lambda self: pytest.fail("looked"))
    client = Client(api)
    client.ask("subscribe", state_rate=10, events=True)
    api.run(200)
    client.close()
