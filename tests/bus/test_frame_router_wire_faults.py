"""Table of wire faults."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from canopen_control.bus.frame_router import DropRule, WireFaults
from canopen_control.frame import CanFrame, frames_of, pack_records


def test_a_label_has_its_own_delay_or_that_of_everybody():
    faults = WireFaults()
    faults.delay("", 5)
    faults.delay("a", 9)
    assert [faults.delay_of(label) for label in "ab"] == [9, 5]
    faults.delay("a", 0)
    faults.delay("b", 0)
    assert [faults.delay_of(label) for label in "ab"] == [5, 5]


@given(st.integers(1, 5), st.none() | st.integers(1, 5), st.integers(0, 40))
def test_a_rule_loses_each_nth_frame_up_to_its_count(every, count, sent):
    faults = WireFaults()
    faults.drops.append(DropRule("a", None, every, count))
    kept = list(frames_of(faults.survivors("a", pack_records([CanFrame(n) for n in range(sent)]))))
    expected = sent // every if count is None else min(count, sent // every)
    assert sent - len(kept) == expected
    assert bool(faults.drops) is (count is None or expected < count)


def test_a_rule_spares_other_labels_and_identifiers():
    faults = WireFaults()
    faults.drops.append(DropRule("a", 0x181))
    records = pack_records([CanFrame(0x181), CanFrame(0x182)])
    assert faults.survivors("b", records) == records
    assert faults.survivors("a", records) == pack_records([CanFrame(0x182)])
