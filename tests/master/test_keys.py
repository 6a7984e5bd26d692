"""The keys of bus.yml: every one of the format is honoured or named, and the units by name are the scales."""

import ast
import functools
import math
from pathlib import Path

import pytest

from canopen_control.master.keys import (
    SCALES,
    UNUSED_MASTER,
    UNUSED_NODE,
    AxisUnitKeys,
    FileOptions,
    MasterConfig,
    NodeConfig,
    PdoConfig,
    SupervisionKeys,
    UnitKeys,
    named_scale,
)
from canopen_control.yamlfile.convert import convert, keys_of
from canopen_control.yamlfile.reader import read

PACKAGE = Path(__file__).parents[2] / "canopen_control"
#: what the generator and the drivers of ros2_canopen read, section by section
PEER = {
    FileOptions: "dcf_path heartbeat_multiplier retry_factor",
    MasterConfig: "node_id baudrate vendor_id product_code revision_number serial_number sync_period sync_window "
    "sync_overflow time_cob_id emcy_inhibit_time heartbeat_multiplier heartbeat_consumer heartbeat_producer "
    "error_behavior nmt_inhibit_time start start_nodes start_all_nodes reset_all_nodes stop_all_nodes boot_time "
    "driver package namespace remappings boot_timeout dcf_path",
    NodeConfig: "dcf dcf_path node_id revision_number serial_number time_cob_id heartbeat_multiplier "
    "heartbeat_consumer heartbeat_producer retry_factor guard_time life_time_factor error_behavior rpdo tpdo boot "
    "mandatory reset_communication software_file software_version configuration_file restore_configuration sdo driver "
    "package namespace remappings polling period sdo_timeout_ms boot_timeout_ms non_transmit_timeout diagnostics "
    "scale_pos_to_dev scale_pos_from_dev scale_vel_to_dev scale_vel_from_dev scale_eff_from_dev offset_pos_to_dev "
    "offset_pos_from_dev switching_state homing_timeout_seconds num_channels channel_names channels position_mode "
    "velocity_mode effort_mode channel enable_lazy_load",
    PdoConfig: "enabled cob_id transmission inhibit_time event_timer event_deadline sync_start mapping",
}


def names(cls):
    return set(keys_of(cls))


@functools.cache
def read_attributes():
    """Every attribute and every string that the package uses, outside the schema itself."""
    result = set()
    for path in PACKAGE.rglob("*.py"):
        if path.name == "keys.py":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute):
                result.add(node.attr)
    return result


UNUSED = {MasterConfig: UNUSED_MASTER, NodeConfig: UNUSED_NODE}


@pytest.mark.parametrize(("cls", "keys"), PEER.items(), ids=lambda each: getattr(each, "__name__", ""))
def test_every_key_that_the_other_stack_reads_is_known(cls, keys):
    assert set(keys.split()) <= names(cls) | set(UNUSED.get(cls, ()))


@pytest.mark.sources
@pytest.mark.parametrize("cls", [FileOptions, MasterConfig, NodeConfig, PdoConfig])
def test_every_key_is_used_or_named_as_unused_and_none_is_both_forgotten(cls):
    unused = UNUSED.get(cls, {})
    # Read through `units_of`, which stands beside the schema, by the kind of a PDO or by the interface of a target.
    beside = {"boot", *SCALES, "position_target", "velocity_target", "effort_target", "scale_eff_from_dev"}
    beside |= {"offset_pos_to_dev", "offset_pos_from_dev", "rpdo", "tpdo"}
    assert names(cls) - read_attributes() - set(unused) - beside == set()
    read = {"driver", "software_file"}  # used by the ROS bridge and the boot
    assert names(cls) & set(unused) <= read


def test_units_by_name_are_the_four_scales():
    units = UnitKeys().with_scale(named_scale(1600, None, mirrored=False))
    assert units.scale_pos_to_dev == units.scale_vel_to_dev == pytest.approx(254.64790894703253)
    assert units.scale_pos_from_dev == units.scale_vel_from_dev == pytest.approx(0.003926990816987242)
    assert named_scale(1600, None, mirrored=True) == -named_scale(1600, None, mirrored=False)
    assert named_scale(1600, 2.5, mirrored=False) == pytest.approx(4000 / (2 * math.pi))
    assert named_scale(1600, [5, 2], mirrored=False) == named_scale(1600, 2.5, mirrored=False)
    with pytest.raises(ValueError, match="motor turns, joint turns"):
        named_scale(1600, [5, 0], mirrored=False)


def test_an_axis_of_several_has_its_own_units_where_it_names_them():
    units = UnitKeys(channels=[AxisUnitKeys(), AxisUnitKeys(scale_pos_to_dev=7.0)])
    assert units.of_axis(0)["pos_to_dev"] == 1000.0
    assert units.of_axis(1)["pos_to_dev"] == 7.0
    assert units.of_axis(1)["pos_from_dev"] == 0.001
    assert units.of_axis(5) == units.of_axis(0)


def test_a_heartbeat_goes_before_guarding_and_guarding_before_the_default_heartbeat():
    assert SupervisionKeys().heartbeat_ms == 100
    guarded = SupervisionKeys(guard_time=50)
    assert (guarded.guarded, guarded.heartbeat_ms, guarded.heartbeat_timeout_ns) == (True, 0, 0)
    both = SupervisionKeys(guard_time=50, heartbeat_producer=20, multiplier=2.0)
    assert (both.guarded, both.heartbeat_timeout_ns) == (False, 40_000_000)


def test_keys_without_effect_are_accepted_whatever_they_hold_and_others_are_not(tmp_path):
    node = read("dcf: x.eds\npolling: [1]\nboot: false\n")
    assert convert(node, NodeConfig, ignored=UNUSED_NODE).boot.enabled is False
    node = read("dcf: x.eds\npoling: true\n")
    assert convert(node, NodeConfig, ignored=UNUSED_NODE).identity.dcf == "x.eds"
    assert "unknown key 'poling'" in node.problems.errors[0].message
