"""The services bench: what is moved is compared; rounds are paired, ours first."""

import itertools
from contextlib import contextmanager

import pytest
from canopen_control_bench import services
from canopen_control_bench.sdo_client import Client

from canopen_control.errors import CanopenError


def keeping(change=lambda data: data):
    kept = []
    return Client(lambda: 1, lambda block: change(kept[-1]), lambda data, block: kept.append(data))


def test_a_transfer_that_brings_back_what_was_sent_passes():
    services.check(keeping(), b"0123456789")


def test_a_wrong_byte_is_seen():
    with pytest.raises(CanopenError, match="10 bytes were sent"):
        services.check(keeping(lambda data: b"\xff" + data[1:]), b"0123456789")


def test_rounds_are_paired_ours_first():
    ticks = itertools.count()

    @contextmanager
    def opener():
        yield keeping()

    found = services._rounds(lambda client: None, lambda: next(ticks), (opener, opener), 3, lambda seconds: seconds)
    assert found == [(1, 1)] * 3
