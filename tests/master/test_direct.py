"""Calls that wait on a bare bus, against devices on another thread."""

import threading

import pytest
from support.lockstep import press_ctrl_c
from support.onbus import GENERIC, TMCM, OnBus

from canopen_control.bus.memory import MemoryBus
from canopen_control.bus.port import BusEvent, BusEventKind
from canopen_control.cia301.lss import LssIdentity, LssMode, LssSlave
from canopen_control.cia301.nmt import NmtCommand, NmtConfirmed, NmtState, NmtUnconfirmed
from canopen_control.errors import (
    BusClosed,
    BusError,
    BusOff,
    ConfigError,
    LocalProtocolError,
    RemoteProtocolError,
    SdoAbort,
    SdoRestarted,
    SdoStopped,
    SdoTimeout,
)
from canopen_control.frame import CanFrame, pack_records
from canopen_control.master.direct import DirectBus


@pytest.fixture
def drives():
    with OnBus("memory:direct", {3: TMCM, 5: GENERIC}) as drives:
        yield drives


@pytest.fixture
def bus(drives):
    with DirectBus.open("memory:direct", timeout_s=0.3, retries=0) as bus:
        yield bus


def test_objects_are_read_and_written(bus, drives):
    assert bus.read(3, 0x1018, 1) == bytes.fromhex("86020000")
    bus.write(3, 0x6081, 0, (1500).to_bytes(4, "little"))
    assert bus.read(3, 0x6081) == (1500).to_bytes(4, "little")
    assert drives.call(lambda: drives.nodes[3].get(0x6081)) == 1500


@pytest.mark.parametrize("block", [False, True])
@pytest.mark.parametrize("length", [0, 4, 7, 300, 20_000])
def test_any_length_travels_both_ways(bus, length, block):
    data = bytes(n % 251 for n in range(length))
    bus.write(5, 0x2000, 0, data, block=block)
    assert bus.read(5, 0x2000, block=block) == data


def test_what_the_node_refuses_is_raised_and_the_next_request_works(bus):
    with pytest.raises(SdoAbort, match="0x9999:00: abort 0x06020000") as caught:
        bus.read(3, 0x9999)
    assert caught.value.node_id == 3
    with pytest.raises(SdoAbort, match="read-only"):
        bus.write(3, 0x6041, 0, b"\0\0")
    assert bus.read(3, 0x1000) == bytes.fromhex("9201ffff")


def test_an_absent_server_is_a_timeout_and_nonsense_an_error_of_the_caller(bus):
    with pytest.raises(SdoTimeout, match=r"node 9: 0x1000:00: no answer within 0\.3 s"):
        bus.read(9, 0x1000)
    with pytest.raises(LocalProtocolError):
        bus.read(3, 0x10000)
    with pytest.raises(ConfigError):
        DirectBus.open("nonsense")


def test_all_nodes_are_asked_at_once_and_each_has_its_own_answer(bus):
    expected = [(node_id, 0x1018, sub) for node_id in range(1, 21) for sub in (2, 9)]
    answers = bus.read_many(expected)
    assert set(answers) == set(expected)
    assert answers[3, 0x1018, 2] == (1270).to_bytes(4, "little")
    assert isinstance(answers[3, 0x1018, 9], SdoAbort)
    assert answers[5, 0x1018, 2] == (0x402).to_bytes(4, "little")
    assert all(isinstance(answers[node, 0x1018, 2], SdoTimeout) for node in range(1, 21) if node not in (3, 5))


def test_a_transfer_that_is_broken_off_is_aborted_on_the_wire(drives):
    wire = MemoryBus.get("direct")
    wire.hold(lambda label, frame: frame.can_id == 0x583)  # the answer comes too late
    with DirectBus.open("memory:direct", label="cli", timeout_s=30) as bus:
        timer = threading.Timer(0.1, press_ctrl_c)
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            bus.read(3, 0x1008)
        timer.join()
    wire.hold(None)
    sent = [frame for label, frame in wire.history if label == "cli"]
    assert [frame.data[0] for frame in sent] == [0x40, 0x80]
    assert sent[1].data[1:4] == bytes.fromhex("081000")


