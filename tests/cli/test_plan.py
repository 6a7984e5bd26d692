"""The verb plan: the writes of a boot, and differences on a live bus."""

import json
from pathlib import Path

import pytest
from support.onbus import TMCM, OnBus
from support.robots import copy_robby

from canopen_control.cli.main import main

TUTORIAL = Path(__file__).parents[1] / "data" / "robby_tutorial" / "bus.yml"


def plan(capsys, *arguments, code=0):
    assert main(["plan", *map(str, arguments)]) == code
    return capsys.readouterr().out


def test_the_tutorials_file_gives_35_writes_for_a_drive_and_names_the_reason_of_each_addition(capsys):
    sync, *lines = plan(capsys, "--bus", TUTORIAL, "--node", "left_drive").splitlines()
    assert sync.startswith("bus can: SYNC every ")
    assert "after the RPDOs of its cycle (sync_order: last), by the kernel on a SocketCAN interface where" in sync
    assert lines[0] == "node 3 (left_drive, TMCM-1270.eds): 48 writes, 13 of them added"
    assert sum("   + " not in line for line in lines[1:]) == 35
    assert "   + a lost master stops the motor" in next(line for line in lines if "0x1029:01" in line)
    assert next(line for line in lines if "0x60C2:02" in line).endswith("= -3 (0xFD)")
    assert next(line for line in lines if "0x1017:00" in line).split("= ")[1] == "1000 (0x03E8)"


def test_as_json_each_write_has_its_bytes_its_value_and_its_reason(capsys):
    text = json.loads(plan(capsys, "--bus", TUTORIAL, "--json"))
    assert list(text) == ["left_drive", "right_drive"]
    writes = text["left_drive"]["writes"]
    assert [write["index"] for write in writes[-3:]] == [0x1016, 0x1017, 0x1029]
    assert writes[-2] == {
        "index": 0x1017,
        "subindex": 0,
        "name": "Producer heartbeat time",
        "data": "e803",
        "value": "1000 (0x03E8)",
        "reason": None,
    }


def test_a_robot_needs_nothing_but_its_bus_files(tmp_path, capsys):
    (tmp_path / "bus.yml").write_text(TUTORIAL.read_text())
    assert "48 writes" in plan(capsys, tmp_path)
    (tmp_path / "bus_arm.yml").write_text("master: {node_id: 1}\nnodes: {elbow: {dcf: TMCM-1270.eds, node_id: 9}}\n")
    assert "node 9 (elbow, TMCM-1270.eds)" in plan(capsys, tmp_path)


def test_nodes_are_chosen_by_name_or_id_in_one_list(capsys):
    titles = [line for line in plan(capsys, "robby", "--node", "left_drive,2").splitlines() if line.startswith("node ")]
    assert [line.split(",")[0] for line in titles] == ["node 3 (left_drive", "node 2 (right_drive"]
    assert plan(capsys, "robby", "--node", "3") == plan(capsys, "robby", "--node", "left_drive")


def test_an_unknown_node_is_named_with_the_nearest(capsys):
    assert main(["plan", "robby", "--node", "left_drife"]) == 2
    assert "did you mean 'left_drive'?" in capsys.readouterr().err


def test_peer_merge_plans_what_the_other_stack_would_write(tmp_path, capsys):
    changed = {"  left_drive:\n    node_id: 3\n": "  left_drive:\n    node_id: 3\n    heartbeat_producer: 50\n"}
    config = copy_robby(tmp_path, bus=changed)
    assert "0x1017:00 Producer heartbeat time" in plan(capsys, config, "--node", "left_drive")
    ours = json.loads(plan(capsys, config, "--json"))["left_drive"]["writes"]
    theirs = json.loads(plan(capsys, config, "--json", "--peer-merge"))["left_drive"]["writes"]
    data = [[write["data"] for write in item if write["index"] == 0x1017] for item in (ours, theirs)]
    assert data == [["3200"], ["6400"]]


@pytest.fixture
def live(private_folders):
    with OnBus("memory:plan", {2: TMCM, 3: TMCM}) as devices:
        yield devices


def test_against_a_live_bus_only_what_differs_is_shown(live, capsys):
    fresh = plan(capsys, "robby", "--against", "memory:plan", "--node", "left_drive").splitlines()
    assert fresh[0] == "node 3 (left_drive, TMCM-1270.eds): 37 writes, 0 of them added"
    live.call(lambda: live.nodes[3].store.set(0x6083, 0, 16000))
    assert "0x6083:00" not in plan(capsys, "robby", "--against", "memory:plan", "--node", "left_drive")
    assert "0x6083:00" in plan(capsys, "robby", "--against", "can=memory:plan", "--node", "right_drive")


def test_a_node_that_has_everything_needs_nothing(live, tmp_path, capsys):
    (tmp_path / "bus.yml").write_text(
        "master: {node_id: 1}\nnodes:\n  wheel: {dcf: TMCM-1270.eds, node_id: 3, heartbeat_consumer: false,\n"
        "    allow_unsupervised: true, heartbeat_producer: 1000, sdo: [{index: 0x2000, value: 5}]}\n"
    )
    live.call(lambda: (live.nodes[3].store.set(0x2000, 0, 5), live.nodes[3].store.set(0x1017, 0, 1000)))
    assert plan(capsys, tmp_path, "--against", "memory:plan") == "node 3 (wheel, TMCM-1270.eds): no differences\n"


def test_a_node_that_does_not_answer_is_exit_code_1_and_the_others_are_shown(private_folders, capsys):
    with OnBus("memory:half", {2: TMCM}):
        text = plan(capsys, "robby", "--against", "memory:half", code=1)
    assert "node 3 (left_drive, TMCM-1270.eds): 0x1000:00: no answer within" in text
    assert "node 2 (right_drive, TMCM-1270.eds): 37 writes" in text


def test_a_bus_that_the_robot_does_not_have_is_named(capsys):
    assert main(["plan", "robby", "--against", "arm=can0"]) == 2
    assert "the robot has no bus 'arm'; known: can" in capsys.readouterr().err
