"""A robot that runs for weeks: its cycles leave nothing behind, neither memory nor work for the garbage collector.

The drives are recordings, so that what is counted is the master's alone: supervision, 402 machines, controllers, bus.
"""

import gc
import sys

import pytest
from canopen_control_bench.recorded import RecordedFleet
from support.observers import Observer

pytestmark = pytest.mark.alone

CYCLES = 30 * 64  # whole rounds of recordings: the bus of the tests keeps the frames of a round


@pytest.fixture
def fleet(tmp_path):
    fleet = RecordedFleet(tmp_path, 3)
    try:
        for _ in range(256):  # whatever is made once is made now
            fleet.cycle()
        gc.collect()
        gc.freeze()
        yield fleet
    finally:
        gc.unfreeze()
        fleet.close()


def _run(fleet, cycles):
    for _ in range(cycles):
        fleet.cycle()
    fleet.check()


def test_cycles_leave_no_object_behind(fleet):
    _run(fleet, CYCLES)  # the interpreter fills its own lists of free objects
    before = sys.getallocatedblocks()
    _run(fleet, CYCLES)
    # a handful, however many cycles there were
    assert sys.getallocatedblocks() - before < CYCLES // 100


def test_a_leak_of_one_object_a_cycle_would_be_seen(fleet):
    kept = []
    fleet.core.observers.append(Observer(after_cycle=lambda now: kept.append(float(now))))
    before = sys.getallocatedblocks()
    _run(fleet, CYCLES)
    assert sys.getallocatedblocks() - before >= CYCLES


def test_cycles_make_no_work_for_the_garbage_collector(fleet):
    """Only objects that stay fill the youngest generation, and so the older ones: no collection ever becomes due."""
    gc.disable()
    try:
        _run(fleet, CYCLES)  # the interpreter fills its own lists of free objects
        waiting = gc.get_count()
        _run(fleet, CYCLES)
        assert gc.get_count()[0] - waiting[0] < 10
        assert gc.get_count()[1:] == waiting[1:]
        assert gc.collect() < 10, "cyclic garbage, which only the collector takes away"
    finally:
        gc.enable()
