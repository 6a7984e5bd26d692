from __future__ import annotations

import json
from pathlib import Path

import pytest

from canopen_control.cia301.abort import AbortCode, abort_text

VECTORS = json.loads((Path(__file__).parents[1] / "data" / "sdo.json").read_text())


def test_the_table_has_exactly_the_codes_of_the_standard():
    assert {int(code) for code in AbortCode} == {int(row["code"], 16) for row in VECTORS["sdo_abort_codes"]}
    assert len(AbortCode) == 33


@pytest.mark.parametrize("code", list(AbortCode))
def test_every_code_has_a_text_of_its_own(code):
    assert len(code.text) > 8
    assert abort_text(int(code)) == code.text
    assert sum(other.text == code.text for other in AbortCode) == 1


def test_a_vendors_code_is_reported_to_be_unknown():
    assert abort_text(0x12345678) == "unknown code"
