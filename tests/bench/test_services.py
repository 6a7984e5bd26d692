"""The services bench: what is moved is compared; rounds are paired, ours first."""

import itertools
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import pytest
from canopen_control_bench import services
from canopen_control_bench.eds_files import SHAPES
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


def test_large_files_are_read_by_both_and_the_least_good_is_named(monkeypatch):
    small = [replace(shape, entries=60, pdos=1) for shape in SHAPES[:2]]
    monkeypatch.setattr(services, "SHAPES", small)
    for quick, limit in ((False, services.LARGE_EDS_LIMIT), (True, None)):
        median, least = services._large_eds(quick=quick)
        assert (median.limit, least.limit) == (limit, 1.0)
        assert set(median.absolutes) == {shape.name for shape in small}
        assert least.judged == max(median.absolutes.values())


def test_a_reader_that_misses_an_object_is_seen(monkeypatch, tmp_path):
    monkeypatch.setattr(services, "DUMMIES", services.DUMMIES + 1)
    with pytest.raises(CanopenError, match="find"):
        services._shape(replace(SHAPES[0], entries=60, pdos=1), tmp_path / "large.eds")
