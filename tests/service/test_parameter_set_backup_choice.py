from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.cia402.objects import MOTION, axis_index
from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType, Entry, ObjectDictionary
from canopen_control.od.pdos import is_cob_id
from canopen_control.service.parameter_set import (
    follows_node_id,
    parameters_of,
    protection_of,
    without_unused_slots,
)

TMCM = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od
SERVO = read_eds(data_path("eds", "generic_cia402.eds"), 5).od


def chosen(od):
    return {entry.address for entry in parameters_of(od)}


def test_what_can_be_read_and_written_is_a_parameter():
    assert {(0x6081, 0), (0x6060, 0), (0x2003, 0), (0x1017, 0), (0x607D, 1)} <= chosen(TMCM)
    assert not {(0x1000, 0), (0x6041, 0), (0x1018, 4), (0x1F50, 1)} & chosen(TMCM)


@pytest.mark.parametrize("od", [TMCM, SERVO], ids=["TMCM-1270", "servo"])
def test_commands_and_live_values_are_none(od):
    indices = {index for index, _ in chosen(od)}
    assert not indices & ((MOTION - {0x6060}) | {0x1003, 0x1010, 0x1011, 0x60B8})
    assert (0x60FE, 1) not in chosen(od)


def test_the_makers_own_commands_are_none():
    assert not {0x210B, 0x2700, 0x2701} & {index for index, _ in chosen(TMCM)}


def test_outputs_of_a_terminal_are_none():
    od = read_eds(data_path("eds", "generic_cia401.eds"), 5).od
    assert not {0x6200, 0x6300, 0x6411} & {index for index, _ in chosen(od)}
    assert {index for index, _ in chosen(od)} & {0x6206, 0x6207, 0x6443}


def test_targets_of_every_axis_are_none():
    od = ObjectDictionary(node_id=5)
    for axis in range(3):
        od.add(Entry(axis_index(0x60FF, axis), 0, "Target velocity", DataType.INTEGER32))
        od.add(Entry(axis_index(0x6081, axis), 0, "Profile velocity", DataType.UNSIGNED32))
    assert chosen(od) == {(0x6081, 0), (0x6881, 0), (0x7081, 0)}


@pytest.mark.parametrize("flags", [1, 2, 3])
def test_obj_flags_are_obeyed(flags):
    od = replace(SERVO, entries={**SERVO.entries, (0x6081, 0): replace(SERVO[0x6081, 0], obj_flags=flags)})
    assert (0x6081, 0) not in chosen(od)


def test_counts_are_those_of_mappings_alone():
    od = ObjectDictionary(node_id=5)
    for index in (0x1600, 0x1A00, 0x1400, 0x2100):
        od.add(Entry(index, 1, "value", DataType.UNSIGNED32))
        od.add(Entry(index, 0, "count", DataType.UNSIGNED8))
    assert {address for address in chosen(od) if address[1] == 0} == {(0x1600, 0), (0x1A00, 0)}


def test_a_domain_is_no_parameter():
    od = ObjectDictionary(node_id=5)
    od.add(Entry(0x2100, 0, "program", DataType.DOMAIN))
    assert chosen(od) == set()


def test_what_belongs_to_one_device_is_protected_with_a_reason():
    assert "node id or the bit rate" in protection_of(TMCM, Entry(0x2705, 0, "x", DataType.UNSIGNED8))
    assert "encoder of its own drive" in protection_of(SERVO, Entry(0x687C, 0, "Home offset", DataType.INTEGER32))
    assert protection_of(SERVO, Entry(0x2100, 0, "CANopen Baudrate", DataType.UNSIGNED8)) != ""
    assert protection_of(SERVO, Entry(0x2100, 0, "Velocity", DataType.UNSIGNED8)) == ""
    assert protection_of(SERVO, Entry(0x6081, 0, "Node ID", DataType.UNSIGNED8)) == ""  # a name of the profile's range


@pytest.mark.parametrize(
    ("index", "value", "follows"),
    [
        (0x1800, 0x185, True),
        (0x1800, 0xC0000185, True),
        (0x1800, 0x186, False),
        (0x1800, 0x805, False),
        (0x1014, 0x85, True),
        (0x1014, 0x80000086, False),
        (0x6081, 0x185, False),
    ],
)
def test_identifiers_that_end_in_the_node_id_follow_it(index, value, follows):
    entry = Entry(index, 1 if is_cob_id(index, 1) else 0, "x", DataType.UNSIGNED32)
    assert follows_node_id(entry, value, 5) is follows


def test_what_the_file_makes_of_the_node_id_follows_it():
    entry = Entry(0x2100, 0, "x", DataType.UNSIGNED32, default=0x1005, relative=True)
    assert follows_node_id(entry, 0x1005, 5)
    assert follows_node_id(entry, 0x80001005, 5)  # switched off
    assert not follows_node_id(entry, 0x1006, 5)


@given(st.integers(0, 70), st.integers(1, 64))
def test_mapping_entries_above_the_count_are_left_out(count, slots):
    values = {(0x1600, 0): count, **{(0x1600, sub): 7 for sub in range(1, slots + 1)}, (0x2000, 9): 1}
    kept = without_unused_slots(values)
    assert (0x2000, 9) in kept
    assert sum(index == 0x1600 for index, _ in kept) == 1 + (min(count, slots) if count <= 64 else slots)
