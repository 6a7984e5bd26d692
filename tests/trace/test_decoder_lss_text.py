import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.trace.decoder import lss_text


@pytest.mark.parametrize(
    ("data", "from_master", "text"),
    [
        ("0400", True, "all switch to waiting"),
        ("1105", True, "configure node-ID 5"),
        ("11FF", True, "configure no node-ID"),
        ("130002", True, "configure bit rate: 500000 bit/s"),
        ("130009", True, "configure bit rate: automatic"),
        ("130105", True, "configure bit timing 5 of table 1"),
        ("15E803", True, "activate bit rate after 1000 ms"),
        ("17", True, "store"),
        ("4186020000", True, "select product 0x00000286"),
        ("4B01000000", True, "identify highest serial 0x00000001"),
        ("51000000008000", True, "fast scan: any node without a node-ID"),
        ("51860200000400 00", True, "fast scan: vendor 0x00000286, bits 4 to 31"),
        ("5E", True, "inquire node-ID"),
        ("EE", True, "unknown command 0xEE"),
        ("1101", False, "node-ID: refused, out of range"),
        ("1700", False, "store: stored"),
        ("13FF07", False, "bit rate: error 255, detail 7"),
        ("5A86020000", False, "is vendor 0x00000286"),
        ("5E05", False, "node-ID 5"),
        ("44", False, "selected"),
        ("", False, "malformed: no data"),
    ],
)
def test_each_service_has_its_words(data, from_master, text):
    assert lss_text(bytes.fromhex(data), from_master=from_master) == text


@given(st.binary(max_size=8), st.booleans())
def test_no_frame_is_without_words(data, from_master):
    assert lss_text(data, from_master=from_master)
