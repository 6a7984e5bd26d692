"""The services bench: what is moved is compared; rounds are paired, ours first."""

import itertools
from contextlib import contextmanager
from types import SimpleNamespace

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


def test_rounds_are_paired_ours_first(monkeypatch):
    readings = itertools.accumulate(itertools.cycle((0.5, 1.0, 0.5, 2.0)))  # a pause, ours, a pause, the peer's
    clock = itertools.chain.from_iterable((each, 10 * each) for each in readings)
    both = SimpleNamespace(process_time=lambda: next(clock), perf_counter=lambda: next(clock))
    monkeypatch.setattr(services, "time", both)

    @contextmanager
    def opener():
        yield keeping()

    rounds = services._rounds(lambda client: None, (opener, opener), 3)
    assert services._each(rounds, lambda spent: spent.cpu_s) == [(1.0, 2.0)] * 3
    assert services._each(rounds, lambda spent: spent.wall_s) == [(10.0, 20.0)] * 3
