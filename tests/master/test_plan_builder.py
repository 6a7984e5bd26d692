"""Writes are encoded, judged and marked in one place."""

import pytest

from canopen_control.data_files import data_path
from canopen_control.master.keys import NodeConfig
from canopen_control.master.plan_builder import PlanBuilder
from canopen_control.od.eds import read_eds
from canopen_control.yamlfile.convert import convert
from canopen_control.yamlfile.reader import read

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 3).od


def builder(**how):
    said = {"complain": [], "warn": [], "note": []}
    made = PlanBuilder(
        convert(read(f"dcf: TMCM-1270.eds\nnode_id: 3\n{how.pop('keys', '')}"), NodeConfig),
        OD,
        lambda key, text: said["complain"].append((key, text)),
        lambda key, text: said["warn"].append((key, text)),
        lambda key, text: said["note"].append((key, text)),
        iter(()),
        **how,
    )
    return made, said


def test_a_write_is_encoded_as_the_eds_types_its_object():
    made, _ = builder()
    made.write(0x60C2, 2, -3, "sdo[0]")
    made.write(0x1017, 0, 100, "heartbeat_producer")
    assert [(write.data, write.name) for write in made.writes] == [
        (b"\xfd", "Interpolation time index"),
        (b"\x64\0", "Producer heartbeat time"),
    ]


@pytest.mark.parametrize(
    ("address", "value", "words"),
    [
        ((0x5999, 0), 1, "0x5999:00 is not in TMCM-1270.eds"),
        ((0x6083, 0), 1.5, "a whole number is wanted"),
        ((0x6083, 0), "fast", "a whole number is wanted"),
        ((0x1000, 0), 1, "it cannot be written"),
    ],
)
def test_what_does_not_fit_is_complained_of_at_its_key_and_not_planned(address, value, words):
    made, said = builder()
    made.write(*address, value, "sdo[4]")
    assert made.writes == []
    assert said["complain"][0][0] == "sdo[4]"
    assert words in said["complain"][0][1]


def test_a_value_outside_the_limits_of_the_eds_is_planned_and_doubted():
    made, said = builder()
    made.write(0x2000, 0, 200, "sdo[0]")
    entry = OD[0x2000, 0]
    assert (entry.low, entry.high) != (None, None)
    assert len(made.writes) == 1
    assert "outside the limits of the EDS" in said["warn"][0][1]


def test_a_sequence_of_different_values_is_a_procedure_and_the_same_value_twice_is_none():
    made, _ = builder()
    for value in (1, 2):
        made.write(0x6083, 0, value, "sdo")
        made.write(0x6084, 0, 5, "sdo")
    assert [write.compare for write in made.ordered_writes()] == [False, True, False, True]


def test_signatures_and_write_only_objects_are_never_read():
    made, _ = builder()
    made.write(0x1010, 1, 0x65766173, "sdo")
    assert made.writes[0].data == b"save"
    assert not made.writes[0].compare


def test_bytes_of_a_file_are_taken_as_they_are_if_their_length_is_right():
    made, said = builder(keys="configuration_file: left.bin", downloads=((0x6083, 0, b"\x07\0\0\0"),))
    made.write_raw(0x6083, 0, b"\x07\0\0\0", made.download_reason)
    made.write_raw(0x6083, 0, b"\x07\0", made.download_reason)
    made.write_raw(0x5999, 0, b"\x07", made.download_reason)
    assert [(write.index, write.reason) for write in made.writes] == [
        (0x6083, "from left.bin"),
        (0x5999, "from left.bin"),
    ]
    assert "2 bytes, UNSIGNED32 has 4" in said["complain"][0][1]
    assert "is not in TMCM-1270.eds" in said["warn"][0][1]


def test_the_sdo_list_has_the_last_word_over_a_file_and_a_file_over_the_eds():
    downloads = ((0x60C2, 2, b"\xfc"), (0x1017, 0, b"\x0a\0"))
    made, _ = builder(keys="sdo: [{index: 0x1017, value: 7}]", downloads=downloads)
    assert made.asked_value(0x1017) == 7
    assert made.asked_value(0x60C2, 2) == -4
    assert made.asked_value(0x60C2, 1) is None
    assert made.asked_for(0x60C2)
    assert not made.asked_for(0x6083)
    assert made.default(0x1800, 1) == 0x40000183