def test_a_heartbeat_confirms_a_command_and_silence_reports_this(bus):
    assert bus.command(NmtCommand.START, 3, 0.05) == [NmtUnconfirmed(3, NmtCommand.START, 1, None)]
    bus.write(3, 0x1017, 0, (10).to_bytes(2, "little"))
    (confirmed,) = bus.command(NmtCommand.ENTER_PRE_OPERATIONAL, 3, 5.0)
    assert isinstance(confirmed, NmtConfirmed)
    assert bus.states[3] is NmtState.PRE_OPERATIONAL


def test_of_all_nodes_those_report_that_boot(bus):
    results = bus.command(NmtCommand.RESET_NODE, 0, 0.5)
    assert [(type(result), result.node_id) for result in results] == [(NmtConfirmed, 3), (NmtConfirmed, 5)]


def test_a_node_that_shows_another_state_is_unconfirmed_with_it():
    with OnBus("memory:stubborn", cores=(Stubborn(),)), DirectBus.open("memory:stubborn") as bus:
        assert bus.command(NmtCommand.START, 4, 0.2) == [NmtUnconfirmed(4, NmtCommand.START, 1, NmtState.STOPPED)]


class Stubborn:
    """Answers every NMT command with the heartbeat of a stopped node 4."""

    def __init__(self):
        self.out = []

    def receive(self, frame, now):
        if frame.can_id == 0:
            self.out.append(CanFrame(0x704, b"\4"))

    def frames(self):
        out, self.out = self.out, []
        return out


def test_listening_receives_heartbeats_boot_ups_and_guarding_answers():
    with OnBus("memory:listen", cores=(Stubborn(),)) as others, DirectBus.open("memory:listen") as bus:
        others.send(CanFrame(0x709, b"\0"), CanFrame(0x70A, b"\x85"), CanFrame(0x70B, b"\x33"), CanFrame(0x70C, b""))
        bus.listen(0.05)
        assert bus.states == {9: NmtState.INITIALISING, 10: NmtState.OPERATIONAL, 11: None}


@pytest.mark.sources  # in virtual time: a scan takes an answer after 20 ms for none
def test_lss_finds_and_names_a_slave():
    slave = LssSlave(LssIdentity(0x286, 0x4F6, 1, 77))
    with OnBus("memory:lss", cores=(slave,)), DirectBus.open("memory:lss", timeout_s=0.1) as bus:
        result = bus.lss(lambda master: master.fast_scan(vendor=0x286, product=0x4F6, revision=1, serial=77))
        assert result == LssIdentity(0x286, 0x4F6, 1, 77)
        bus.lss(lambda master: master.configure_node_id(9))
        assert bus.lss(lambda master: master.inquire("node_id")) == 255  # the new one counts after a reset
        bus.lss(lambda master: master.switch_global(LssMode.WAITING))
        with pytest.raises(RemoteProtocolError, match="no answer"):
            bus.lss(lambda master: master.inquire("vendor"))
    assert slave.pending_node_id == 9


def test_a_bus_that_goes_away_is_an_error_at_once():
    wire = MemoryBus.get("gone")
    bus = DirectBus.open("memory:gone", timeout_s=30)
    timer = threading.Timer(0.05, wire.close)
    timer.start()
    with pytest.raises(BusClosed):
        bus.read(3, 0x1000)
    timer.join()
    bus.close()
    bus.close()


def test_bus_off_is_an_error_at_once():
    wire = MemoryBus.get("off")
    with DirectBus.open("memory:off", label="cli", timeout_s=30) as bus:
        timer = threading.Timer(0.05, lambda: wire.bus_off("cli"))
        timer.start()
        with pytest.raises(BusOff):
            bus.read(3, 0x1000)
        timer.join()


