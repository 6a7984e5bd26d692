import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType, Entry
from canopen_control.service.object_rows import has_changed, is_scanned, object_name, select_objects

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od


def addresses(*words):
    return [entry.address for entry in select_objects(OD, words)]


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["0x6081"], [(0x6081, 0)]),
        (["6081", "0x1018:2"], [(0x1018, 2), (0x6081, 0)]),
        (["0x1018:0?"], [(0x1018, sub) for sub in range(5)]),
        (["profile velocity"], [(0x6081, 0)]),
        (["vendor-id"], [(0x1018, 1)]),
        (["identity*revision*"], [(0x1018, 3)]),
    ],
)
def test_objects_are_meant_by_address_pattern_or_name(words, found):
    assert addresses(*words) == found


def test_without_a_word_all_are_meant_by_address():
    assert addresses() == sorted(OD.entries)
    assert set(addresses("0x60*")) == {each for each in OD.entries if each[0] >> 8 == 0x60}


@pytest.mark.parametrize("word", ["0x6FFF", "0x1018:99", "nosuch", "zz*", ""])
def test_a_word_that_means_nothing_is_told_with_what_may_be_written(word):
    with pytest.raises(ConfigError, match=r"no object .* in the EDS; write an address such as 0x6081"):
        addresses("0x6081", word)


@given(st.sampled_from(list(OD)))
def test_every_object_is_found_by_its_own_address_and_name(entry):
    assert addresses(f"0x{entry.index:04X}:{entry.subindex:02X}") == [entry.address]
    assert entry.address in addresses(object_name(OD, entry))


def entry(default=None, access="rw", data_type=DataType.UNSIGNED16, **others):
    return Entry(0x2000, 0, "x", data_type, access, default=default, **others)


@pytest.mark.parametrize(
    ("object_", "value", "changed"),
    [
        (entry(5), 5, False),
        (entry(5), 6, True),
        (entry(None), 6, False),
        (entry(5, "ro"), 6, False),
        (entry(5, data_type=DataType.REAL32), 5.0, False),
        (entry("a", data_type=DataType.VISIBLE_STRING), "b", True),
    ],
)
def test_changed_is_what_can_be_written_and_is_not_the_default(object_, value, changed):
    assert has_changed(object_, value) is changed


@pytest.mark.parametrize(
    ("object_", "scanned"),
    [
        (entry(), True),
        (entry(access="wo"), False),
        (entry(data_type=DataType.DOMAIN), False),
        (entry(obj_flags=2), False),
        (entry(obj_flags=1), True),
    ],
)
def test_a_look_at_everything_leaves_out_what_cannot_or_must_not_be_read(object_, scanned):
    assert is_scanned(object_) is scanned
