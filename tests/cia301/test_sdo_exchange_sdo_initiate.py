from __future__ import annotations

import pytest

from canopen_control.cia301.sdo_exchange import SdoOptions, SdoRequest, completed, initiate, initiate_block

OPTIONS = SdoOptions()


def request(length=None):
    return SdoRequest(0x2001, 2, None if length is None else bytes(length), 1)


def begin(request, options, block):
    return initiate_block(request, options) if block else initiate(request, options)


@pytest.mark.parametrize(
    ("length", "block", "first"),
    [
        (None, False, "4001200200000000"),
        (0, False, "2101200200000000"),
        (1, False, "2F01200200000000"),
        (4, False, "2301200200000000"),
        (5, False, "2101200205000000"),
        (None, True, "A40120027F000000"),
        (5, True, "C601200205000000"),
    ],
)
def test_the_first_frame(length, block, first):
    assert begin(request(length), OPTIONS, block).hex().upper() == first


@pytest.mark.parametrize(
    ("length", "block", "first"),
    [(1, False, "22"), (5, False, "20"), (5, True, "C0"), (None, True, "A0")],
)
def test_the_first_frame_of_a_client_that_offers_nothing(length, block, first):
    options = SdoOptions(announce_size=False, crc=False)
    data = begin(request(length), options, block)
    assert data[0] == int(first, 16)
    assert data[4:] in (bytes(4), b"\x7f\0\0\0")


@pytest.mark.parametrize(
    ("data", "whole"),
    [
        ("60012000", True),
        ("600120", False),
        ("4F01200005", True),
        ("4F012000", False),
        ("4B0120000506", True),
        ("4B01200005", False),
        ("8001200000000206", True),
        ("80012000000002", False),
        ("41012000090000", False),
        ("A1", False),
        ("", False),
        ("430120000102030405", False),
    ],
)
def test_a_cut_frame_is_whole_if_no_byte_that_counts_is_missing(data, whole):
    filled = completed(bytes.fromhex(data))
    assert filled == (bytes.fromhex(data).ljust(8, b"\0") if whole else b"")
