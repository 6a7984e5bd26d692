"""Requests of gateway clients against a network, and the service of one client after the other on a real socket."""

import contextlib
import socket
import threading

import pytest

from canopen_control.cia301.lss import LssIdentity, LssMaster, LssMode, LssSlave
from canopen_control.cia301.nmt import NmtCommand
from canopen_control.errors import (
    BusClosed,
    BusOff,
    ConfigError,
    RemoteError,
    SdoAbort,
    SdoStopped,
    SdoTimeout,
    UnknownName,
)
from canopen_control.frame import CanFrame
from canopen_control.gateway.dialect import GatewayDialect
from canopen_control.gateway.serving import BusLog, GatewayService
from canopen_control.host import sockets

NEW = LssIdentity(0x286, 0x4F6, 0x3001A, 77)
SECOND = LssIdentity(0x286, 0x4F6, 0x3001A, 78)


class Network:
    """Objects of node 4, LSS slaves, and what was asked; `gone` ends it as a robot does that was shut down."""

    def __init__(self, *slaves):
        self.asked, self.slaves, self.error = [], slaves, None
        self.objects = {(4, 0x1000, 0): bytes.fromhex("9201ffff"), (4, 0x1008, 0): b'A "b"\r\n\0'}
        self._ours = self._theirs = None  # of the connection to the robot

    def connect(self):
        self._ours, self._theirs = socket.socketpair()
        self._ours.setblocking(False)

    def fileno(self):
        return self._ours.fileno()

    def gone(self):
        self._theirs.close()

    def take_in(self):
        with contextlib.suppress(BlockingIOError):
            self._ours.recv(1)
            raise RemoteError("BusClosed", "robot x has closed the connection")

    def read(self, node_id, index, subindex, *, block, timeout_s):
        self.asked.append((node_id, index, subindex, block, timeout_s))
        if self.error is not None:
            raise self.error
        if (node_id, index, subindex) not in self.objects:
            raise SdoAbort(node_id, index, subindex, 0x06020000)
        return self.objects[node_id, index, subindex]

    def write(self, node_id, index, subindex, data, *, block, timeout_s):
        self.asked.append((node_id, index, subindex, data, block, timeout_s))

    def nmt(self, command, node_id):
        self.asked.append((command, node_id))

    def lss(self, ask, scan_s=None):
        master, now = LssMaster(timeout_ns=1, scan_timeout_ns=1), 0
        request = ask(master)
        while not request.done:
            master.tick(now)
            for frame in master.frames():
                for slave in self.slaves:
                    slave.receive(frame, now)
                    slave.events()
                    for answer in slave.frames():
                        master.receive(answer, now)
            now += 1
        self.asked.append((request.name, scan_s))
        if request.error is not None:
            raise request.error
        return request.result

    def log(self):
        return ["12:00:00 node 4: boot-up"]


def said(network, *lines, allow_motion=True):
    """Return the answers to lines of one client."""
    service = GatewayService(network, allow_motion=allow_motion)
    return list(service.answers(GatewayDialect(), "".join(f"{line}\n" for line in lines).encode()))


def test_objects_are_read_and_written_by_their_types():
    network = Network()
    lines = ["[1] 4 r 0x1000 0", "[2] 4 r 0x1000 0 i32", "[3] 4 r 0x1008 0 vs", "[4] 4 w 0x1017 0 u16 500", "[5] log"]
    assert said(network, *lines) == [
        b"[1] 92 01 FF FF\r\n",
        b"[2] -65134\r\n",
        b'[3] "A ""b""\n"\r\n',
        b"[4] OK\r\n",
        b"12:00:00 node 4: boot-up\r\n",
    ]
    assert network.asked[-1] == (4, 0x1017, 0, b"\xf4\x01", False, 0.5)


def test_time_out_and_block_transfer_are_those_that_the_client_has_set():
    network = Network()
    said(network, "[1] set sdo_timeout 1500", "[2] set sdo_block 1", "[3] 4 r 0x1000 0")
    assert network.asked == [(4, 0x1000, 0, True, 1.5)]


