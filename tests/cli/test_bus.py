"""The verb bus: output and exit codes."""

from __future__ import annotations

import json
import subprocess

import pytest
from support.localbus import receive, runtime_folders

from canopen_control.bus import can_interfaces
from canopen_control.bus.local import open_local
from canopen_control.cli.main import main
from canopen_control.cli.support.known_nodes import KnownNode
from canopen_control.frame import CanFrame, pack_records

pytestmark = pytest.mark.process

VCAN0 = can_interfaces.CanInterface("vcan0", "vcan", is_up=True, traffic={"rx_packets": 3, "rx_dropped": 0})
CAN0 = can_interfaces.CanInterface(
    "can0", "can", is_up=False, state="BUS-OFF", bitrate=500_000, error_counters=(248, 0)
)


@pytest.fixture(autouse=True)
def runtime(monkeypatch):
    monkeypatch.setattr(can_interfaces, "list_can_interfaces", lambda run=None: [VCAN0, CAN0])
    monkeypatch.setattr("canopen_control.cli.bus.find_listeners", lambda name: [])
    with runtime_folders(monkeypatch.setenv) as folder:
        yield folder


@pytest.fixture
def ports():
    ports = [open_local("cli", label) for label in ("robot", "left_drive")]
    yield ports
    for port in ports:
        port.close()


def test_list_names_interfaces_buses_and_adapters(ports, capsys):
    assert main(["bus", "list"]) == 0
    output = capsys.readouterr().out
    assert "vcan0 (up), can0 (down)" in output
    assert "local:cli" in output
    assert "pcan" in output
    assert main(["bus", "list", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["local"] == ["local:cli"]
    assert result["interfaces"][1]["state"] == "BUS-OFF"


def test_status_of_a_local_bus_shows_members_and_counters(ports, capsys):
    ports[0].send(pack_records([CanFrame(0x80)] * 3))
    receive(ports[1], 3)
    assert main(["bus", "fault", "local:cli", "cut", "left_drive"]) == 0
    assert main(["bus", "status", "local:cli"]) == 0
    head, _titles, robot, drive = capsys.readouterr().out.splitlines()
    assert head.startswith("local:cli: process ")
    assert head.endswith("3 frames, 0 dropped")
    assert robot.split()[:1] + robot.split()[2:] == ["robot", "3", "0", "0", "0"]
    assert drive.split()[:1] + drive.split()[2:] == ["left_drive", "0", "3", "0", "0", "cut"]


def test_status_of_an_interface_reports_its_state(capsys):
    assert main(["bus", "status", "can0"]) == 0
    assert capsys.readouterr().out == "can0: can, down, BUS-OFF, 500000 bit/s, transmit errors 248, receive errors 0\n"
    assert main(["bus", "status", "vcan0"]) == 0
    assert capsys.readouterr().out == "vcan0: vcan, up\n  rx_packets 3\n"


def test_a_cut_cable_stops_frames_until_repaired(ports):
    robot, drive = ports
    assert main(["bus", "fault", "local:cli", "cut", "left_drive"]) == 0
    robot.send(pack_records([CanFrame(1)]))
    assert main(["bus", "fault", "local:cli", "uncut", "left_drive"]) == 0
    robot.send(pack_records([CanFrame(2)]))
    assert CanFrame(2) in receive(drive, 1)
    assert drive.stats.rx == 1


def test_dropping_delaying_and_clearing(ports, capsys):
    robot, drive = ports
    assert main(["bus", "fault", "local:cli", "drop", "robot", "--id", "0x181", "--every", "2", "--count", "1"]) == 0
    assert main(["bus", "fault", "local:cli", "delay", "left_drive", "--ms", "1"]) == 0
    assert main(["bus", "status", "local:cli"]) == 0
    output = capsys.readouterr().out
    assert "delay of left_drive: 1 ms" in output
    assert "drop: one in 2 frames 0x181 from robot, 0 of 1 lost" in output
    robot.send(pack_records([CanFrame(0x181, b"1"), CanFrame(0x181, b"2"), CanFrame(0x181, b"3")]))
    assert receive(drive, 2) == [CanFrame(0x181, b"1"), CanFrame(0x181, b"3")]
    drive.send(pack_records([CanFrame(0x703, b"\5")]))
    assert receive(robot, 1) == [CanFrame(0x703, b"\5")]
    assert main(["bus", "fault", "local:cli", "clear"]) == 0
    main(["bus", "status", "local:cli"])
    assert "delay" not in capsys.readouterr().out


@pytest.mark.parametrize("words", [["uncut", "left_drive"], ["restart", "left_drive"], ["clear"]])
def test_a_fault_that_is_not_active_cannot_be_ended(ports, words, capsys):
    assert main(["bus", "fault", "local:cli", *words]) == 1
    error = capsys.readouterr().err
    assert error == f"canopen-control: local:cli: {' '.join(words)}: no such fault is active, nothing was changed\n"


def test_bus_off_and_error_frames(ports):
    _robot, drive = ports
    assert main(["bus", "fault", "local:cli", "bus-off", "left_drive"]) == 0
    assert main(["bus", "fault", "local:cli", "restart", "left_drive"]) == 0
    assert main(["bus", "fault", "local:cli", "error-frame", "left_drive", "--kind", "error-passive"]) == 0
    assert [frame.can_id for frame in receive(drive, 3)] == [0x20000040, 0x20000100, 0x20000204]


def test_the_bit_rate_and_its_load(ports, capsys):
    assert main(["bus", "fault", "local:cli", "bitrate", "500000"]) == 0
    assert main(["bus", "status", "local:cli"]) == 0
    assert ", 500000 bit/s, load 0 %" in capsys.readouterr().out
    ports[0].send(pack_records([CanFrame(5)]))
    assert receive(ports[1], 1) == [CanFrame(5)]
    assert main(["bus", "fault", "local:cli", "bitrate", "off"]) == 0


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["status", "local:none"], 2, "bus local:none: no program has it open"),
        (["status", "virtual:x"], 2, "only local: buses and CAN interfaces have a status"),
        (["status", "can7"], 2, "no CAN interface 'can7'"),
        (["fault", "vcan0", "clear"], 2, "local: buses only"),
        (["fault", "local:none", "bitrate", "fast"], 2, "'fast' is not a bit rate"),
        (["up", "can0", "--bitrate", "x"], 2, "invalid int value"),
        (["up", "vcan0", "--bitrate", "500000"], 2, "has no bit rate"),
        (["down", "can7"], 2, "no CAN interface 'can7'"),
        (["up", "local:x"], 2, "local:x is not a kernel interface"),
        (["down", "slcan:/dev/ttyACM0"], 2, "slcan:/dev/ttyACM0 is not a kernel interface"),
    ],
)
def test_what_does_not_work_is_one_sentence(arguments, code, message, capsys):
    try:
        result = main(["bus", *arguments])
    except SystemExit as stop:  # argparse
        result = stop.code
    assert result == code
    assert message in capsys.readouterr().err


