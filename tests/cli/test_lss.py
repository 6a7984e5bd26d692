"""The verb lss, with slaves on the bus."""

import json

import pytest
from support.host import eventually
from support.onbus import TMCM, OnBus

from canopen_control.cia301.lss import LssIdentity, LssMode, LssSlave
from canopen_control.cli import lss as verb
from canopen_control.cli.main import main

ON_BUS = ["--can", "memory:lss"]
NEW = LssIdentity(0x286, 0x4F6, 0x3001A, 77)
OTHER = LssIdentity(0x286, 0x4F6, 0x3001A, 78)


class Slaves:
    def __init__(self):
        self.stored = []
        self.new = LssSlave(NEW, store=lambda node_id, bitrate: self.stored.append((node_id, bitrate)) or True)
        self.other = LssSlave(OTHER, 5)


@pytest.fixture
def slaves(private_folders):
    slaves = Slaves()
    with OnBus("memory:lss", cores=(slaves.new, slaves.other)):
        yield slaves


def lss(*arguments):
    return main(["lss", *arguments, *ON_BUS])


def test_a_new_slave_gets_a_node_id_and_a_bit_rate(slaves, capsys):
    known = ["--vendor", "0x286", "--product", "0x4F6", "--revision", "0x3001A"]
    assert lss("find") == 0
    assert lss("fast-scan", *known, "--serial", "77") == 0
    assert lss("node-id", "9") == 0
    assert lss("bit-timing", "500000") == 0
    assert lss("store") == 0
    assert lss("inquire", "serial") == 0
    assert lss("switch", "waiting") == 0
    text = capsys.readouterr().out.splitlines()
    assert text[1] == "vendor 0x00000286, product 0x000004F6, revision 0x0003001A, serial 0x0000004D: in configuration"
    assert text[4:6] == ["stored", "serial: 77 (0x0000004D)"]
    assert (slaves.new.pending_node_id, slaves.new.pending_bitrate) == (9, 500_000)
    assert eventually(lambda: slaves.new.mode is LssMode.WAITING)  # unconfirmed
    assert slaves.stored == [(9, 500_000)]
    assert slaves.other.pending_node_id == 5


def test_a_node_id_that_another_node_has_is_refused(private_folders, capsys):
    slave = LssSlave(NEW)
    with OnBus("memory:lss", {9: TMCM}, cores=(slave,)):
        assert lss("fast-scan", "--vendor", "0x286", "--product", "0x4F6", "--revision", "0x3001A") == 0
        assert lss("node-id", "9") == 2
        assert "node-ID 9 already answers on memory:lss" in capsys.readouterr().err
        assert lss("node-id", "10") == 0
    assert slave.pending_node_id == 10


def test_a_scan_without_any_knowledge_finds_the_slave(slaves, capsys):
    assert lss("fast-scan", "--json", "--vendor", "0x286", "--product", "0x4F6") == 0
    assert json.loads(capsys.readouterr().out) == NEW._asdict()


def test_one_slave_of_several_is_switched_by_its_identity(slaves, capsys):
    identity = ["--vendor", "0x286", "--product", "1270", "--revision", "196634", "--serial", "78"]
    assert lss("switch", "configuration", *identity) == 0
    assert (slaves.other.mode, slaves.new.mode) == (LssMode.CONFIGURATION, LssMode.WAITING)
    capsys.readouterr()
    assert lss("inquire") == 0
    assert capsys.readouterr().out.splitlines() == [
        "vendor: 646 (0x00000286)",
        "product: 1270 (0x000004F6)",
        "revision: 196634 (0x0003001A)",
        "serial: 78 (0x0000004E)",
        "node-id: 5 (0x05)",
    ]
    assert lss("inquire", "--json") == 0
    assert json.loads(capsys.readouterr().out) == {**OTHER._asdict(), "node_id": 5}


