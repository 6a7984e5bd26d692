from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from canopen_control.ros.interfaces.definition import DEFINITIONS, owner_of
from canopen_control.ros.interfaces.support import Registry, hash_of, hash_text

GOLDEN = json.loads((Path(__file__).parents[2] / "data/ros_interfaces.json").read_text())
SHARE = Path(sys.prefix, "share")
#: of all 36 interfaces of control_msgs jazzy, and of the parts of its services and actions, by ROS's own generator
CONTROL_MSGS = json.loads((Path(__file__).parents[2] / "data/control_msgs_hashes.json").read_text())


@pytest.fixture(scope="module")
def registry():
    registry = Registry([SHARE])
    registry.add({name: each["definition"] for name, each in GOLDEN.items()})
    return registry


@pytest.mark.ros
@pytest.mark.parametrize("name", GOLDEN)
def test_the_hash_is_the_published_one(registry, name):
    assert hash_text(registry.describe(name)) == GOLDEN[name]["type_hash"]


@pytest.mark.ros
def test_the_hashes_of_control_msgs_are_those_of_ross_own_generator():
    registry = Registry([SHARE])
    registry.add(DEFINITIONS)
    assert {name: hash_text(registry.describe(name)) for name in CONTROL_MSGS} == CONTROL_MSGS
    assert len(CONTROL_MSGS) == 129
    assert {owner_of(name) for name in CONTROL_MSGS} == {
        name for name in DEFINITIONS if name.startswith("control_msgs/")
    }


@pytest.mark.ros
def test_the_hashes_of_every_installed_message_and_service_are_the_installed_ones():
    registry, checked = Registry([SHARE]), 0
    for path in SHARE.glob("*_msgs/[ms][sr][gv]/*.json"):
        told = json.loads(path.read_text())["type_hashes"][0]
        assert hash_text(registry.describe(told["type_name"])) == told["hash_string"], told["type_name"]
        checked += 1
    assert checked > 100


@pytest.mark.ros
def test_an_installed_message_is_the_same_from_its_text():
    name = "geometry_msgs/msg/TransformStamped"
    registry = Registry([SHARE])
    expected = registry.describe(name)
    registry.add({name: (SHARE / "geometry_msgs/msg/TransformStamped.msg").read_text().splitlines()})
    assert registry.describe(name) == expected


def test_a_structure_that_nobody_has_is_told():
    with pytest.raises(LookupError, match="no description of x/msg/Y; is the package x installed"):
        Registry([]).describe("x/msg/Y")


def test_the_hash_depends_on_every_name():
    registry = Registry()
    registry.add({"p/msg/A": ["uint8 a"], "p/msg/B": ["uint8 b"]})
    one, other = registry.describe("p/msg/A"), registry.describe("p/msg/B")
    assert hash_of(one) != hash_of(other)
    other["type_description"]["type_name"] = "p/msg/A"
    assert hash_of(one) != hash_of(other)


def test_a_definition_is_read_when_it_is_asked_for_and_a_later_one_counts():
    registry = Registry()
    registry.add({"p/msg/A": ["no-field"], "p/srv/S": ["uint8 a", "---"]})
    assert [each.name for each in registry.get("p/srv/S_Request").fields] == ["a"]
    with pytest.raises(ValueError, match="cannot read the line"):
        registry.get("p/msg/A")
    registry.add({"p/srv/S": ["uint8 b", "---"]})
    assert [each.name for each in registry.get("p/srv/S_Request").fields] == ["b"]
