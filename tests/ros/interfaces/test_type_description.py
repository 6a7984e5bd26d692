from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from canopen_control.ros.interfaces.type_description import Registry, hash_of, hash_text

GOLDEN = json.loads((Path(__file__).parents[2] / "data/ros_interfaces.json").read_text())
SHARE = Path(sys.prefix, "share")


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