@pytest.mark.parametrize(
    ("error", "answer"),
    [
        (SdoAbort(4, 0x1000, 0, 0x06090030), b"ERROR:0x06090030 #Invalid value for parameter."),
        (SdoTimeout(4, 0x1000, 0, 0.5), b"ERROR:0x05040000 #SDO protocol timed out."),
        (SdoStopped(SdoTimeout(4, 0x1000, 0, 0.5)), b"ERROR:0x05040000 #SDO protocol timed out."),
        (RemoteError("SdoAbort", str(SdoAbort(4, 0x1000, 0, 0x06010001))), b"ERROR:0x06010001 #Attempt to read a wri"),
        (RemoteError("SdoTimeout", "no answer"), b"ERROR:0x05040000 #SDO protocol timed out."),
        (RemoteError("Timeout", "robot x has not answered"), b"ERROR:0x05040000 #SDO protocol timed out."),
        (
            RemoteError("ControlError", "a stop is latched"),
            b"ERROR:102 #Request not processed due to internal state. a",
        ),
        (UnknownName("no node 4"), b"ERROR:107 #Unsupported node. no node 4"),
        (BusOff("can0"), b"ERROR:301 #Bus off. bus can0: bus-off"),
        (ConfigError("node 4 belongs to robot x"), b"ERROR:102 #Request not processed due to internal state. node 4"),
    ],
)
def test_an_error_of_the_bus_is_an_answer(error, answer):
    network = Network()
    network.error = error
    (text,) = said(network, "[1] 4 r 0x1000 0")
    assert text.startswith(b"[1] " + answer)
    assert text.endswith(b"\r\n")


def test_the_end_of_the_bus_is_none():
    network = Network()
    network.error = BusClosed("can0")
    with pytest.raises(BusClosed):
        said(network, "[1] 4 r 0x1000 0")


@pytest.mark.parametrize(
    "line",
    [
        *("4 start", "4 stop", "0 preop", "4 reset node", "4 reset comm"),
        *(f"4 w {index} 0 u8 1" for index in ("0x6040", "0x6060", "0x607A", "0x6840", "0x6200", "0x9FFF")),
        *(f"4 w {index} 1 u8 1" for index in ("0x1400", "0x1600", "0x1A00", "0x1016", "0x1006", "0x1F51")),
        *("lss_set_node 5", "lss_conf_bitrate 0 2", "lss_activate_bitrate 100", "lss_store", "lss_allnodes"),
    ],
)
def test_what_may_move_a_drive_is_refused_without_the_option_that_the_answer_names(line):
    network = Network()
    (text,) = said(network, f"[1] {line}", allow_motion=False)
    assert text.startswith(b"[1] ERROR:102 #Request not processed due to internal state. ")
    assert b"start the gateway with --allow-motion" in text
    assert network.asked == []


@pytest.mark.parametrize("line", ["4 r 0x6041 0", "4 w 0x1017 0 u16 1", "4 w 0x2000 0 u8 1", "4 w 0xA000 0 u8 1"])
def test_what_cannot_move_one_is_not(line):
    network = Network()
    said(network, f"[1] {line}", allow_motion=False)
    assert len(network.asked) == 1


def test_nmt_commands_reach_their_node():
    network = Network()
    assert said(network, "[1] 4 start", "[2] 0 reset node") == [b"[1] OK\r\n", b"[2] OK\r\n"]
    assert network.asked == [(NmtCommand.START, 4), (NmtCommand.RESET_NODE, 0)]


