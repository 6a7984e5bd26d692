"""What a pre-flight looks at, on virtual drives that are as they should be, and on some that are not."""

import dataclasses

import pytest
from support.robots import copy_robby

from canopen_control.bus.can_interfaces import CanInterface
from canopen_control.cli import preflight as steps
from canopen_control.cli.preflight import link_steps, node_steps
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot

CAN0 = CanInterface("can0", "can", is_up=True, state="ERROR-ACTIVE", bitrate=1_000_000)


def results(found):
    return [(step.name, step.passed) for step in found]


@pytest.mark.parametrize(
    ("link", "expected", "words"),
    [
        (CAN0, [("link", True), ("bit rate", True)], "1000000 bit/s, bus.yml says 1000000"),
        (
            dataclasses.replace(CAN0, bitrate=500_000),
            [("link", True), ("bit rate", False)],
            "500000 bit/s, bus.yml says 1000000",
        ),
        (dataclasses.replace(CAN0, state="ERROR-PASSIVE"), [("link", False), ("bit rate", True)], "ERROR-PASSIVE"),
        (
            dataclasses.replace(CAN0, is_up=False),
            [("link", False)],
            "type: canopen-control bus up can0 --bitrate 1000000",
        ),
        (None, [("link", False)], "can0 is not there"),
        (
            CanInterface("can0", "vcan", is_up=True),
            [("link", True), ("bit rate", None)],
            "is a vcan interface and has none",
        ),
    ],
    ids=["good", "other rate", "passive", "down", "missing", "virtual"],
)
def test_the_link_is_held_against_the_bus_file(monkeypatch, link, expected, words):
    monkeypatch.setattr(steps, "find_can_interface", lambda _name: link)
    found = link_steps("can0", 1000)
    assert results(found) == expected
    assert any(words in step.text for step in found)


def test_a_channel_without_an_interface_is_only_told():
    assert results(link_steps("local:anything", 1000)) == [("link", None)]


@pytest.mark.rest
@pytest.mark.process
def test_nodes_are_compared_to_bus_file_and_eds_and_strangers_are_named(stage):
    for node_id in (3, 2, 9):
        stage.drive("looked", node_id)
    setup = read_robot(find_robot("robby"), can=["local:looked"])
    found = list(node_steps(setup.bus, "local:looked"))
    ours = [("node", True), ("EDS", True), ("errors", True), ("limits", None)]
    assert results(found) == [*ours, *ours, ("node", None)]
    assert found[0].text == "node 3 (left_drive): TMCM-1270, serial number 3"
    assert found[-1].text == "node 9 answers and is not in bus.yml"


@pytest.mark.rest
@pytest.mark.process
def test_a_node_that_is_missing_or_another_one_fails(stage, tmp_path):
    stage.drive("wrong", 3)
    config = copy_robby(tmp_path, bus={"revision_number: 0 ": "revision_number: 0x77 "})
    setup = read_robot(find_robot(str(config)), can=["local:wrong"])
    found = list(node_steps(setup.bus, "local:wrong"))
    assert [step.name for step in found if step.passed is False] == ["node", "node"]
    assert "revision 0x00000077 expected" in found[0].text
    assert found[-1].text.startswith("node 2 (right_drive) does not answer; is it powered")
