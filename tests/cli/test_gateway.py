"""The verb gateway: on a bare bus, on a running robot, and as a process behind a socket."""

import os
import socket
import stat
import sys

import pytest
from support.host import eventually
from support.liverobot import STRANGER, live_robot
from support.onbus import GENERIC, OnBus

from canopen_control.cia301.lss import LssIdentity, LssSlave
from canopen_control.cia301.nmt import NmtState
from canopen_control.cli.main import main
from canopen_control.host import sockets

ON_BUS = ["--can", "memory:gateway"]
NEW = LssIdentity(0x286, 0x4F6, 0x3001A, 77)


@pytest.fixture
def bus(private_folders):
    with OnBus("memory:gateway", {4: GENERIC}, cores=(LssSlave(NEW),)) as drives:
        yield drives


@pytest.fixture
def gateway(monkeypatch, capfdbinary):
    """Run the verb with lines on its standard input; returns exit code, answers and standard error."""

    def run(*arguments, lines):
        source, sink = os.pipe()
        os.write(sink, lines)
        os.close(sink)
        with open(source) as stdin:
            monkeypatch.setattr(sys, "stdin", stdin)
            code = main(["gateway", *arguments])
        output = capfdbinary.readouterr()
        return code, output.out, output.err.decode()

    return run


def test_a_bare_bus_is_served_on_standard_input(bus, gateway):
    lines = b"[1] 4 r 0x1000 0 x32\n4 r 0x4444 0\n\n[3] 4 w 0x1017 0 u16 500\n[4] 4 r 0x1017 0 u16\n"
    lines += b"[5] lss_switch_sel 646 0x4F6 0x3001A 77\n[6] lss_inquire_addr\n"
    assert gateway(*ON_BUS, lines=lines) == (
        0,
        b"[1] 0x00020192\r\n[0] ERROR:0x06020000 #Object does not exist.\r\n\r\n[3] OK\r\n[4] 500\r\n"
        b"[5] OK\r\n[6] 0x00000286 0x000004F6 0x0003001A 0x0000004D\r\n",
        "",
    )


def test_nothing_that_may_move_a_drive_is_sent_without_the_option(bus, gateway):
    code, answers, _ = gateway(*ON_BUS, lines=b"[1] 4 start\n[2] 4 w 0x6060 0 i8 3\n")
    assert code == 0
    assert [line.count(b"--allow-motion") for line in answers.splitlines()] == [1, 1]
    assert bus.call(lambda: bus.nodes[4].nmt.state) is NmtState.PRE_OPERATIONAL
    lines = b"[1] 4 w 0x1017 0 u16 5\n[2] 4 start\n[3] 4 w 0x6060 0 i8 3\n[4] 4 r 0x6060 0 i8\n"
    code, answers, _ = gateway(*ON_BUS, "--allow-motion", lines=lines)
    assert answers == b"[1] OK\r\n[2] OK\r\n[3] OK\r\n[4] 3\r\n"
    assert eventually(lambda: bus.call(lambda: bus.nodes[4].nmt.state) is NmtState.OPERATIONAL)


def test_half_a_line_at_the_end_is_not_carried_out(bus, gateway):
    code, answers, error = gateway(*ON_BUS, lines=b"[1] 4 w 0x1017 0 u16 7")
    assert (code, answers) == (1, b"")
    assert error == ("canopen-control: standard input ended in the middle of a line, which was not carried out\n")


def test_the_nodes_of_a_running_robot_are_served_and_it_continues(private_folders, gateway):
    with live_robot("gwrobot") as drives:
        code, answers, _ = gateway(
            lines=b"[1] 3 r 0x1018 1 x32\n[2] 9 r 0x1000 0\n[3] 3 r 0x4444 0\n[4] lss_switch_glob 1\n[5] 3 preop\n"
        )
        assert code == 0
        first, *others = answers.splitlines()
        assert first == b"[1] 0x00000286"
        assert [line.split(b" #")[0] for line in others] == [
            b"[2] ERROR:107",
            b"[3] ERROR:0x06020000",
            b"[4] ERROR:102",
            b"[5] ERROR:102",
        ]
        assert b"canopen-control shutdown --name gwrobot" in answers
        assert drives.call(lambda: drives.nodes[3].nmt.state) is NmtState.OPERATIONAL


