"""PDO records that are read-only in the EDS: the plan, and the findings of `check`."""

import re

import pytest
from support.makers import folder
from support.makers import robot as make_robot

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.master.config import inspect_bus
from canopen_control.od.model import DataType
from canopen_control.runtime.robot_files import find_robot


def fixed(index, subindex):
    """Return an edit of an EDS that makes a PDO record read-only."""

    def edit(text):
        head = rf"\[{index:X}sub{subindex}\]"
        return re.sub(rf"({head}.*?AccessType=)\w+", r"\1ro", text, count=1, flags=re.DOTALL | re.IGNORECASE)

    return edit


def _inspected(path, edit, change=lambda text: text):
    bus = folder(path, "csv", edit=edit) / "bus.yml"
    bus.write_text(change(bus.read_text()))
    config, problems = inspect_bus(bus)
    return config.plans["pan_drive"], [str(warning) for warning in problems.warnings], config.notes


def test_a_cob_id_that_is_right_and_read_only_is_not_planned_to_be_written(tmp_path):
    plan, warnings, _ = _inspected(tmp_path, fixed(0x1400, 1))
    assert [write.fixed for write in plan.writes if write.address == (0x1400, 1)] == [True]
    assert warnings == []


def test_a_cob_id_that_is_another_one_and_read_only_is_named_with_the_one_to_give(tmp_path):
    def other(text):
        return text.replace("rpdo:\n    1: {enabled: true, cob_id: auto", "rpdo:\n    1: {enabled: true, cob_id: 0x311")

    _, warnings, _ = _inspected(tmp_path, fixed(0x1400, 1), other)
    assert "0x1400:01 is ro in device.eds" in warnings[0]
    assert "set `cob_id: 0x202`" in warnings[0]


def test_a_pdo_that_cannot_be_switched_off_is_noted(tmp_path):
    def off(text):
        return text.replace("  rpdo:\n    1: {enabled: true", "  rpdo:\n    1: {enabled: false")

    _, _, notes = _inspected(tmp_path, fixed(0x1400, 1), off)
    assert any("RPDO 1 may be impossible to make invalid; its mapping is then cleared" in note for note in notes)


@pytest.mark.parametrize(
    ("index", "subindex", "key", "advice"),
    [
        (0x1601, 0, "mapping", "the drive may keep its own mapping (0x6040:00"),
        (0x1601, 1, "mapping", "the drive may keep its own mapping (0x6040:00"),
        (0x1401, 2, "transmission", "the drive may keep type 255; use that type"),
    ],
)
def test_a_record_that_is_read_only_and_another_one_is_named(tmp_path, index, subindex, key, advice):
    _, warnings, _ = _inspected(tmp_path, fixed(index, subindex))
    assert any(f"rpdo.2.{key}: 0x{index:04X}:{subindex:02X} is ro in device.eds" in warning for warning in warnings)
    assert any(advice in warning for warning in warnings)


def test_a_drive_whose_cob_ids_are_read_only_runs(tmp_path):
    def edit(text):
        for index in (*range(0x1400, 0x1404), *range(0x1800, 0x1804)):
            text = fixed(index, 1)(text)
        return text

    robot = make_robot(tmp_path, "csv", edit=edit)
    assert robot.state == "running"
    robot.close()


@pytest.mark.parametrize(("index", "subindex"), [(0x1401, 2), (0x1600, 1)])
def test_a_record_that_is_read_only_and_can_be_used_as_it_is_does_not_keep_the_drive_from_running(
    tmp_path, index, subindex
):
    robot = make_robot(tmp_path, "csv", edit=fixed(index, subindex))
    robot.command("vel", 0.5, 0.0, seconds=0.5)
    robot.run(0.5)
    assert robot.drives[2].moving
    assert robot.state == "running"
    assert robot.breaches == []
    robot.close()


def typed(index, data_type):
    """Return an edit of an EDS that gives an object another type."""
    return lambda text: re.sub(rf"(\[{index:X}\].*?DataType=)\w+", rf"\g<1>{data_type}", text, count=1, flags=re.DOTALL)


@pytest.mark.parametrize("index", [0x60FF, 0x606C, 0x6064])
def test_a_signed_object_that_the_eds_has_as_unsigned_is_signed_on_the_wire(tmp_path, index):
    plan, _, _ = _inspected(tmp_path, typed(index, "0x0007"))
    mapped = [item for layout in (*plan.rpdos, *plan.tpdos) for item in layout.objects if item.index == index]
    assert [item.data_type for item in mapped] == [DataType.INTEGER32]


@pytest.mark.parametrize(("mode", "index"), [("csp", 0x607A), ("csp", 0x6064), ("csv", 0x6041)])
def test_an_object_that_is_too_narrow_is_an_error_of_the_configuration(tmp_path, mode, index):
    path = folder(tmp_path, mode, edit=typed(index, "0x0005"))
    result = [str(finding) for finding in check_robot(find_robot(str(path)), CheckOptions()).findings]
    assert any(
        "error" in item and f"0x{index:04X}:00" in item and "has 8 bits in device.eds" in item for item in result
    )
