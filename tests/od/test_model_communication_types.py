"""Data types that CiA 301 specifies for the objects of the communication area."""

import pytest
from support.eds import parse, section

from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType, communication_type


@pytest.mark.parametrize("file", ["TMCM-1270.eds", "generic_cia402.eds", "generic_cia401.eds"])
def test_the_bundled_files_have_the_types_of_the_table(file):
    result = [
        (entry.data_type, communication_type(*entry.address))
        for entry in read_eds(data_path("eds", file), 5).od
        if entry.index < 0x1C00 and communication_type(*entry.address) is not None
    ]
    assert len(result) > 40
    assert all(own is standard for own, standard in result)


@pytest.mark.parametrize("address", [(0x1008, 0), (0x1000, 1), (0x1F80, 0), (0x2000, 0), (0x6040, 0)])
def test_other_objects_have_no_type_there(address):
    assert communication_type(*address) is None


def test_a_record_has_the_number_of_its_entries_in_subindex_0():
    assert communication_type(0x1A00, 0) is DataType.UNSIGNED8
    assert communication_type(0x1A00, 8) is DataType.UNSIGNED32
    assert [communication_type(0x1800, sub) for sub in (1, 2, 3, 5)] == [
        DataType.UNSIGNED32,
        DataType.UNSIGNED8,
        DataType.UNSIGNED16,
        DataType.UNSIGNED16,
    ]


@pytest.mark.parametrize("keys", [{}, {"DataType": "0x0021"}])
def test_a_mapping_record_without_the_type_of_its_entries_is_read(keys):
    """A record with CompactSubObj names the record's type, or none."""
    parsed = parse(
        section("1600", ParameterName="RPDO mapping", ObjectType="0x9", CompactSubObj=2, AccessType="rw", **keys),
        section("1600Value", NrOfEntries=1, **{"1": "0x62000108"}),
    )
    assert [entry.data_type for entry in parsed.od] == [DataType.UNSIGNED8, DataType.UNSIGNED32, DataType.UNSIGNED32]
    assert parsed.od[0x1600, 1].default == 0x62000108
    texts = [issue.text for issue in parsed.issues if issue.code == "data-type"]
    assert len(texts) == 1
    assert texts[0].endswith("; treated as UNSIGNED32, the type in CiA 301 of 0x1600:01")


@pytest.mark.parametrize(("device_type", "typed"), [("0x00020192", True), ("0x00020191", False)])
def test_an_object_of_a_drive_without_a_type_has_that_of_its_profile(device_type, typed):
    """Kinco's FD124S leaves DataType out (ros2_canopen, issue 202); other profiles use the index for something else."""
    parsed = parse(
        section("1000", ParameterName="Device type", DataType="0x0007", AccessType="ro", DefaultValue=device_type),
        section("6883", ParameterName="Profile acceleration", ObjectType="0x7", AccessType="rw", DefaultValue=9000),
    )
    assert parsed.od[0x6883, 0].data_type is (DataType.UNSIGNED32 if typed else DataType.DOMAIN)
    (issue,) = [issue.text for issue in parsed.issues if issue.code == "data-type"]
    assert issue.endswith("; treated as UNSIGNED32, the type in CiA 402 of 0x6883:00") is typed
