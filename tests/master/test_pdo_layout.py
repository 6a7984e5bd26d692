import json
import math

import pytest

from canopen_control.data_files import data_path
from canopen_control.master.config import read_bus
from canopen_control.master.pdo_layout import layout_of
from canopen_control.rpc.wire import plain

ROBBY = data_path("config", "robby") / "bus.yml"


def test_the_layout_is_what_a_boot_makes_of_the_bus():
    layout = plain(layout_of(read_bus(ROBBY), "local:robby"))
    assert json.loads(json.dumps(layout)) == layout
    assert (layout["channel"], layout["bitrate"], layout["sync_period_us"]) == ("local:robby", 1_000_000, 20_000)
    left = next(node for node in layout["nodes"] if node["name"] == "left_drive")
    assert left["eds"].endswith("TMCM-1270.eds")
    assert [(pdo["direction"], pdo["number"], pdo["cob_id"]) for pdo in left["pdos"]] == [
        ("rpdo", 1, 0x203),
        ("rpdo", 2, 0x303),
        ("tpdo", 1, 0x183),
        ("tpdo", 2, 0x283),
    ]
    assert left["pdos"][2]["objects"][0] == {
        "index": 0x6041,
        "subindex": 0,
        "bits": 16,
        "data_type": "UNSIGNED16",
        "name": "Statusword",
        "factor": 1.0,
        "offset": 0.0,
        "unit": "",
    }


def test_without_a_channel_it_is_that_of_the_bus_yml():
    assert layout_of(read_bus(ROBBY)).channel == ""


def meanings(layout, node):
    """Return (factor, offset, unit) of the objects of a node that have a unit."""
    [result] = [item for item in layout.nodes if item.name == node]
    objects = [item for pdo in result.pdos for item in pdo.objects if item.unit]
    return {item.index: (pytest.approx(item.factor), pytest.approx(item.offset), item.unit) for item in objects}


def robby_with(tmp_path, *lines, without=("counts_per_revolution", "gear_ratio", "reversed", "scale_")):
    """Return robby's bus with these lines at its left drive, and no other word on units."""
    kept = [line for line in ROBBY.read_text().splitlines() if not line.strip().startswith(without)]
    at = next(number for number, line in enumerate(kept) if line == "  left_drive:") + 1
    path = tmp_path / "bus.yml"
    path.write_text("\n".join([*kept[:at], *(f"    {line}" for line in lines), *kept[at:]]) + "\n")
    return read_bus(path)


def test_numbers_have_the_factor_and_unit_of_bus_yml():
    turn = math.tau / 1600
    assert meanings(layout_of(read_bus(ROBBY), linear=()), "right_drive") == {
        0x607A: (turn, 0, "rad"),
        0x60FF: (turn, 0, "rad/s"),
        0x6064: (turn, 0, "rad"),
        0x606C: (turn, 0, "rad/s"),
    }
    assert meanings(layout_of(read_bus(ROBBY), linear=()), "left_drive")[0x6064] == (-turn, 0, "rad")


def test_a_prismatic_joint_has_metres_and_offsets_belong_to_positions(tmp_path):
    inputs = (
        "scale_pos_to_dev: 4000",
        "scale_pos_from_dev: 0.00025",
        "offset_pos_to_dev: 100",
        "offset_pos_from_dev: -0.025",
    )
    config = robby_with(tmp_path, *inputs, "scale_vel_to_dev: 2000", "scale_vel_from_dev: 0.0005")
    assert meanings(layout_of(config, linear={("left_drive", 0)}), "left_drive") == {
        0x607A: (0.00025, -0.025, "m"),
        0x60FF: (0.0005, 0, "m/s"),
        0x6064: (0.00025, -0.025, "m"),
        0x606C: (0.0005, 0, "m/s"),
    }


def test_what_bus_yml_does_not_report_has_no_unit(tmp_path):
    assert meanings(layout_of(robby_with(tmp_path), linear=()), "left_drive") == {}
    inputs = robby_with(tmp_path, "scale_pos_to_dev: 1000.0", "scale_pos_from_dev: 0.001")
    assert set(meanings(layout_of(inputs, linear=()), "left_drive")) == {0x607A, 0x6064}, (
        "as upstream's default, but said"
    )


def test_without_known_joints_no_unit_is_named():
    assert meanings(layout_of(read_bus(ROBBY)), "left_drive") == {}
