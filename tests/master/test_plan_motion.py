"""Writes of a plan for cyclic motion: interpolation time period, feed-forward and offsets."""

import re
import shutil

import pytest
from support.simulated import setup_of

from canopen_control.data_files import data_path
from canopen_control.master.config import inspect_bus
from canopen_control.simulation.robot_under_test import RobotUnderTest

ASKED = """    - {index: 0x60C2, sub_index: 1, value: 20}       # interpolation period: the SYNC period ...
    - {index: 0x60C2, sub_index: 2, value: -3}       # ... in 10^-3 s
"""


def read_of_plan_interpolation(folder, period, asked):
    """Return what the plan of arm6's first drive writes to 0x60C2 as (value, exponent), and the warnings."""
    target = folder / "arm6"
    shutil.copytree(data_path("config", "arm6"), target)
    path = target / "bus.yml"
    text = path.read_text()
    assert ASKED in text
    path.write_text(text.replace(ASKED, asked).replace("sync_period: 20000", f"sync_period: {period}"))
    config, problems = inspect_bus(path)
    assert not problems.errors, problems.errors
    writes = [write for write in config.plans["joint_1_drive"].writes if write.index == 0x60C2]
    values = tuple(int.from_bytes(write.data, "little", signed=write.subindex == 2) for write in writes)
    return values, [str(warning) for warning in problems.warnings if "60C2" in str(warning)]


def read_dcf(tmp_path, period):
    """Return the plan of a drive whose DCF has a value for 0x60C2:01, and the warnings about it."""
    eds = data_path("eds", "generic_cia402.eds").read_text()
    dcf = re.sub(r"(?m)^(\[60C2sub1\](?:\n[^\[\n]+)*)", rf"\1\nParameterValue={period}", eds)
    (tmp_path / "drive.dcf").write_text(dcf)
    path = tmp_path / "bus.yml"
    path.write_text(
        "master: {node_id: 1, sync_period: 20000}\nnodes:\n  lift:\n    node_id: 2\n    dcf: drive.dcf\n    sdo:\n"
        "      - {index: 0x6081, sub_index: 0, value: 5}\n"
    )
    config, problems = inspect_bus(path)
    return config.plans["lift"], [str(warning) for warning in problems.warnings if "60C2" in str(warning)]


def test_the_default_0_of_a_saved_dcf_gives_way_to_the_sync_period(tmp_path):
    plan, reported = read_dcf(tmp_path, 0)
    assert reported == []
    writes = [(write.subindex, write.data.hex()) for write in plan.writes if write.index == 0x60C2]
    assert writes == [(1, "00"), (1, "14"), (2, "fd")]


def test_another_time_in_a_dcf_is_reported_at_the_file(tmp_path):
    _, (reported,) = read_dcf(tmp_path, 10)
    assert "bus.yml:5:" in reported
    assert "0x60C2 is 10 * 10^-3 s" in reported


@pytest.mark.parametrize(
    ("period", "written"),
    [
        (20000, (20, -3)),
        (12500, (125, -4)),
        (1000, (1, -3)),
        (500, (5, -4)),
        (250, (25, -5)),
        (8000, (8, -3)),
        (100_000, (100, -3)),
        (1_000_000, (1, 0)),
    ],
)
def test_the_period_is_written_exactly(tmp_path, period, written):
    values, warnings = read_of_plan_interpolation(tmp_path, period, "")
    assert values[0] * 10.0 ** values[1] == pytest.approx(period / 1e6, rel=1e-12)
    if period < 1_000_000:
        assert values == written
    assert warnings == []


def test_a_period_that_the_object_cannot_hold_is_reported_with_what_to_do(tmp_path):
    values, warnings = read_of_plan_interpolation(tmp_path, 3333, "")
    assert values[0] * 10.0 ** values[1] == pytest.approx(0.0033, abs=1e-4)
    (warning,) = warnings
    assert "not 3333 us" in warning
    assert "choose another sync_period" in warning


@pytest.mark.parametrize(("value", "exponent"), [(2, -2), (200, -4), (20, -3)])
def test_the_same_time_in_another_unit_is_not_an_error(tmp_path, value, exponent):
    lines = [f"    - {{index: 0x60C2, sub_index: {sub}, value: {each}}}\n" for sub, each in ((1, value), (2, exponent))]
    requested = "".join(lines)
    values, warnings = read_of_plan_interpolation(tmp_path, 20000, requested)
    assert (values, warnings) == ((value, exponent), [])


@pytest.mark.parametrize(
    "requested",
    [
        "    - {index: 0x60C2, sub_index: 1, value: 50}\n    - {index: 0x60C2, sub_index: 2, value: -3}\n",
        "    - {index: 0x60C2, sub_index: 1, value: 0}\n    - {index: 0x60C2, sub_index: 2, value: -3}\n",
        "    - {index: 0x60C2, sub_index: 1, value: 200}\n",  # in the unit that the EDS has
    ],
)
def test_another_time_than_syncs_is_reported_with_where_it_stands(tmp_path, requested):
    _, warnings = read_of_plan_interpolation(tmp_path, 20000, requested)
    assert len(warnings) == 1
    assert "remove 0x60C2, the boot writes the SYNC period" in warnings[0]
    assert "bus.yml:20:7: defaults.sdo[1]" in warnings[0]


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
    result = {rpdo.number: (rpdo.transmission_type, [mapped.index for mapped in rpdo.objects]) for rpdo in plan.rpdos}
    return result, [str(warning) for warning in problems.warnings]