@pytest.fixture
def robby(monkeypatch):
    """A robot runs on the bus, whose virtual drive is there as `drive 3`."""
    known = [KnownNode("robby", "local:cli", 3, "left_drive", ("left_wheel_joint",))]
    monkeypatch.setattr("canopen_control.cli.bus.known_nodes", lambda channel: known if channel == "local:cli" else [])
    ports = [open_local("cli", label) for label in ("master", "drive 3")]
    yield ports
    for port in ports:
        port.close()


@pytest.mark.parametrize("word", ["left_drive", "left_wheel_joint", "3", "drive 3"])
def test_a_virtual_drive_is_disconnected_by_each_of_its_names(robby, word, capsys):
    assert main(["bus", "fault", "local:cli", "cut", word]) == 0
    assert main(["bus", "status", "local:cli"]) == 0
    drive = next(line for line in capsys.readouterr().out.splitlines() if "drive 3" in line)
    assert drive.split()[:3] == ["left_drive", "(drive", "3)"]
    assert drive.endswith("cut")
    assert main(["bus", "fault", "local:cli", "uncut", word]) == 0


def test_a_drive_may_be_repaired_after_its_process_has_gone(robby):
    assert main(["bus", "fault", "local:cli", "cut", "left_drive"]) == 0
    robby[1].close()
    assert main(["bus", "fault", "local:cli", "uncut", "left_drive"]) == 0


def test_delays_and_losses_are_reported_by_these_names(robby, capsys):
    assert main(["bus", "fault", "local:cli", "delay", "left_drive", "--ms", "3"]) == 0
    assert main(["bus", "fault", "local:cli", "drop", "left_drive", "--count", "1"]) == 0
    assert main(["bus", "status", "local:cli"]) == 0
    output = capsys.readouterr().out
    assert "delay of left_drive (drive 3): 3 ms" in output
    assert "1 of 1" not in output
    assert "from left_drive (drive 3), 0 of 1 lost" in output


def test_an_unknown_name_is_answered_with_the_known_ones(robby, capsys):
    assert main(["bus", "fault", "local:cli", "cut", "right_drive"]) == 2
    error_output = capsys.readouterr().err
    assert "no member called 'right_drive' on local:cli; available: master, left_drive (drive 3)" in error_output


def test_up_reports_each_command(monkeypatch, capsys):
    ran = []

    def run(argv, **_options):
        ran.append(" ".join(argv))
        return subprocess.CompletedProcess(argv, 0, "", "")

    monkeypatch.setattr(can_interfaces.subprocess, "run", run)
    monkeypatch.setattr(can_interfaces.os, "geteuid", lambda: 0)
    assert main(["bus", "up", "can0", "--bitrate", "1000000"]) == 0
    assert ran == [
        "ip link set can0 type can bitrate 1000000",
        "ip link set can0 txqueuelen 1000",
        "ip link set can0 up",
    ]
    assert [line.split("   #")[0] for line in capsys.readouterr().out.splitlines()] == ran
