from __future__ import annotations

import itertools
import struct

import pytest
from support.virtualbench import MS, S, generic, servo, tmcm

from canopen_control.bus.memory import MemoryBus
from canopen_control.cia301.nmt import NmtStateChanged
from canopen_control.cia301.sdo_codec import crc16, segment_frames
from canopen_control.frame import ERROR_FLAG, CanFrame, frames_of, pack_records
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.virtual.node_host import NodeHost


class World:
    """Nodes on a memory bus, a listener beside them, a clock moved by hand."""

    def __init__(self, nodes):
        self.bus = MemoryBus("nodehost")
        self.reactor = Reactor(ManualClock(S))
        self.heard, self.events, self.closed = [], [], []
        self.listener = self.bus.open("listener")
        self.host = NodeHost(
            self.reactor,
            self.bus.open("drives"),
            nodes,
            on_event=lambda node, event: self.events.append((node.node_id, event)),
            on_closed=self.closed.append,
        )
        self.reactor.add_reader(self.listener, self._listen)
        self.reactor.run_for(0)

    def _listen(self):
        self.heard += [(self.reactor.now(), frame) for frame in frames_of(self.listener.receive())]

    def send(self, *frames):
        self.listener.send(pack_records(frames))
        self.reactor.run_for(0)

    def close(self):
        self.host.close()
        self.listener.close()
        self.host.port.close()
        self.reactor.close()


@pytest.fixture
def world():
    worlds = []

    def make(*nodes):
        worlds.append(World(nodes))
        return worlds[-1]

    yield make
    for item in worlds:
        item.close()


def test_nodes_boot_in_the_next_turn_and_answer(world):
    w = world(tmcm(2), tmcm(3))
    assert [str(frame) for _, frame in w.heard] == ["702#00", "703#00"]
    w.send(CanFrame(0x602, bytes.fromhex("4000100000000000")))
    assert str(w.heard[-1][1]) == "582#430010009201FFFF"
    assert any(isinstance(event, NmtStateChanged) for _, event in w.events)


def test_each_frame_reaches_only_its_subscribers(world):
    w = world(tmcm(2), tmcm(3))
    w.send(CanFrame(0, b"\x01\x03"))
    assert [node.operational for node in w.host.nodes] == [False, True]
    w.send(CanFrame(0, b"\x01\x00"), CanFrame(0x7FF, b"\x01"))
    assert [node.operational for node in w.host.nodes] == [True, True]


def test_heartbeats_come_on_time_and_idle_nodes_leave_the_timer_alone(world):
    w = world(tmcm(2))
    assert w.host._timer is None
    w.send(CanFrame(0x602, bytes.fromhex("2B17100064000000")))
    w.heard.clear()
    w.reactor.run_for(S)
    times = [when for when, frame in w.heard if frame.can_id == 0x702]
    assert len(times) == 10
    assert {b - a for a, b in itertools.pairwise(times)} == {100 * MS}


def test_a_moved_identifier_is_received_at_once(world):
    w = world(servo(5))
    w.send(CanFrame(0, b"\x01\x05"))
    for data in ("2300140105020080", "2300140141020000"):
        w.send(CanFrame(0x605, bytes.fromhex(data)))
    w.send(CanFrame(0x241, b"\x06\0\x03"))
    assert w.host.nodes[0].drives[0].state.name == "READY_TO_SWITCH_ON"


def test_nodes_of_one_host_receive_each_other(world):
    w = world(servo(5), servo(6))
    w.send(CanFrame(0x606, bytes.fromhex("2316100164000500")))  # 6 watches 5 with 100 ms
    w.send(CanFrame(0x605, bytes.fromhex("2B17100032000000")))  # 5 beats every 50 ms
    w.reactor.run_for(S)
    assert w.host.nodes[1].emcy.active == ()
    w.send(CanFrame(0x605, bytes.fromhex("2B17100000000000")))
    w.reactor.run_for(S)
    assert w.host.nodes[1].emcy.active == (0x8130,)


def test_a_bus_that_is_gone_is_reported_once(world):
    w = world(tmcm(2))
    w.bus.close()
    w.reactor.remove_reader(w.listener)
    w.reactor.run_for(S)
    assert len(w.closed) == 1
    w.host.close()


def test_a_node_changed_from_outside_is_served(world):
    w = world(servo(5))
    node = w.host.nodes[0]
    w.heard.clear()
    node.clock.now = w.reactor.now()
    node.outbox.emergency(0x4310, 8)
    w.host.wake(node)
    w.reactor.run_for(0)
    assert [frame.can_id for _, frame in w.heard] == [0x085]


