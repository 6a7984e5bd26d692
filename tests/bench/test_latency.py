"""The latency bench: the time ends with the RPDO that has the command's value, and with no other."""

import struct

import pytest
from canopen_control_bench import latency
from canopen_control_bench.cycle import ROBOT, Arena
from canopen_control_bench.fleet import CONTROLLER, SCALE
from canopen_control_bench.stage import stage

from canopen_control.bus.channel import open_port
from canopen_control.client.robot_client import RobotClient
from canopen_control.errors import CanopenError
from canopen_control.frame import CanFrame, pack_records
from canopen_control.rpc.messages.robot import CommandController

pytestmark = pytest.mark.process


def rpdo(value):
    return CanFrame(0x302, struct.pack("<ii", 0, round(value * SCALE)))


def test_only_the_value_of_the_command_ends_its_time(monkeypatch):
    monkeypatch.setattr(latency, "_TIMEOUT_S", 0.2)
    with stage():
        talker, listener = open_port("local:latency"), open_port("local:latency")
        talker.send(pack_records([rpdo(5.0), CanFrame(0x282, bytes(8)), rpdo(5.01)]))
        assert latency.rpdo_with(listener, 5.01) > 0
        talker.send(pack_records([rpdo(5.0)]))
        with pytest.raises(CanopenError, match=r"no RPDO with 6 rad/s"):
            latency.rpdo_with(listener, 6.0)
        talker.close()
        listener.close()


def test_commands_of_the_api_reach_the_wire():
    with stage() as played:
        arena = Arena(played, 2, 2000, base=False)
        ours = arena.ours()
        client = RobotClient.connect(ROBOT)
        found = latency.command_latencies(
            arena.channel,
            lambda value: client.notify(CommandController(controller=CONTROLLER, values=[value] * 2)),
            5,
        )
        client.close()
        ours.leave()
    assert len(found) == 5
    assert all(0 < each < 1000 for each in found)
