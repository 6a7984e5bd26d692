"""The verb nmt: through a running robot, and directly on a bus."""

import json

import pytest
from support.host import eventually
from support.liverobot import live_robot
from support.mockrobot import running
from support.onbus import GENERIC, TMCM, OnBus

from canopen_control.cia301.nmt import NmtState
from canopen_control.cli.main import main


@pytest.fixture
def bus(private_folders):
    with OnBus("memory:nmt", {3: TMCM, 5: GENERIC}) as drives:
        yield drives


ON_BUS = ["--can", "memory:nmt"]


def state_of(drives, node_id):
    return drives.call(lambda: drives.nodes[node_id].nmt.state)


def test_a_command_reaches_its_node_alone_and_silence_is_reported(bus, capsys):
    assert main(["nmt", "start", "3", *ON_BUS, "--wait", "0.05"]) == 0
    assert capsys.readouterr().out == "node 3: start was sent; no heartbeat confirmed it within 0.05 s\n"
    assert (state_of(bus, 3), state_of(bus, 5)) == (NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL)


@pytest.mark.parametrize("command", ["start", "stop", "reset-comm"])
def test_a_node_that_answers_nothing_is_exit_code_1(bus, command, capsys):
    assert main(["nmt", command, "9", *ON_BUS, "--wait", "0.05"]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(
        f"canopen-control: node 9: {command} was not confirmed within 0.05 s; it sent no heartbeat (nor "
    )
    assert main(["nmt", "stop", "3", *ON_BUS, "--wait", "0.05"]) == 0
    assert capsys.readouterr().out == "node 3: stop was sent; no heartbeat confirmed it within 0.05 s\n"


def test_a_reset_of_all_without_a_boot_up_is_exit_code_1(private_folders, capsys):
    with OnBus("memory:empty", {}):
        assert main(["nmt", "reset-node", "all", "--can", "memory:empty", "--wait", "0.05"]) == 1
        assert capsys.readouterr().out == "reset-node was sent to all; no heartbeat arrived within 0.05 s\n"


@pytest.mark.parametrize(
    ("command", "shown"),
    [
        ("start", "OPERATIONAL"),
        ("stop", "STOPPED"),
        ("preop", "PRE OPERATIONAL"),
        ("reset-node", "has booted"),
        ("reset-comm", "has booted"),
    ],
)
def test_a_heartbeat_or_boot_up_confirms(bus, command, shown, capsys):
    assert main(["sdo", "write", "5", "0x1017", "10", "--type", "u16", *ON_BUS]) == 0
    capsys.readouterr()
    assert main(["nmt", command, "5", *ON_BUS]) == 0
    assert capsys.readouterr().out == f"node 5: {shown}\n"


def test_a_script_reads_json(bus, capsys):
    assert main(["nmt", "start", "3", *ON_BUS, "--wait", "0.05", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == [{"node_id": 3, "state": None, "confirmed": None, "error": None}]
    assert main(["nmt", "reset-node", "all", *ON_BUS, "--wait", "0.3", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert [(item["node_id"], item["state"], item["confirmed"]) for item in result] == [
        (3, "INITIALISING", True),
        (5, "INITIALISING", True),
    ]


def test_all_nodes_of_a_bus(bus, capsys):
    assert main(["nmt", "reset-node", "all", *ON_BUS, "--wait", "0.3"]) == 0
    assert capsys.readouterr().out.splitlines() == ["node 3: has booted", "node 5: has booted"]
    assert main(["nmt", "stop", "all", *ON_BUS, "--wait", "0.05"]) == 0
    assert capsys.readouterr().out == "stop was sent to all; no heartbeat arrived within 0.05 s\n"
    assert eventually(lambda: {state_of(bus, 3), state_of(bus, 5)} == {NmtState.STOPPED})


def test_a_running_robot_obeys_and_boots_a_node_again(private_folders, capsys):
    with live_robot("nmtrobot") as drives:
        assert main(["nmt", "preop", "left_drive"]) == 0
        assert capsys.readouterr().out == "node 3 (left_drive): PRE OPERATIONAL\n"
        assert state_of(drives, 3) is NmtState.PRE_OPERATIONAL
        assert main(["nmt", "start", "3", "--name", "nmtrobot"]) == 0
        assert capsys.readouterr().out == "node 3 (left_drive): OPERATIONAL\n"
        assert state_of(drives, 3) is NmtState.OPERATIONAL
        assert main(["nmt", "reset-comm", "all"]) == 0
        assert capsys.readouterr().out == "node 2 (right_drive): has booted\nnode 3 (left_drive): has booted\n"
        assert main(["nmt", "start", "9"]) == 2
        assert "has no node '9'; its nodes: 2 right_drive, 3 left_drive" in capsys.readouterr().err


def test_a_node_that_does_not_obey_is_named_and_the_exit_code_is_1(private_folders, capsys):
    with live_robot("stubborn") as drives:
        drives.call(lambda: setattr(drives.nodes[3].nmt, "command", lambda command: False))
        assert main(["nmt", "stop", "left_drive", "--wait", "0.5"]) == 1
        error = capsys.readouterr().err
    assert error.startswith("canopen-control: node 3 (left_drive): stop was not confirmed within 0.5 s; it shows")


def test_a_wait_shorter_than_the_answer_of_the_robot_still_reads_the_state_once(private_folders, capsys):
    with live_robot("nmtrobot"):
        assert main(["nmt", "preop", "left_drive", "--wait", "1e-6"]) in (0, 1)
    assert "node 3 (left_drive)" in "".join(capsys.readouterr())


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["start", "3"], "no robot is running"),
        (["start", "left", *ON_BUS], "on a bare bus a node is a number, 1 to 127"),
        (["start", "130", *ON_BUS], "node-IDs are 1 to 127"),
        (["jump", "3", *ON_BUS], "invalid choice: 'jump'"),
        (["start", "3", "--can", "nonsense"], "no such CAN interface"),
        (["start", "3", *ON_BUS, "--wait", "x"], "not a time in seconds above 0"),
        (["start", "3", *ON_BUS, "--name", "x"], "not allowed with argument --can"),
        (["start"], "the following arguments are required: NODE"),
    ],
)
def test_what_does_not_work_is_one_sentence(private_folders, arguments, text, capsys):
    try:
        result = main(["nmt", *arguments])
    except SystemExit as stop:  # argparse
        result = stop.code
    error = capsys.readouterr().err
    assert (result, text in error) == (2, True), error


def test_a_robot_without_nodes_is_not_silently_obeyed(private_folders, capsys):
    with running("no-bus"):
        assert main(["nmt", "stop", "all", "--name", "no-bus"]) == 2
    assert "robot no-bus has no nodes: it runs on mock hardware or in a simulation" in capsys.readouterr().err