def test_lss_finds_a_slave_and_configures_it():
    stored = []
    slave = LssSlave(NEW, store=lambda node_id, bitrate: stored.append((node_id, bitrate)) or True)
    network = Network(slave)
    lines = ["_lss_fastscan 20", "lss_set_node 42", "lss_conf_bitrate 0 2", "lss_store", "lss_inquire_addr 3"]
    lines += ["lss_inquire_addr", "lss_activate_bitrate 10", "lss_switch_glob 0", "lss_switch_glob 1", "lss_get_node"]
    assert said(network, *(f"[68] {line}" for line in lines)) == [
        b"[68] 0x00000286 0x000004F6 0x0003001A 0x0000004D\r\n",
        *[b"[68] OK\r\n"] * 3,
        b"[68] 0x0000004D\r\n",
        b"[68] 0x00000286 0x000004F6 0x0003001A 0x0000004D\r\n",
        *[b"[68] OK\r\n"] * 3,
        b"[68] 0x2A\r\n",
    ]
    assert stored == [(42, 500_000)]
    assert network.asked[0] == ("fast scan", 0.02)


def test_lss_errors_have_the_numbers_of_their_commands():
    slave = LssSlave(NEW, 5, bit_timings=frozenset({2}))
    identity = " ".join(map(str, NEW))
    lines = ["lss_store", f"lss_switch_sel {identity}", "lss_conf_bitrate 0 0", "lss_store", "_lss_fastscan"]
    answers = said(Network(slave), *(f"[1] {line}" for line in lines))
    assert [text[: text.find(b" #")] for text in answers[:1] + answers[2:]] == [
        b"[1] ERROR:102",
        b"[1] ERROR:503",
        b"[1] ERROR:504",
        b"[1] ERROR:102",
    ]
    assert answers[1] == b"[1] OK\r\n"
    assert said(Network(slave), "[1] lss_switch_sel 1 2 3 4", "[2] _lss_fastscan") == [
        b"[1] ERROR:103 #Time-out.\r\n",
        b"[2] ERROR:103 #Time-out.\r\n",
    ]
    for code, number in ((1, 502), (255, 501), (2, 505)):
        slave = LssSlave(NEW)
        slave._configure_node_id = None
        slave._CONFIGURING = {
            **slave._CONFIGURING,
            0x11: lambda self, data, code=code: self.outgoing.put(CanFrame(0x7E4, bytes((0x11, code)) + bytes(6))),
        }
        answers = said(Network(slave), "[1] lss_switch_glob 1", "[2] lss_set_node 5")
        assert answers[1].startswith(f"[2] ERROR:{number} #LSS ".encode())


def test_all_slaves_without_a_node_id_get_one_each_and_the_answer_is_one_piece():
    slaves = [LssSlave(identity, store=lambda *_: True) for identity in (NEW, SECOND)]
    (text,) = said(Network(*slaves), "[70] lss_allnodes 20 5 1")
    assert text == (
        b"# Node-ID 5 assigned to: 0x00000286 0x000004F6 0x0003001A 0x0000004D\n"
        b"# Node-ID 6 assigned to: 0x00000286 0x000004F6 0x0003001A 0x0000004E\n"
        b"# Found 2 nodes, search finished.\n[70] OK\r\n"
    )
    assert [(slave.node_id, slave.mode) for slave in slaves] == [(5, LssMode.WAITING), (6, LssMode.WAITING)]


def test_a_slave_that_refuses_to_store_does_not_stay_in_configuration_state():
    slave = LssSlave(NEW, store=lambda *_: False)
    (text,) = said(Network(slave), "[71] lss_allnodes 20 5 1")
    assert text.startswith(b"[71] ERROR:50")
    assert slave.mode is LssMode.WAITING


def test_the_search_ends_at_node_127_and_scans_what_it_is_reported():
    slaves = [LssSlave(identity, store=lambda *_: True) for identity in (NEW, SECOND)]
    (text,) = said(Network(*slaves), "[7] lss_allnodes 0 127 0 2 0x286 0 0 1 0 2 78")
    assert text.endswith(b"0x0000004E\n# Not all nodes scanned!\n[7] OK\r\n")
    assert [slave.node_id for slave in slaves] == [255, 127]


