from __future__ import annotations

import json
from pathlib import Path

import pytest

from canopen_control.cia301.sdo_codec import EXPEDITED_CODES, EXPEDITED_LENGTHS, UPLOAD, crc16

CRC = json.loads((Path(__file__).parents[1] / "data" / "sdo.json").read_text())["crc16"]
RULES = {
    "bytes 0..255": bytes(range(256)),
    "byte k = (7k+1) mod 256, k=0..888": bytes((7 * k + 1) % 256 for k in range(889)),
    "byte k = (7k+1) mod 256, k=0..1999": bytes((7 * k + 1) % 256 for k in range(2000)),
}


@pytest.mark.parametrize("vector", CRC["vectors"], ids=lambda v: f"{v['len']} bytes {v['crc']}")
def test_the_crc_is_that_of_the_standard(vector):
    data = RULES[vector["rule"]] if vector["rule"] else bytes.fromhex(vector["data"])
    assert len(data) == vector["len"]
    assert crc16(data) == int(vector["crc"], 16)


def test_expedited_lengths_and_codes_are_inverse():
    for length in (1, 2, 3, 4):
        assert EXPEDITED_LENGTHS[UPLOAD | EXPEDITED_CODES[length]] == length
