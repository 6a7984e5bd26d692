"""The keys of bus.yml: every one of the format is honoured or named, and the units by name are the scales."""

import ast
import dataclasses
import math
from pathlib import Path

import pytest

from canopen_control.master.keys import (
    SCALES,
    UNUSED_MASTER,
    UNUSED_NODE,
    MasterConfig,
    NodeConfig,
    NodeKeys,
    Options,
    PdoConfig,
    named_scales,
)

PACKAGE = Path(__file__).parents[2] / "canopen_control"
#: what the generator and the drivers of ros2_canopen read, section by section
PEER = {
    Options: "dcf_path heartbeat_multiplier retry_factor",
    MasterConfig: "node_id baudrate vendor_id product_code revision_number serial_number sync_period sync_window "
    "sync_overflow time_cob_id emcy_inhibit_time heartbeat_multiplier heartbeat_consumer heartbeat_producer "
    "error_behavior nmt_inhibit_time start start_nodes start_all_nodes reset_all_nodes stop_all_nodes boot_time "
    "driver package namespace remappings boot_timeout dcf_path",
    NodeKeys: "dcf dcf_path node_id revision_number serial_number time_cob_id heartbeat_multiplier heartbeat_consumer "
    "heartbeat_producer retry_factor guard_time life_time_factor error_behavior rpdo tpdo boot mandatory "
    "reset_communication software_file software_version configuration_file restore_configuration sdo driver package "
    "namespace remappings polling period sdo_timeout_ms boot_timeout_ms non_transmit_timeout diagnostics "
    "scale_pos_to_dev scale_pos_from_dev scale_vel_to_dev scale_vel_from_dev scale_eff_from_dev offset_pos_to_dev "
    "offset_pos_from_dev switching_state homing_timeout_seconds num_channels channel_names channels position_mode "
    "velocity_mode effort_mode channel enable_lazy_load",
    PdoConfig: "enabled cob_id transmission inhibit_time event_timer event_deadline sync_start mapping",
}


def names(cls):
    return {field.name for field in dataclasses.fields(cls)}


def read_attributes():
    """Every attribute and every string that the package uses, outside the schema itself."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        if path.name == "keys.py":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute):
                found.add(node.attr)
    return found


@pytest.mark.parametrize(("cls", "keys"), PEER.items(), ids=lambda each: getattr(each, "__name__", ""))
def test_every_key_that_the_other_stack_reads_is_known(cls, keys):
    assert set(keys.split()) <= names(cls)


@pytest.mark.parametrize(
    ("cls", "unused"), [(Options, {}), (MasterConfig, UNUSED_MASTER), (NodeKeys, UNUSED_NODE), (PdoConfig, {})]
)
def test_every_key_is_used_or_named_as_unused_and_none_is_both_forgotten(cls, unused):
    # Read through `units_of`, which stands beside the schema, or by the kind of a PDO.
    beside = {*SCALES, "scale_eff_from_dev", "offset_pos_to_dev", "offset_pos_from_dev", "rpdo", "tpdo"}
    assert names(cls) - read_attributes() - set(unused) - beside == set()
    assert set(unused) <= names(cls)


def test_units_by_name_are_the_four_scales():
    scales = named_scales(1600, None, mirrored=False)
    assert scales["scale_pos_to_dev"] == pytest.approx(254.64790894703253)
    assert scales["scale_vel_from_dev"] == pytest.approx(0.003926990816987242)
    assert named_scales(1600, None, mirrored=True)["scale_vel_to_dev"] == -scales["scale_vel_to_dev"]
    assert named_scales(1600, 2.5, mirrored=False)["scale_pos_to_dev"] == pytest.approx(4000 / (2 * math.pi))
    assert named_scales(1600, [5, 2], mirrored=False) == named_scales(1600, 2.5, mirrored=False)
    with pytest.raises(ValueError, match="motor turns, joint turns"):
        named_scales(1600, [5, 0], mirrored=False)


def test_an_axis_of_several_has_its_own_units_where_it_names_them():
    from canopen_control.master.keys import AxisUnits

    node = NodeConfig(dcf="x.eds", node_id=3, channels=[AxisUnits(), AxisUnits(scale_pos_to_dev=7.0)])
    assert node.units_of(0)["pos_to_dev"] == 1000.0
    assert node.units_of(1)["pos_to_dev"] == 7.0
    assert node.units_of(1)["pos_from_dev"] == 0.001
    assert node.units_of(5) == node.units_of(0)


def test_a_heartbeat_goes_before_guarding_and_guarding_before_the_default_heartbeat():
    assert NodeConfig(dcf="x.eds").heartbeat_ms == 100
    guarded = NodeConfig(dcf="x.eds", guard_time=50)
    assert (guarded.guarded, guarded.heartbeat_ms, guarded.heartbeat_timeout_ns) == (True, 0, 0)
    both = NodeConfig(dcf="x.eds", guard_time=50, heartbeat_producer=20, multiplier=2.0)
    assert (both.guarded, both.heartbeat_timeout_ns) == (False, 40_000_000)