def test_a_node_served_from_outside_during_its_reset_receives_again(world):
    w = world(servo(5))
    node = w.host.nodes[0]
    w.send(CanFrame(0x000, bytes([0x81, 5])))  # reset node
    assert CanFrame(0x605).can_id not in node.routes()
    for _ in range(2000):  # as whoever polls the control socket: served before the timers of the same turn
        w.reactor.clock.now_ns += MS
        node.tick(w.reactor.now())
        w.host.wake(node)
        if 0x605 in node.routes():
            break
    w.heard.clear()
    w.send(CanFrame(0x605, bytes.fromhex("4000100000000000")))
    assert [frame.can_id for _, frame in w.heard if frame.can_id == 0x585] == [0x585]


def test_without_a_bus_its_nodes_stop_by_themselves_and_with_another_port_they_continue(world):
    w = world(servo(5, x6060=3, x60FF=1000, x6007=3))
    w.send(CanFrame(0, b"\x01\x05"), *(CanFrame(0x205, bytes((word, 0, 3))) for word in (6, 7, 15)))
    w.reactor.run_for(S)
    drive = w.host.nodes[0].drives[0]
    assert drive.mover.plant.velocity == 1000
    w.bus.close()
    w.reactor.remove_reader(w.listener)
    w.reactor.run_for(S)
    assert (drive.state.name, drive.mover.plant.velocity) == ("SWITCH_ON_DISABLED", 0)
    other = MemoryBus("nodehost-again")
    listener, port = other.open("listener"), other.open("drives")
    w.host.port.close()
    w.host.rejoin(port)
    w.host.rejoin(port)
    listener.send(pack_records([CanFrame(0x605, bytes.fromhex("4000100000000000"))]))
    w.reactor.run_for(0)
    assert [frame.can_id for frame in frames_of(listener.receive())] == [0x585]
    w.host.close()
    listener.close()
    port.close()


def test_what_happens_to_the_controller_reaches_the_nodes(world):
    w = world(servo(5))
    error = CanFrame(ERROR_FLAG | 0x04, bytes.fromhex("0010000000000000"))  # CRTL: receive error passive
    w.bus.inject(error)
    w.reactor.run_for(0)
    assert [frame.data[:2] for _, frame in w.heard if frame.can_id == 0x085] == [b"\x20\x81"]


def block_download(size):
    """The frames of a client that writes `size` bytes to node 5's 0x2000, and the object."""
    data = bytes(number * 7 % 251 for number in range(size))
    initiate = CanFrame(0x605, bytes.fromhex("C2002000") + size.to_bytes(4, "little"))
    return initiate, segment_frames(0x605, data, 0, -(-size // 7)), data


def frame_by_frame(node):
    """The SDO frames that reach the node one by one, from now on."""
    taken, receive = [], node.receive

    def note(frame, now):
        taken.append(frame)
        receive(frame, now)

    node.receive = note
    return taken


@pytest.mark.sources
def test_the_segments_of_a_block_download_are_taken_at_once_and_what_comes_between_them_is_received(world):
    w = world(generic(5), generic(6))
    initiate, segments, data = block_download(800)
    w.send(initiate)
    taken = frame_by_frame(w.host.nodes[0])
    w.send(*segments[:60], CanFrame(0x000, b"\x01\x05"), *segments[60:])
    assert w.host.nodes[0].operational
    assert taken == [CanFrame(0x000, b"\x01\x05"), segments[-1]]
    w.send(CanFrame(0x605, struct.pack("<BH5x", 0xC1 | (-len(data) % 7) << 2, crc16(data))))
    assert [str(frame) for _, frame in w.heard if frame.can_id == 0x585] == [
        "585#A00020007F000000",  # without CRC, as the client wishes
        f"585#A2{len(segments):02X}7F0000000000",
        "585#A100000000000000",
    ]
    assert w.host.nodes[0].sdo.served == 1
    assert w.host.nodes[0].store.upload(0x2000, 0) == data


@pytest.mark.sources
@pytest.mark.parametrize("why", ["stopped", "a second listener", "a node of the same id", "a filter"])
def test_where_a_frame_is_more_than_the_servers_each_comes_by_itself(world, why):
    w = world(generic(5), *([generic(5)] if why == "a node of the same id" else []))
    initiate, segments, _ = block_download(800)
    w.send(initiate)
    node = w.host.nodes[0]
    if why == "stopped":
        w.send(CanFrame(0, b"\x02\x05"))
    elif why == "a second listener":
        table = node.routing.table
        table[0x605] = lambda frame, now, sdo=table[0x605]: sdo(frame, now)
    elif why == "a filter":
        node.filter = Everything()
    taken = frame_by_frame(node)
    w.send(*segments)
    assert taken == segments


class Everything:
    """A filter that changes nothing."""

    def incoming(self, frame, now):
        return frame

    def outgoing(self, frames, now):
        return frames

    def next_deadline(self):
        return None

    def tick(self, now):
        pass