def test_a_silence_on_a_channel_that_is_down_is_reported_as_that():
    MemoryBus.get("down")
    with DirectBus.open("memory:down", timeout_s=0.05, retries=0) as bus:
        bus.port.events = lambda: [BusEvent(BusEventKind.DOWN, "bus x: unplugged")]
        bus._check_events()
        with pytest.raises(BusError, match="bus x: unplugged; node 3 could not be read"):
            bus.read(3, 0x1000)
        bus.port.events = lambda: [BusEvent(BusEventKind.UP, "")]
        bus._check_events()
        with pytest.raises(SdoTimeout):
            bus.read(3, 0x1000)


@pytest.mark.sources  # a method is replaced
def test_the_segments_of_a_block_upload_are_taken_at_once(bus, monkeypatch):
    data = bytes(n % 251 for n in range(127 * 7 * 5))
    bus.write(5, 0x2000, 0, data, block=True)
    client, taken = bus.client(5), []
    receive = client.receive
    monkeypatch.setattr(client, "receive", lambda frame, now: (taken.append(frame), receive(frame, now)))
    assert bus.read(5, 0x2000, block=True) == data
    assert len([frame for frame in taken if frame.can_id == 0x585]) == 5 + 2  # a sub-block's last, initiate, end
    assert client.ignored == 0


def test_a_heartbeat_among_the_segments_is_received_and_disturbs_nothing(bus, monkeypatch):
    data = bytes(n % 251 for n in range(127 * 7 * 3))
    bus.write(5, 0x2000, 0, data, block=True)
    receive, heartbeat = bus.port.receive, pack_records([CanFrame(0x709, b"\5")])

    def interrupted():
        records = receive()
        return records[: 16 * 30] + heartbeat + records[16 * 30 :] if len(records) > 16 * 30 else records

    monkeypatch.setattr(bus.port, "receive", interrupted)
    assert bus.read(5, 0x2000, block=True) == data
    assert bus.states == {9: NmtState.OPERATIONAL}
    assert (bus.client(5).retried, bus.client(5).ignored) == (0, 0)


def test_a_node_received_in_stopped_is_not_asked_whether_it_is_powered(bus, drives):
    bus.write(3, 0x1017, 0, b"\x14\0")
    bus.command(NmtCommand.STOP, 3, 0.5)
    with pytest.raises(SdoStopped, match=r"node 3: 0x1000:00: no answer .* NMT STOPPED, .* `nmt preop`"):
        bus.read(3, 0x1000)
    assert isinstance(bus.read_many([(3, 0x1000, 0)])[3, 0x1000, 0], SdoStopped)
    bus.command(NmtCommand.ENTER_PRE_OPERATIONAL, 3, 0.5)
    assert bus.read(3, 0x1000)


class Restarting:
    """A device that takes the beginning of a block download, and boots after some of its segments."""

    def __init__(self, after):
        self.out, self._left = [], after

    def receive(self, frame, now):
        if frame.can_id != 0x609:
            return
        if frame.data[0] & 0xE1 == 0xC0:
            self.out.append(CanFrame(0x589, b"\xa4" + frame.data[1:4] + b"\x7f\0\0\0"))
            return
        self._left -= 1
        if not self._left:
            self.out.append(CanFrame(0x709, b"\0"))

    def tick(self, now):
        pass

    def next_deadline(self):
        return None

    def frames(self):
        out, self.out = self.out, []
        return out


def test_a_node_that_boots_in_the_middle_of_a_transfer_is_not_waited_for():
    device = Restarting(after=30)
    with (
        OnBus("memory:restarting", cores=(device,)),
        DirectBus.open("memory:restarting", timeout_s=1000.0) as bus,
        pytest.raises(SdoRestarted, match="node 9: 0x1F50:01: the node restarted during the transfer"),
    ):
        bus.write(9, 0x1F50, 1, bytes(20_000), block=True)


def test_a_request_that_came_before_the_boot_up_is_made_again():
    with (
        OnBus("memory:booting", {5: GENERIC}, (Stubborn(),)) as others,
        DirectBus.open("memory:booting", timeout_s=0.3) as bus,
    ):
        others.send(CanFrame(0x705, b"\0"))
        assert bus.read(5, 0x1000)
