"""The verb fault, on a virtual drive that runs in a thread."""

from __future__ import annotations

import json

import pytest
from support.virtualbench import served, servo

from canopen_control.cli.main import main
from canopen_control.cli.support.known_nodes import KnownNode
from canopen_control.errors import RemoteError
from canopen_control.virtual.fault_table import FAULTS

CAN = "memory:cli-fault"


@pytest.fixture
def node():
    device = servo(5)
    with served(CAN, device):
        yield device


def test_list_explains_every_fault_in_sentences_and_reports_where_the_wire_is_broken(capsys):
    assert main(["fault", "list"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    for fault in FAULTS.values():
        assert f"{fault.name} {'The drive ' if not fault.does.startswith('its ') else 'Its '}" in text
    assert text.count("A correct master:") == len(FAULTS)
    assert "canopen-control bus fault" in text


def test_list_as_json_has_one_entry_for_each(capsys):
    assert main(["fault", "list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [item["name"] for item in listed] == list(FAULTS)
    assert {key for item in listed for key in item} == {"name", "row", "acts", "does", "reaction", "once"}


def test_a_fault_is_switched_on_and_off_without_a_master(node, capsys):
    assert main(["fault", "5", "drive_fault", "on", "--can", CAN]) == 0
    assert node.drives[0].state.name == "FAULT"
    assert main(["fault", "0x05", "silent", "on", "--can", CAN]) == 0
    assert main(["fault", "5", "--can", CAN]) == 0
    assert main(["fault", "5", "drive_fault", "off", "--can", CAN]) == 0
    assert main(["fault", "5", "silent", "off", "--can", CAN, "--json"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "node 5: drive_fault",
        "node 5: silent, drive_fault",
        "node 5: silent, drive_fault",
        "node 5: silent",
        '{"node_id": 5, "active": []}',
    ]


@pytest.mark.parametrize(("verb", "name"), [("fault", "silent"), ("fault", "drive_fault"), ("quirk", "brake_delay")])
def test_what_is_not_on_cannot_be_switched_off(node, verb, name, capsys):
    assert main([verb, "5", name, "off", "--can", CAN]) == 1
    assert capsys.readouterr().err == f"canopen-control: node 5: nothing was switched off, because {name} was not on\n"


def test_what_a_fault_does_is_a_sentence_whatever_it_is_of(capsys):
    assert main(["fault", "list"]) == 0
    output = capsys.readouterr().out
    assert "The drive its" not in output
    assert "    Its heartbeats are lost (until" in output
    assert "    The drive does not boot after its next reset" in output


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["5", "hartbeat_lost", "on", "--can", CAN], "did you mean 'heartbeat_lost'"),
        (["5", "cut", "on", "--can", CAN], "canopen-control bus fault CHANNEL cut"),
        (["5", "silent", "on"], "--can CHANNEL"),
        (["5", "silent", "on", "--can", "local:a/b"], "local:a/b"),
        (["left_drive", "silent", "on", "--can", CAN], "no node 'left_drive' is known: no robot runs there"),
        (["129", "silent", "on", "--can", CAN], "'129' is not a node-ID"),
        (["list", "silent"], "takes no arguments"),
    ],
)
def test_wrong_usage_is_a_sentence_and_exit_code_2(node, capsys, words, text):
    assert main(["fault", *words]) == 2
    assert text in capsys.readouterr().err


def test_a_fault_without_on_or_off_is_not_switched_and_both_forms_are_named(node, capsys):
    assert main(["fault", "5", "silent", "--can", CAN]) == 2
    assert capsys.readouterr().err == (
        f"canopen-control: add on or off: canopen-control fault 5 silent on --can {CAN}; to list the active ones: "
        f"canopen-control fault 5 --can {CAN}\n"
    )
    assert main(["fault", "5", "silent", "on", "--can", CAN]) == 0
    assert main(["fault", "5", "silent", "--can", CAN]) == 2
    assert main(["fault", "5", "--can", CAN]) == 0
    assert capsys.readouterr().out.splitlines() == ["node 5: silent", "node 5: silent"]


def test_a_drive_that_is_not_there_is_named_with_those_that_are(node, capsys):
    assert main(["fault", "6", "silent", "on", "--can", CAN]) == 1
    assert f"no virtual drive with node-ID 6 runs on {CAN}; available: 5" in capsys.readouterr().err
    assert main(["fault", "6", "silent", "on", "--can", "memory:other"]) == 1
    assert f"available: 5 on the bus {CAN.partition(':')[2]}" in capsys.readouterr().err


def test_without_any_drive_it_suggests_how_to_start_one(private_folders, capsys):
    assert main(["fault", "6", "silent", "on", "--can", "memory:other"]) == 1
    assert "no virtual drive runs; start one with: canopen-control drive" in capsys.readouterr().err


def test_a_drive_of_a_running_robot_has_its_users_names_and_needs_no_channel(node, capsys, monkeypatch):
    known = [KnownNode("robby", CAN, 5, "left_drive", ("left_wheel_joint",))]
    monkeypatch.setattr("canopen_control.cli.support.known_nodes.ask_nodes", lambda _channel: (known, {}))
    assert main(["fault", "left_drive", "silent", "on"]) == 0
    assert main(["fault", "left_wheel_joint", "silent", "off"]) == 0
    assert main(["fault", "5"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "node 5: silent",
        "node 5: no active fault",
        "node 5: no active fault",
    ]
    assert main(["fault", "right_drive", "silent"]) == 2
    assert "no node 'right_drive' of a running robot; available: left_drive (5)" in capsys.readouterr().err


def test_a_robot_that_hangs_is_named_and_its_drives_are_reached_by_their_ids(node, capsys, monkeypatch):
    silent = {"robby": RemoteError("Timeout", "robot robby has not answered 'GetNodes' within 2 s")}
    monkeypatch.setattr("canopen_control.cli.support.known_nodes.ask_nodes", lambda _channel: ([], silent))
    for channel in ([], ["--can", CAN]):
        assert main(["fault", "left_drive", "silent", "on", *channel]) == 2
        error_output = capsys.readouterr().err
        assert (
            "no node 'left_drive' is known: the robot 'robby' does not list its nodes: robot robby has not"
            in error_output
        )
        assert "; with --can CHANNEL a drive is reached by its node-ID, without the robot" in error_output
    assert main(["fault", "5", "silent", "on", "--can", CAN]) == 0