def test_a_slave_without_a_node_id_reports_this(slaves, capsys):
    slaves.new.mode = LssMode.CONFIGURATION
    assert lss("inquire", "node-id") == 0
    assert capsys.readouterr().out == "node-id: none (0xFF)\n"


def test_all_slaves_are_switched_and_activated_without_an_answer(slaves):
    assert lss("switch", "configuration") == 0
    assert eventually(lambda: {slaves.new.mode, slaves.other.mode} == {LssMode.CONFIGURATION})
    slaves.other.mode = LssMode.WAITING
    assert lss("bit-timing", "250000") == 0
    assert lss("activate", "10") == 0


def test_a_slave_that_refuses_is_an_error(slaves, capsys):
    slaves.new.bit_timings = frozenset({0})
    slaves.new.mode = LssMode.CONFIGURATION
    assert lss("bit-timing", "10000") == 1
    assert "refused, not supported or out of range" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["find"], 1, "answers on memory:empty to identify non-configured or fast scan within 0.1 s each; for a slave"),
        (["fast-scan"], 1, "no slave without a node-ID answers on memory:empty to a fast scan; for a slave that has"),
        (["inquire", "vendor"], 1, "no answer; check that one slave is connected and in the configuration state"),
        (["node-id", "200"], 2, "node-ID 200 is not valid: use 1 to 127, or 255 for none"),
        (["node-id", "x"], 2, "is not a whole number of at most 32 bits, decimal or 0x"),
        (["bit-timing", "3"], 2, "bit rate '3': LSS supports 1000000, 800000"),
        (["activate", "70000"], 2, "delay 70000 ms: valid are 0 to 65535"),
        (["switch", "configuration", "--vendor", "1"], 2, "add --product, --revision, --serial"),
        (["switch", "sideways"], 2, "invalid choice: 'sideways'"),
        (["switch", "configuration", "--vendor", "0x100000000"], 2, "of at most 32 bits"),
        (
            ["switch", "waiting", "--vendor", "1", "--product", "1", "--revision", "1", "--serial", "1"],
            2,
            "a single slave cannot be switched to waiting",
        ),
    ],
)
def test_what_does_not_work_is_one_sentence(private_folders, arguments, code, text, capsys):
    try:
        result = main(["lss", *arguments, "--can", "memory:empty"])
    except SystemExit as stop:  # argparse
        result = stop.code
    error = capsys.readouterr().err
    assert (result, text in error) == (code, True), error


def test_find_tries_a_fast_scan_too_and_its_advice_works(slaves, monkeypatch, capsys):
    assert lss("find") == 0
    assert "(they answer to identify non-configured)" in capsys.readouterr().out
    monkeypatch.setattr(LssSlave, "_SERVICES", {**LssSlave._SERVICES, 0x4C: lambda *_: None})  # as some slaves do
    assert lss("find", "--json") == 0
    assert json.loads(capsys.readouterr().out) == {"unconfigured": True, "service": "fast scan"}
    assert lss("find") == 0
    output = capsys.readouterr().out
    assert "(they answer to fast scan); find one of them: " in output
    assert slaves.new.mode is LssMode.WAITING
    known = ["--vendor", "0x286", "--product", "0x4F6", "--revision", "0x3001A", "--serial", "77"]
    assert main([*output.split("canopen-control ")[1].split(), *known]) == 0
    assert slaves.new.mode is LssMode.CONFIGURATION


def test_the_bus_may_stand_before_the_action_and_must_be_named(slaves, capsys):
    assert main(["lss", *ON_BUS, "find"]) == 0
    assert main(["lss", "find"]) == 2
    assert "name the bus: canopen-control lss find --can CHANNEL" in capsys.readouterr().err


def test_the_bus_of_a_running_robot_is_left_alone(monkeypatch, private_folders, capsys):
    monkeypatch.setattr(verb, "robot_on", lambda channel: ("robby", {}))
    assert lss("store") == 2
    assert "robot robby runs on memory:lss" in capsys.readouterr().err
