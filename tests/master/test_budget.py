"""Load of a bus, compared with figures calculated by hand."""

import pytest

from canopen_control.data_files import data_path
from canopen_control.master.budget import HIGH, bits_of, budget_of
from canopen_control.master.config import read_bus

ROBBY = read_bus(data_path("config", "robby") / "bus.yml")
MS = 1_000_000


def bus(folder, master="node_id: 1, sync_period: 10000", node=""):
    path = folder / "bus.yml"
    path.write_text(f"master: {{{master}}}\nnodes:\n  drive: {{dcf: TMCM-1270.eds, node_id: 3{node}}}\n")
    return read_bus(path)


@pytest.mark.parametrize(("length", "bits"), [(0, (47, 55)), (3, (71, 85)), (8, (111, 135))])
def test_the_bits_of_a_frame(length, bits):
    assert bits_of(length) == bits


def test_robbys_cycle_has_775_to_935_bits_and_takes_a_millisecond_at_most():
    budget = budget_of(ROBBY, 20 * MS)
    assert (budget.bits, budget.worst_bits) == (775, 935)
    assert budget.shortest_period_ns == 935_000
    heartbeats = 3 * 65 * 20 / 100
    assert budget.load == pytest.approx((935 + heartbeats) / 20_000)
    assert budget.fits


def test_a_cycle_that_is_shorter_than_its_frames_does_not_fit():
    assert not budget_of(ROBBY, 900_000).fits
    assert budget_of(ROBBY, 935_000).fits
    assert budget_of(ROBBY, MS).load > HIGH


def test_a_tpdo_of_every_third_sync_loads_a_third_and_counts_whole_in_the_worst_cycle(tmp_path):
    node = ", tpdo: {1: {transmission: 3, mapping: [{index: 0x6064}]}}, rpdo: {1: {enabled: false}}"
    budget = budget_of(bus(tmp_path, node=node), 10 * MS)
    share = next(share for share in budget.shares if share.name == "TPDO 1 of drive")
    assert (share.length, share.per_cycle) == (4, pytest.approx(1 / 3))
    assert budget.worst_bits == 55 + share.worst_bits


def test_an_event_driven_tpdo_is_bounded_by_its_inhibit_time_or_named(tmp_path):
    tpdo = "tpdo: {1: {transmission: 255%s, mapping: [{index: 0x6064}]}}, rpdo: {1: {enabled: false}}"
    loose = budget_of(bus(tmp_path, node=f", {tpdo % ''}"), 10 * MS)
    held = budget_of(bus(tmp_path, node=f", {tpdo % ', inhibit_time: 400'}"), 10 * MS)
    assert loose.unbounded == ("TPDO 1 of drive",)
    assert held.unbounded == ()
    assert next(share for share in held.shares if share.cob_id == 0x183).per_cycle == 0.25


def test_a_sync_counter_is_a_byte_and_no_sync_is_not_a_frame(tmp_path):
    with_counter = budget_of(bus(tmp_path, master="node_id: 1, sync_period: 10000, sync_overflow: 10"), 10 * MS)
    without = budget_of(bus(tmp_path, master="node_id: 1"), 10 * MS)
    assert [share.length for share in with_counter.shares if share.name == "SYNC"] == [1]
    assert not [share for share in without.shares if share.name == "SYNC"]


def test_a_guarded_node_costs_question_and_answer(tmp_path):
    budget = budget_of(bus(tmp_path, node=", guard_time: 100, life_time_factor: 3"), 10 * MS)
    names = [share.name for share in budget.shares if share.cob_id == 0x703]
    assert names == ["guarding request, drive", "guarding answer, drive"]
    assert all(share.per_cycle == 0.1 for share in budget.shares if share.cob_id == 0x703)
