"""How a try of an SDO request goes on, is made again or ends."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.sdo import MS, NODE

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_exchange import SdoExchange
from canopen_control.cia301.sdo_initiate import BLOCK_ERRORS
from canopen_control.cia301.sdo_request import SdoOptions, SdoRequest
from canopen_control.errors import SdoAbort, SdoTimeout

HALF = 500 * MS


def started(*, retries=1, block=False):
    exchange = SdoExchange(NODE, "", retries, SdoOptions(), 0x603)
    request = SdoRequest(0x2000, 0, None, HALF, block)
    exchange.start(request, 0)
    return exchange, request


def test_a_refused_request_ends_with_the_servers_code():
    exchange, request = started()
    exchange.refused(request, AbortCode.NO_OBJECT, 1)
    assert isinstance(request.error, SdoAbort)
    assert (request.error.code, exchange.active, exchange.retried) == (AbortCode.NO_OBJECT, None, 0)


@pytest.mark.parametrize("code", sorted(BLOCK_ERRORS))
def test_what_blocks_cannot_do_is_done_again_in_segments_and_only_once(code):
    exchange, request = started(block=True)
    exchange.refused(request, code, 1)
    assert (exchange.retried, exchange.phase.block, request.done) == (1, False, False)
    assert (exchange.block_supported is False) is (code == AbortCode.UNKNOWN_COMMAND)
    exchange.refused(request, code, 2)
    assert request.done


def test_a_try_that_timed_out_leaves_an_abort_and_its_object_in_quarantine():
    exchange, request = started(retries=0)
    exchange.out.clear()
    exchange.timed_out(request, HALF)
    assert isinstance(request.error, SdoTimeout)
    assert [str(frame) for frame in exchange.out] == ["603#8000200000000405"]
    assert b"\x00\x20\x00" in exchange.quarantine.owed


@given(st.integers(0, 3), st.booleans(), st.lists(st.sampled_from([0, *AbortCode]), max_size=40))
def test_whatever_goes_wrong_a_request_is_not_tried_for_ever(retries, block, troubles):
    exchange, request = started(retries=retries, block=block)
    for now, code in enumerate(troubles, 1):
        if request.done:
            break
        if code:
            exchange.refused(request, code, now)
        else:
            exchange.timed_out(request, now)
        assert exchange.finished == ([request] if request.done else [])
        assert (exchange.active is None) is request.done
    assert exchange.retried <= retries + 10
