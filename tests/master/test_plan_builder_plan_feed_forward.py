"""`feed_forward` of bus.yml: where velocity and torque offset are mapped, and what is said where they cannot be."""

import shutil

import pytest

from canopen_control.data_files import data_path
from canopen_control.master.config import inspect_bus

MODE = "        - {index: 0x6060, sub_index: 0}   # mode of operation\n"


def rpdos(folder, asked, *edits):
    """Return the RPDOs of arm6's first drive as {number: (type, indices)}, and the warnings."""
    target = folder / "arm6"
    shutil.copytree(data_path("config", "arm6"), target)
    path = target / "bus.yml"
    text = path.read_text().replace("  position_mode: 8 ", f"  feed_forward: {asked}\n  position_mode: 8 ")
    for old, new in edits:
        assert old in text, old
        text = text.replace(old, new)
    path.write_text(text)
    config, problems = inspect_bus(path)
    assert not problems.errors, problems.errors
    plan = config.plans["joint_1_drive"]
    found = {each.number: (each.transmission_type, [mapped.index for mapped in each.objects]) for each in plan.rpdos}
    return found, [str(each) for each in problems.warnings]


def test_nothing_is_mapped_unless_it_is_asked_for(tmp_path):
    assert rpdos(tmp_path, "[]") == ({1: (1, [0x6040, 0x6060, 0x607A])}, [])


def test_without_room_beside_the_target_an_rpdo_that_nobody_uses_is_taken_with_its_transmission(tmp_path):
    found, warnings = rpdos(tmp_path, "[velocity, effort]")
    assert found == {1: (1, [0x6040, 0x6060, 0x607A]), 2: (1, [0x60B1, 0x60B2])}
    assert warnings == []


def test_where_there_is_room_it_goes_behind_the_target_position(tmp_path):
    found, warnings = rpdos(tmp_path, "[effort]", (MODE, ""))
    assert found == {1: (1, [0x6040, 0x607A, 0x60B2])}
    assert warnings == []


def test_of_two_with_room_the_one_with_the_target_position_is_taken(tmp_path):
    first = "    1: {transmission: 1, mapping: [{index: 0x6040}]}\n"
    second = "    2: {transmission: 1, mapping: [{index: 0x607A}]}\n"
    text = (data_path("config", "arm6") / "bus.yml").read_text()
    begin = text.index("  rpdo:\n")
    old = text[begin : text.index("    3: {enabled: false}\n", begin)]
    found, _ = rpdos(tmp_path, "[velocity]", (old, "  rpdo:\n" + first + second))
    assert found == {1: (1, [0x6040]), 2: (1, [0x607A, 0x60B1])}


def test_what_bus_yml_maps_already_is_not_mapped_again(tmp_path):
    mapped = "    2: {transmission: 1, mapping: [{index: 0x60B1}]}\n"
    found, _ = rpdos(tmp_path, "[velocity]", ("  rpdo:\n", "  rpdo:\n" + mapped), (_DISABLED, ""))
    assert found[2] == (1, [0x60B1])
    assert sum(0x60B1 in indices for _, indices in found.values()) == 1


_DISABLED = """        - {index: 0x607A, sub_index: 0}   # target position
    2: {enabled: false}
"""


@pytest.mark.parametrize("asked", ["[speed]", "velocity", "[velocity, 3]"])
def test_what_cannot_be_fed_forward_is_refused_with_its_place(tmp_path, asked):
    target = tmp_path / "arm6"
    shutil.copytree(data_path("config", "arm6"), target)
    path = target / "bus.yml"
    path.write_text(path.read_text().replace("  position_mode: 8 ", f"  feed_forward: {asked}\n  position_mode: 8 "))
    _, problems = inspect_bus(path)
    assert any("feed_forward" in str(each) for each in problems.errors)


def test_no_room_anywhere_is_told(tmp_path):
    full = "".join(
        f"    {number}: {{transmission: 1, mapping: [{{index: 0x60FF}}, {{index: 0x6081}}]}}\n" for number in (2, 3, 4)
    )
    off = "".join(f"    {number}: {{enabled: false}}\n" for number in (2, 3, 4))
    target = "        - {index: 0x607A, sub_index: 0}   # target position\n"
    found, warnings = rpdos(tmp_path, "[velocity]", (target + off, target + full))
    assert all(0x60B1 not in indices for _, indices in found.values())
    assert any("has room for 0x60B1; done without feed-forward of velocity" in each for each in warnings)
