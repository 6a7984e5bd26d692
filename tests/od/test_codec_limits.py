"""Which limits of an entry count: those of quantities, and of communication objects those that CiA 301 allows."""

import pytest
from support.eds import DEVICE_TYPE, codes, eds, parse, section

from canopen_control.od.codec import above_limit, below_limit, forbidden_limit, outside_limits
from canopen_control.od.model import DataType, Entry

U32 = DataType.UNSIGNED32


def limited(index, subindex=0, data_type=U32, low=None, high=None):
    return Entry(index, subindex, "", data_type, low=low, high=high)


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        (limited(0x1016, 1, high=65535), "bits 16 to 23 are the node id"),
        (limited(0x1016, 2, low=1), "bits 16 to 23"),
        (limited(0x1005, high=0x7F), "predefined"),
        (limited(0x1010, 1, high=1), "signature"),
        (limited(0x1011, 1, high=0xFFFF), "signature"),
        (limited(0x1014, high=0xFF), "bit 31"),
        (limited(0x1400, 1, low=0x181, high=0x5FF), "bit 31"),
        (limited(0x19FF, 1, high=0x7FF), "bit 31"),
    ],
)
def test_a_limit_that_cia_301_forbids_counts_for_nothing(entry, words):
    assert words in forbidden_limit(entry)
    assert not outside_limits(entry, 0x00010000 | 500)


@pytest.mark.parametrize(
    "entry",
    [
        limited(0x1016, 1, low=0, high=0x007F_FFFF),
        limited(0x1016, 1),
        limited(0x1016, 0, DataType.UNSIGNED8, low=1, high=1),
        limited(0x1017, 0, DataType.UNSIGNED16, low=10, high=1000),
        limited(0x1400, 2, DataType.UNSIGNED8, high=240),
        limited(0x1400, 1, low=0, high=0xFFFFFFFF),
        limited(0x1010, 1, low=0, high=0xFFFFFFFF),
        limited(0x6083, 0, high=1000),
    ],
)
def test_other_limits_count(entry):
    assert forbidden_limit(entry) == ""
    if entry.high is not None:
        assert above_limit(entry, entry.high + 1)
        assert not above_limit(entry, entry.high)
    if entry.low is not None:
        assert below_limit(entry, entry.low - 1)
        assert not below_limit(entry, entry.low)


def test_the_check_of_a_file_notes_it():
    consumer = section("1016", ParameterName="Consumer heartbeat time", ObjectType=8, SubNumber=2)
    count = eds("1016sub0", data_type=5, access="ro", DefaultValue=1)
    file = parse(DEVICE_TYPE, consumer, count, eds("1016sub1", HighLimit=65535, DefaultValue="0x10064"))
    assert "limit-forbidden" in codes(file)
    assert "value-limit" not in codes(file)
    (issue,) = [issue for issue in file.issues if issue.code == "limit-forbidden"]
    assert "HighLimit 65535" in issue.text