def test_nothing_is_mapped_unless_it_is_asked_for(tmp_path):
    assert rpdos(tmp_path, "[]") == ({1: (1, [0x6040, 0x6060, 0x607A])}, [])


def test_without_space_next_to_the_target_an_unused_rpdo_is_used_with_its_transmission(tmp_path):
    result, warnings = rpdos(tmp_path, "[velocity, effort]")
    assert result == {1: (1, [0x6040, 0x6060, 0x607A]), 2: (1, [0x60B1, 0x60B2])}
    assert warnings == []


def test_it_follows_the_target_position_if_it_fits(tmp_path):
    result, warnings = rpdos(tmp_path, "[effort]", (MODE, ""))
    assert result == {1: (1, [0x6040, 0x607A, 0x60B2])}
    assert warnings == []


def test_of_two_pdos_with_space_the_one_with_the_target_position_is_used(tmp_path):
    first = "    1: {transmission: 1, mapping: [{index: 0x6040}]}\n"
    second = "    2: {transmission: 1, mapping: [{index: 0x607A}]}\n"
    text = (data_path("config", "arm6") / "bus.yml").read_text()
    begin = text.index("  rpdo:\n")
    old = text[begin : text.index("    3: {enabled: false}\n", begin)]
    result, _ = rpdos(tmp_path, "[velocity]", (old, "  rpdo:\n" + first + second))
    assert result == {1: (1, [0x6040]), 2: (1, [0x607A, 0x60B1])}


def test_what_bus_yml_maps_already_is_not_mapped_again(tmp_path):
    mapped = "    2: {transmission: 1, mapping: [{index: 0x60B1}]}\n"
    result, _ = rpdos(tmp_path, "[velocity]", ("  rpdo:\n", "  rpdo:\n" + mapped), (_DISABLED, ""))
    assert result[2] == (1, [0x60B1])
    assert sum(0x60B1 in indices for _, indices in result.values()) == 1


_DISABLED = """        - {index: 0x607A, sub_index: 0}   # target position
    2: {enabled: false}
"""


@pytest.mark.parametrize("requested", ["[speed]", "velocity", "[velocity, 3]"])
def test_what_cannot_be_fed_forward_is_refused_with_its_place(tmp_path, requested):
    target = tmp_path / "arm6"
    shutil.copytree(data_path("config", "arm6"), target)
    path = target / "bus.yml"
    path.write_text(
        path.read_text().replace("  position_mode: 8 ", f"  feed_forward: {requested}\n  position_mode: 8 ")
    )
    _, problems = inspect_bus(path)
    assert any("feed_forward" in str(error) for error in problems.errors)


def test_missing_space_is_reported(tmp_path):
    full = "".join(
        f"    {number}: {{transmission: 1, mapping: [{{index: 0x60FF}}, {{index: 0x6081}}]}}\n" for number in (2, 3, 4)
    )
    off = "".join(f"    {number}: {{enabled: false}}\n" for number in (2, 3, 4))
    target = "        - {index: 0x607A, sub_index: 0}   # target position\n"
    result, warnings = rpdos(tmp_path, "[velocity]", (target + off, target + full))
    assert all(0x60B1 not in indices for _, indices in result.values())
    assert any("has room for 0x60B1; feed-forward of velocity" in warning for warning in warnings)


@pytest.mark.parametrize(("listed", "written"), [("", 0), ("      - {index: 0x60B1, sub_index: 0, value: 7}\n", 7)])
@pytest.mark.parametrize("key", ["DefaultValue", "ParameterValue"])
def test_an_offset_that_would_move_the_axis_is_written_as_0_unless_sdo_lists_it(tmp_path, key, listed, written):
    eds = data_path("eds", "generic_cia402.eds").read_text()
    eds = re.sub(r"(?m)^(\[60B1\](?:\n[^\[\n]+?)*?)(\nDefaultValue=0)", r"\1", eds)
    (tmp_path / "drive.dcf").write_text(re.sub(r"(?m)^(\[60B1\])", rf"\1\n{key}=500", eds))
    path = tmp_path / "bus.yml"
    path.write_text(
        "master: {node_id: 1, sync_period: 20000}\nnodes:\n  lift:\n    node_id: 2\n    dcf: drive.dcf\n    sdo:\n"
        "      - {index: 0x6081, sub_index: 0, value: 5}\n" + listed
    )
    writes = [write for write in inspect_bus(path)[0].plans["lift"].writes if write.index == 0x60B1]
    assert int.from_bytes(writes[-1].data, "little") == written


def test_an_offset_that_only_the_drive_has_stored_is_cleared_before_an_enable():
    robot = RobotUnderTest(setup_of("robby"))
    robot.start()
    store = robot.drives[2].device.store
    store.set(0x60B1, 0, 500)
    robot.run_for(600_000_000)
    assert store.get(0x60B1, 0) == 0
    robot.close()
