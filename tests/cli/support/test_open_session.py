import argparse

import pytest
from support.fake_client import FakeClient
from support.onbus import TMCM, OnBus

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.cia402.state import State
from canopen_control.cli.support import target
from canopen_control.cli.support.open_session import add_session_arguments, open_session
from canopen_control.cli.support.target import find_eds
from canopen_control.errors import ConfigError
from canopen_control.rpc.messages.robot import BusPlace, GetNodes, GetStatus, NodeListing, NodePlace, SdoData, SdoRead
from canopen_control.rpc.messages.state import NodeReading, Status

ANSWERS = {
    GetNodes: NodeListing(
        {"can": BusPlace("local:robby", 1)}, [NodePlace(name="left", node_id=3, eds=str(find_eds(TMCM)))]
    ),
    GetStatus: Status(nodes={"left": NodeReading(node_id=3, nmt_state="OPERATIONAL")}),
    SdoRead: SdoData(b"\1\2"),
}


@pytest.fixture
def robby(monkeypatch):
    monkeypatch.setattr(target, "find_robots", lambda: ["robby"])
    monkeypatch.setattr(target.RobotClient, "connect", lambda name, timeout=10.0: FakeClient(answers=ANSWERS))


def arguments(*words):
    parser = argparse.ArgumentParser()
    add_session_arguments(parser)
    return parser.parse_args(words)


@pytest.fixture
def alone(private_folders):
    with OnBus("memory:session", {5: TMCM}) as bus:
        yield bus


def test_a_node_of_a_bare_bus_is_reached_with_its_eds(alone):
    with open_session(arguments("5", "--can", "memory:session", "--eds", TMCM)) as node:
        assert str(node) == "node 5"
        assert node.robot == ""
        assert node.identity_differences() == []
        node.write_value(node.dictionary[0x6081, 0], 777)
        assert node.read_value(node.dictionary[0x6081, 0]) == 777
        assert node.drive_states() == {0: State.SWITCH_ON_DISABLED}
        assert node.nmt_state() is None  # it sends no heartbeat


def test_the_nmt_state_of_a_node_is_that_of_its_heartbeat(alone):
    with open_session(arguments("5", "--can", "memory:session", "--eds", TMCM)) as node:
        node.write(0x1017, 0, (50).to_bytes(2, "little"))
        assert node.nmt_state() is NmtState.PRE_OPERATIONAL


def test_a_node_that_sends_no_heartbeat_is_not_waited_for(alone, monkeypatch):
    with open_session(arguments("5", "--can", "memory:session", "--eds", TMCM)) as node:
        bus, waited = node.transfers._bus, []
        monkeypatch.setattr(bus, "command", lambda command, node_id, seconds: waited.append(seconds) or [])
        node.transfers.command(NmtCommand.START)
        assert node.nmt_state() is None
        node.transfers.command(NmtCommand.START)
        node.transfers.command(NmtCommand.RESET_NODE)
        node.write(0x1017, 0, (50).to_bytes(2, "little"))
        node.nmt_state()
        node.transfers.command(NmtCommand.START)
    assert waited == [0.3, 0.02, 3.0, 0.3]


def test_a_node_of_a_running_robot_is_reached_through_it(robby):
    with open_session(arguments("left", "--name", "robby")) as node:
        assert (node.node_id, node.name, node.robot) == (3, "left", "robby")
        assert node.nmt_state() is NmtState.OPERATIONAL
        assert node.read(0x1008) == b"\1\2"
        assert not node.transfers.taken_out()


def test_a_channel_of_a_running_robot_leads_to_it(robby):
    with open_session(arguments("3", "--can", "local:robby")) as node:
        assert node.robot == "robby"
    with pytest.raises(ConfigError, match="has no node '9'"), open_session(arguments("9", "--can", "local:robby")):
        pass


def test_a_node_of_a_bare_bus_takes_nmt_commands(alone):
    with open_session(arguments("5", "--can", "memory:session", "--eds", TMCM)) as node:
        assert node.transfers.taken_out()
        node.transfers.command(NmtCommand.START)
        assert alone.nodes[5].nmt.state is NmtState.OPERATIONAL
        alone.call(lambda: alone.nodes[5].store.download(0x1017, 0, (20).to_bytes(2, "little")))
        node.transfers.command(NmtCommand.ENTER_PRE_OPERATIONAL)
        assert node.nmt_state() is NmtState.PRE_OPERATIONAL
