"""The slaves: live they are drives; replaying, they answer a SYNC with their last TPDOs and see the rest."""

import itertools
import struct

from canopen_control_bench.slaves import ReplayPort

from canopen_control.bus.channel import open_port
from canopen_control.bus.memory import MemoryBus
from canopen_control.frame import CanFrame, frames_of, pack_records

SYNC, BEAT, RPDO = CanFrame(0x080), CanFrame(0x701, b"\x05"), CanFrame(0x302, bytes(8))
STATUS, FEEDBACK = CanFrame(0x182, b"\x37\x16\x03"), CanFrame(0x282, struct.pack("<ii", -10, 7))


def ends():
    MemoryBus.get("slaves")
    return open_port("memory:slaves", label="master"), ReplayPort(open_port("memory:slaves", label="drives"))


def test_live_everything_passes():
    master, slaves = ends()
    master.send(pack_records([RPDO, SYNC]))
    assert list(frames_of(slaves.receive())) == [RPDO, SYNC]
    slaves.send(pack_records([STATUS]))
    assert list(frames_of(master.receive())) == [STATUS]


def test_replaying_each_sync_is_answered_with_moving_positions_and_heartbeats_still_pass():
    master, slaves = ends()
    slaves.send(pack_records([BEAT, STATUS, FEEDBACK]))
    master.receive()
    slaves.replay(True)
    positions = []
    for _ in range(130):
        master.send(pack_records([RPDO, BEAT, SYNC]))
        assert list(frames_of(slaves.receive())) == [BEAT]
        status, feedback = frames_of(master.receive())
        assert status == STATUS
        position, velocity = struct.unpack("<ii", feedback.data)
        assert velocity == 7
        positions.append(position)
    assert positions[:3] == [-10, 40, 90]
    assert max(abs(b - a) for a, b in itertools.pairwise(positions)) == 50


def test_live_again_the_drives_have_the_bus_back():
    master, slaves = ends()
    slaves.send(pack_records([STATUS]))
    slaves.replay(True)
    slaves.replay(False)
    master.receive()
    master.send(pack_records([SYNC]))
    assert list(frames_of(slaves.receive())) == [SYNC]
    assert master.receive() == b""
