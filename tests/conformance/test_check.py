"""Levels, touches and expected answers of a check."""

import pytest

from canopen_control.cia301.abort import AbortCode
from canopen_control.conformance.check import expect_abort, expect_refused, mux
from canopen_control.conformance.checked_node import CheckFailed


def test_an_answer_that_is_not_an_abort_fails_with_what_came_and_was_due(bench):
    with pytest.raises(CheckFailed, match=r"answer 43 00 10 00 .*; expected: abort 0x06020000"):
        expect_abort(bench(), bytes((0x40, *mux(0x1000), 0, 0, 0, 0)), AbortCode.NO_OBJECT)


def test_another_abort_fails_by_its_name(bench):
    with pytest.raises(CheckFailed, match=r"abort 0x06020000 \(object does not exist.*expected: abort 0x06010002"):
        expect_abort(bench(), bytes((0x40, *mux(0x1004), 0, 0, 0, 0)), AbortCode.READ_ONLY)


def test_a_value_that_is_taken_instead_of_refused_fails(bench):
    with pytest.raises(CheckFailed, match="64 00 was accepted by 0x1017:00"):
        expect_refused(bench(), 0x1017, 0, b"\x64\x00", AbortCode.INVALID_VALUE)