def test_the_log_has_boot_ups_states_and_emergencies_once():
    log = BusLog()
    for can_id, data in (
        (0x704, b"\0"),
        (0x704, b"\x7f"),
        (0x704, b"\x7f"),
        (0x084, bytes.fromhex("3081110000000000")),
    ):
        log.receive(CanFrame(can_id, data), 0)
    texts = [line.split(" ", 1)[1] for line in log.take()]
    assert texts[:2] == ["node 4: boot-up", "node 4: PRE OPERATIONAL"]
    assert texts[2].startswith("node 4: EMCY 0x8130 (")
    assert log.take() == []


# -- the socket


@pytest.fixture
def served(tmp_path):
    """Serve a socket on a thread; yields its path, and checks that the end of the robot ends the service."""
    network, path, ends = Network(), tmp_path / "gateway.sock", []
    listener = sockets.listen(path)
    network.connect()

    def serve():
        try:
            GatewayService(network).serve_listener(listener)
        except RemoteError as error:
            ends.append(error.kind)

    thread = threading.Thread(target=serve)
    thread.start()
    yield path, network
    network.gone()
    thread.join(60)
    sockets.close_listener(listener)
    network._ours.close()
    assert ends == ["BusClosed"]


def connected(path):
    client = sockets.connect(path)
    client.settimeout(60)
    return client


def cocomm(client, number, command):
    """Send a command as CANopenNode's cocomm does, and decide as it does by one read; returns value and exit code."""
    client.sendall(f"[{number}] {command}\n".encode())
    answer = client.recv(1000)
    if not answer.endswith(b"\r\n"):
        return answer, 1
    if b"] ERROR:" in answer:
        return answer, 1
    return (b"" if b"] OK" in answer else answer[answer.index(b"] ") + 2 : -2]), 0


def test_cocomm_gets_values_ok_and_errors_by_one_read_each(served):
    with connected(served[0]) as client:
        assert cocomm(client, 1, "set node 4") == (b"", 0)
        assert cocomm(client, 2, "r 0x1000 0 u32") == (b"4294902162", 0)
        assert cocomm(client, 3, "r 0x2000 0") == (b"[3] ERROR:0x06020000 #Object does not exist.\r\n", 1)
        assert cocomm(client, 4, "start")[1] == 1
        client.sendall(b"\n")
        assert client.recv(100) == b"\r\n"
        client.sendall(b"[5] r 0x1000 0 u32\n[6] set node 5\n")  # answered in order
        answers = b""
        while answers.count(b"\n") < 2:
            answers += client.recv(100)
        assert answers == b"[5] 4294902162\r\n[6] OK\r\n"


def test_a_second_client_waits_for_the_first_one_and_has_defaults_of_its_own(served):
    first, second = connected(served[0]), connected(served[0])
    with second:
        with first:
            assert cocomm(first, 1, "set node 4") == (b"", 0)
            second.sendall(b"[2] r 0x1000 0\n")
            assert cocomm(first, 3, "r 0x1000 0 x32") == (b"0xFFFF0192", 0)
        assert second.recv(100) == b"[2] ERROR:105 #No default node set.\r\n"


def test_a_client_that_dies_in_a_line_or_sends_no_text_harms_no_other(served):
    path, network = served
    for nonsense in (b"[1] 4 w 0x2000 0 u8 1", b"\0\xff\xfe" * 100, b"x" * 200_000, b"[1] 4 r 0x1000 0\n" * 50):
        with connected(path) as client:
            client.sendall(nonsense)
    with connected(path) as client:
        assert cocomm(client, 1, "4 r 0x1000 0 u32") == (b"4294902162", 0)
    assert not any(len(item) == 6 for item in network.asked)  # nothing was written


def test_a_page_in_a_browser_cannot_send_commands(served):
    path, network = served
    with connected(path) as client:
        client.sendall(b"POST / HTTP/1.1\r\nHost: localhost\r\n\r\n[1] 4 r 0x1000 0\n")
        with contextlib.suppress(ConnectionResetError):
            assert client.recv(100) == b""
    assert network.asked == []
