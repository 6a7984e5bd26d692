import pytest

from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.od.address import find_object, parts_of
from canopen_control.od.eds import read_eds

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 3).od


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("0x6041", (0x6041, 0)),
        ("6041", (0x6041, 0)),
        ("1018:2", (0x1018, 2)),
        ("0x1018:0x02", (0x1018, 2)),
        ("1A00:0a", (0x1A00, 10)),
        ("Statusword", (0x6041, 0)),
        ("statusword", (0x6041, 0)),
        ("Product code", (0x1018, 2)),
        ("Identity object.Product code", (0x1018, 2)),
        ("Identity object:2", (0x1018, 2)),
        ("Identity object", (0x1018, 0)),
    ],
)
def test_an_object_is_found_by_number_or_name(text, address):
    result = find_object(text, OD)
    assert (result.index, result.subindex) == address


def test_numbers_need_no_eds_and_names_do():
    assert find_object("0x6041:01", None).label == "0x6041:01"
    with pytest.raises(ConfigError, match="without an EDS write INDEX"):
        find_object("Statusword", None)


def test_labels_name_object_and_entry():
    assert find_object("6041", OD).label == "0x6041:00 Statusword"
    assert find_object("1018:1", OD).label == "0x1018:01 Identity object.Vendor-ID"
    assert find_object("1018:9", OD).label == "0x1018:09 Identity object"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Vendor", "did you mean 0x1018:01 Vendor-ID?"),
        ("nonsense", "no object 'nonsense' in the EDS; numbers are hexadecimal"),
        ("statusvord", "no object 'statusvord' in the EDS; did you mean 0x6041:00 Statusword?"),
        ("1234567", "numbers are hexadecimal"),
        ("0x1018:100", "numbers are hexadecimal"),
        ("", "did you mean"),
    ],
)
def test_a_name_that_is_none_is_answered_with_what_may_be_meant(text, message):
    with pytest.raises(ConfigError) as caught:
        find_object(text, OD)
    assert message in str(caught.value)


def test_a_name_that_fits_several_objects_is_refused_with_them():
    with pytest.raises(ConfigError, match=r"8 entries have that name: 0x1600:01 .*use the index instead") as caught:
        find_object("Mapped object 1", OD)
    assert "0x1601:01" in str(caught.value)


def test_an_object_named_without_a_subindex_has_all_its_parts():
    assert [part.subindex for part in parts_of(find_object("1018", OD), OD)] == [0, 1, 2, 3, 4]
    assert [part.subindex for part in parts_of(find_object("1018:2", OD), OD)] == [2]
    assert [part.subindex for part in parts_of(find_object("6041", OD), OD)] == [0]
    assert [part.subindex for part in parts_of(find_object("1018", None), None)] == [0]
    assert [part.subindex for part in parts_of(find_object("5FFF", OD), OD)] == [0]
