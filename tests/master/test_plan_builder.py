"""Writes are encoded, judged and marked in one place."""

import pytest
from support.busfile import with_node

from canopen_control.data_files import data_path
from canopen_control.master.config import inspect_bus
from canopen_control.master.keys import NodeConfig
from canopen_control.master.plan_builder import PlanBuilder
from canopen_control.od.dcf import encode_concise
from canopen_control.od.eds import read_eds
from canopen_control.yamlfile.convert import convert
from canopen_control.yamlfile.reader import read

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 3).od


def builder(**how):
    message = {"complain": [], "warn": [], "note": []}
    plan_builder = PlanBuilder(
        convert(read(f"dcf: TMCM-1270.eds\nnode_id: 3\n{how.pop('keys', '')}"), NodeConfig),
        OD,
        lambda key, text: message["complain"].append((key, text)),
        lambda key, text: message["warn"].append((key, text)),
        lambda key, text: message["note"].append((key, text)),
        iter(()),
        **how,
    )
    return plan_builder, message


def test_a_write_is_encoded_as_the_eds_types_its_object():
    created, _ = builder()
    created.write(0x60C2, 2, -3, "sdo[0]")
    created.write(0x1017, 0, 100, "heartbeat_producer")
    assert [(write.data, write.name) for write in created.writes] == [
        (b"\xfd", "Interpolation time index"),
        (b"\x64\0", "Producer heartbeat time"),
    ]


@pytest.mark.parametrize(
    ("address", "value", "words"),
    [
        ((0x5999, 0), 1, "0x5999:00 is not in TMCM-1270.eds"),
        ((0x6083, 0), 1.5, "expected a whole number"),
        ((0x6083, 0), "fast", "expected a whole number"),
        ((0x1000, 0), 1, "it cannot be written"),
    ],
)
def test_what_does_not_fit_is_complained_of_at_its_key_and_not_planned(address, value, words):
    created, text = builder()
    created.write(*address, value, "sdo[4]")
    assert created.writes == []
    assert text["complain"][0][0] == "sdo[4]"
    assert words in text["complain"][0][1]


def test_a_value_outside_the_limits_of_the_eds_is_planned_and_doubted():
    created, text = builder()
    created.write(0x2000, 0, 200, "sdo[0]")
    entry = OD[0x2000, 0]
    assert (entry.low, entry.high) != (None, None)
    assert len(created.writes) == 1
    assert "outside the limits of the EDS" in text["warn"][0][1]


def test_a_sequence_of_different_values_is_a_procedure_and_the_same_value_twice_is_none():
    created, _ = builder()
    for value in (1, 2):
        created.write(0x6083, 0, value, "sdo")
        created.write(0x6084, 0, 5, "sdo")
    assert [write.compare for write in created.ordered_writes()] == [False, True, False, True]


def test_signatures_and_write_only_objects_are_never_read():
    created, _ = builder()
    created.write(0x1010, 1, 0x65766173, "sdo")
    assert created.writes[0].data == b"save"
    assert not created.writes[0].compare


def test_bytes_of_a_file_are_taken_as_they_are_if_their_length_is_right():
    created, text = builder(keys="configuration_file: left.bin", downloads=((0x6083, 0, b"\x07\0\0\0"),))
    created.write_raw(0x6083, 0, b"\x07\0\0\0", created.download_reason)
    created.write_raw(0x6083, 0, b"\x07\0", created.download_reason)
    created.write_raw(0x5999, 0, b"\x07", created.download_reason)
    assert [(write.index, write.reason) for write in created.writes] == [
        (0x6083, "from left.bin"),
        (0x5999, "from left.bin"),
    ]
    assert "2 bytes, UNSIGNED32 has 4" in text["complain"][0][1]
    assert "is not in TMCM-1270.eds" in text["warn"][0][1]


def test_the_sdo_list_has_the_last_word_over_a_file_and_a_file_over_the_eds():
    downloads = ((0x60C2, 2, b"\xfc"), (0x1017, 0, b"\x0a\0"))
    created, _ = builder(keys="sdo: [{index: 0x1017, value: 7}]", downloads=downloads)
    assert created.requested_value(0x1017) == 7
    assert created.requested_value(0x60C2, 2) == -4
    assert created.requested_value(0x60C2, 1) is None
    assert created.is_requested(0x60C2)
    assert not created.is_requested(0x6083)
    assert created.default(0x1800, 1) == 0x40000183


def bus_with_sdo(folder, value):
    path = folder / "bus.yml"
    path.write_text(
        "master: {node_id: 1}\nnodes:\n  lift:\n    node_id: 2\n    dcf: generic_cia402.eds\n    sdo:\n"
        f"      - {{index: 0x6007, value: {value}}}\n"
    )
    config, problems = inspect_bus(path)
    return [write.data for write in config.plans["lift"].writes if write.index == 0x6007], problems


@pytest.mark.parametrize("value", ["3", "3.0", '"3"', '"03"', "0x3"])
def test_a_whole_number_is_an_integer_in_any_notation(tmp_path, value):
    """dcfgen converts every value by int()."""
    data, problems = bus_with_sdo(tmp_path, value)
    assert (data, problems.errors) == ([b"\x03\0"], [])


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ('"0x3"', "'0x3' is text; remove the quotes"),
        ("0xFFFF", "65535 is more than 32767, the maximum of INTEGER16; write -1 if that is meant"),
        ("0x10000", "65536 is not a valid INTEGER16"),
        ("3.5", "expected a whole number"),
    ],
)
def test_a_number_that_the_object_cannot_hold_has_its_right_notation(tmp_path, value, words):
    (error,) = bus_with_sdo(tmp_path, value)[1].errors
    assert words in error.message


def test_an_object_of_a_concise_dcf_that_the_eds_lacks_is_named_as_an_object(tmp_path):
    """The boot error said "writing not in the EDS 0x6099:09"."""
    (tmp_path / "node.bin").write_bytes(encode_concise(((0x6099, 9, b"\5\0\0\0"), (0x6083, 0, b"\5\0\0\0"))))
    plan = with_node(tmp_path, "configuration_file: node.bin").plans["right_drive"]
    writes = {write.address: write for write in plan.writes}
    assert writes[0x6099, 9].label == "object 0x6099:09 (not in the EDS)"
    assert writes[0x6083, 0].label == "Profile acceleration 0x6083:00"