def test_nmt_through_a_robot_is_confirmed_or_204(private_folders, gateway):
    with live_robot("gwnmt") as drives:
        lines = b"[1] 3 preop\n[2] 3 start\n[3] 3 w 0x1017 0 u16 100\n[4] log\n"
        code, answers, _ = gateway("--allow-motion", lines=lines)
        assert (code, answers.splitlines()[:3]) == (0, [b"[1] OK", b"[2] OK", b"[3] OK"])
        assert b"left_drive: " in answers
        drives.call(lambda: setattr(drives.nodes[3].nmt, "command", lambda command: False))
        code, answers, _ = gateway("--allow-motion", lines=b"[1] 3 stop\n")
        assert answers.startswith(b"[1] ERROR:204 #Wrong NMT state. node 3 (left_drive): STOPPED is not shown within")


def test_on_the_bus_of_a_robot_only_other_nodes_are_served(private_folders, gateway):
    with live_robot("gwowner"):
        lines = f"[1] {STRANGER} r 0x1000 0 u32\n[2] 3 r 0x1000 0\n[3] 0 stop\n[4] lss_switch_glob 0\n".encode()
        code, answers, _ = gateway("--can", "memory:gwowner", "--allow-motion", lines=lines)
    assert code == 0
    first, *others = answers.splitlines()
    assert first == b"[1] 131474"
    assert all(b"ERROR:102" in line and b"robot gwowner" in line for line in others), others


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["--name", "none"], 2, "no robot 'none' is running"),
        (["--can", "nonsense"], 2, "no such CAN interface"),
        ([*ON_BUS, "--tcp", "70000"], 2, "port: 0 to 65535"),
        ([*ON_BUS, "--tcp", "1", "--unix", "x"], 2, "not allowed with argument"),
        ([*ON_BUS, "--unix", "no/such/folder/x"], 2, "no folder no/such/folder for the socket"),
        ([*ON_BUS, "--unix", "a_file"], 2, "a_file is not a socket; remove it"),
        ([*ON_BUS, "--unix", "x" * 200], 2, "choose another path"),
        ([*ON_BUS, "--unix", "open/x"], 2, "every user may replace files in open"),
    ],
)
def test_what_does_not_work_is_one_sentence(bus, tmp_path, monkeypatch, arguments, code, text, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a_file").write_text("kept")
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    try:
        result = main(["gateway", *arguments])
    except SystemExit as stop:  # argparse
        result = stop.code
    error = capsys.readouterr().err
    assert (result, text in error) == (code, True), error
    assert (tmp_path / "a_file").read_text() == "kept"


def test_an_address_in_use_is_named(bus, tmp_path, capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert main(["gateway", *ON_BUS, "--tcp", str(port)]) == 1
    assert f"port {port} of 127.0.0.1: Address already in use; choose another one" in capsys.readouterr().err
    listener = sockets.listen(tmp_path / "taken")
    try:
        assert main(["gateway", *ON_BUS, "--unix", str(tmp_path / "taken")]) == 1
    finally:
        sockets.close_listener(listener)
    assert "taken is in use by process" in capsys.readouterr().err


def asked(client, line):
    client.sendall(line + b"\n")
    return client.recv(1000)


@pytest.mark.process
@pytest.mark.rest
def test_processes_serve_sockets_until_ctrl_c_or_the_end_of_the_robot(stage):
    stage.robby("gwp")
    private = stage.start("gateway", "--unix")
    path = private.until("CiA 309-3 at").split(" at ")[1].split(";")[0]
    status = os.lstat(path)
    assert (stat.S_IMODE(status.st_mode), stat.S_IMODE(os.lstat(os.path.dirname(path)).st_mode)) == (0o600, 0o700)
    local = stage.start("gateway", "--tcp", 0)
    port = int(local.until("CiA 309-3 at 127.0.0.1:").split("127.0.0.1:")[1].split(";")[0])
    assert "every user and program of this computer can reach robot gwp" in local.err
    with socket.create_connection(("127.0.0.1", port)) as client:
        assert asked(client, b"[1] 3 r 0x1018 1 x32") == b"[1] 0x00000286\r\n"
        local.send(2)  # Ctrl-C while a client is connected
        assert local.wait() == 0
        assert client.recv(100) == b""
    with sockets.connect(path) as client:
        client.settimeout(60)
        assert asked(client, b"[1] 2 r 0x1018 1 x32") == b"[1] 0x00000286\r\n"
        assert b"--allow-motion" in asked(client, b"[2] 2 start")
        assert stage.call("stop").wait() == 0
        stage.call("shutdown")
        assert private.wait() == 1
        assert client.recv(100) == b""
    assert private.err == "canopen-control: robot gwp has closed the connection; it was shut down or killed\n"
    assert not os.path.exists(path)
