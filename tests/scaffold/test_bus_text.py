"""The bus.yml of a new robot: every key with a comment, and the resulting plan."""

import dataclasses
import math
from pathlib import Path

import pytest
import yaml
from support.drive_shapes import FOUR_PAIRS, TWO_PAIRS, guarded, shape

from canopen_control.od.model import DataType, Entry
from canopen_control.personality import read_personality
from canopen_control.scaffold.bus_text import bus_text, remark
from canopen_control.scaffold.new_robot import Device, plan_robot

RPM = Entry(0x60A9, 0, "Unit", DataType.UNSIGNED32, "ro", default=0x00B44700)


def text_of(*ods, **how):
    devices = [Device(number, Path(f"d{id(od)}.eds"), od) for number, od in enumerate(ods, 2)]
    return bus_text(plan_robot("r", devices, **how))


def keys_of(*ods, **how):
    return yaml.safe_load(text_of(*ods, **how))


def test_every_key_has_a_word_next_to_it():
    for line in text_of(shape()).splitlines():
        key = line.split("#")[0].rstrip()
        if key and not key.endswith((":", "enabled: true")):
            assert "#" in line, line


def test_drives_of_one_file_share_their_keys_and_those_of_two_do_not():
    od = shape()
    path = Path("a.eds")
    both = bus_text(plan_robot("r", [Device(2, path, od), Device(3, path, od)]))
    assert set(yaml.safe_load(both)["nodes"]["joint_1_drive"]) == {"node_id", "reversed"}
    assert "defaults" not in keys_of(shape(), shape())


def test_pdos_are_listed_as_chosen():
    node = keys_of(shape())["defaults"]
    assert node["rpdo"] == {
        1: {
            "enabled": True,
            "cob_id": "auto",
            "transmission": 255,
            "mapping": [{"index": index, "sub_index": 0} for index in (0x6040, 0x60FF, 0x6060)],
        }
    }


def test_a_fixed_mapping_is_reported_and_not_written():
    text = text_of(shape(pdos=FOUR_PAIRS, access="const"))
    assert "mapping" not in yaml.safe_load(text)["defaults"]["rpdo"][4]
    assert "#   {index: 0x60FF, sub_index: 0}" in text


def test_pdos_of_which_nothing_can_be_changed_are_not_listed():
    text = text_of(shape(pdos=TWO_PAIRS, access="const", cob_access="const"))
    assert not {"rpdo", "tpdo"} & yaml.safe_load(text)["defaults"].keys()
    assert "# rpdo 1, 2, to the drive: they cannot be changed" in text


def test_supervision_is_heartbeats_or_guarding_or_a_word_that_there_is_none():
    watched = keys_of(shape())["defaults"]
    assert (watched["heartbeat_producer"], watched["heartbeat_consumer"]) == (100, True)
    assert keys_of(guarded())["defaults"]["guard_time"] == 100
    blind = keys_of(shape(drop=(0x1016,)))["defaults"]  # its own heartbeat would end the guarding
    assert (blind["guard_time"], blind.get("heartbeat_producer")) == (100, None)
    alone = shape(drop=(0x1016, 0x1017, 0x100C, 0x100D))
    assert keys_of(alone, allow_unsupervised=True)["defaults"]["allow_unsupervised"] is True


def test_rpm_makes_scales_of_their_own_for_each_drive():
    od, path = shape(extra=[RPM]), Path("a.eds")
    keys = yaml.safe_load(bus_text(plan_robot("r", [Device(2, path, od), Device(3, path, od)], base="diff")))
    left, right = keys["nodes"].values()
    assert right["scale_vel_to_dev"] == pytest.approx(60 / math.tau)
    assert right["scale_pos_to_dev"] == pytest.approx(6000 / math.tau)
    assert left["scale_vel_to_dev"] == -right["scale_vel_to_dev"]  # mounted mirrored
    assert "counts_per_revolution" not in keys["defaults"]


def test_ramps_are_written_only_where_the_eds_reports_none():
    plain = {"drop": (0x6007,)}
    assert "sdo" not in keys_of(shape(**plain))["defaults"]
    silent = shape(**plain, s6083_00={"default": None}, s6084_00={"default": 0})
    written = {entry["index"]: entry["value"] for entry in keys_of(silent)["defaults"]["sdo"]}
    assert written == {0x6083: round(20 * 6000 / math.tau), 0x6084: round(20 * 6000 / math.tau)}
    small = shape(**plain, s6083_00={"default": None, "high": 10})
    assert "sdo" not in keys_of(small)["defaults"]


def test_a_lost_master_is_a_quick_stop_where_the_drive_has_an_option_for_it():
    option = Entry(0x6007, 0, "Abort connection", DataType.INTEGER16, "rw", default=0)
    assert keys_of(shape(extra=[option]))["defaults"]["sdo"] == [{"index": 0x6007, "sub_index": 0, "value": 3}]
    ignored = Entry(0x605A, 0, "Quick stop option", DataType.INTEGER16, "rw", default=-1)
    assert "sdo" not in keys_of(shape(extra=[option, ignored]))["defaults"], "0x6007 = 1 of the boot stops it"
    limited = dataclasses.replace(option, low=0, high=2)
    assert "sdo" not in keys_of(shape(extra=[limited]))["defaults"]


def test_a_remark_never_touches_what_it_is_about():
    assert remark("k" * 60, "w").endswith("k # w")
    assert remark("key: 1", "") == "key: 1"


def test_the_keys_of_a_manufacturer_that_is_named_are_in_the_file():
    def keys(name):
        device = Device(2, Path("d.eds"), shape(), like=read_personality(name))
        text = bus_text(plan_robot("r", [device]))
        return text, yaml.safe_load(text)["defaults"]

    text, elmo = keys("elmo")
    assert elmo["enable_settle_ms"] == 600
    assert "# ELMO: set-points count when the brake has lifted (jsd#48):" in text
    assert keys("festo")[1]["transition_timeouts_ms"] == {3: 10000}
    text, delta = keys("delta")
    assert delta["sdo"][0] == {"index": 0x1006, "sub_index": 0, "value": yaml.safe_load(text)["master"]["sync_period"]}
