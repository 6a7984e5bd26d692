from __future__ import annotations

from canopen_control.frame import CanFrame
from canopen_control.virtual.node_pdos import RpdoInput

FRAMES = [CanFrame(0x203, bytes((n,))) for n in range(10)]


def heard(input_, times=(), ticks=()):
    seen = []
    take = input_.receiver(lambda frame, now: seen.append((frame.data[0], now)))
    for frame, now in zip(FRAMES, times or range(10), strict=True):
        take(frame, now)
    for now in ticks:
        input_.tick(now)
    return seen


def test_healthy_it_hands_all_on_at_once():
    assert heard(RpdoInput()) == [(n, n) for n in range(10)]
    assert RpdoInput().next_deadline() is None


def test_late_ones_come_in_their_order_when_they_are_due():
    late = RpdoInput()
    late.delay_ns.break_with(100)
    seen = heard(late, ticks=(99, 104, 300))
    assert seen == [(n, 104 if n < 5 else 300) for n in range(10)]
    assert late.next_deadline() is None


def test_what_is_on_its_way_when_the_fault_ends_still_comes():
    late = RpdoInput()
    late.delay_ns.break_with(100)
    heard(late)
    late.delay_ns.heal()
    assert late.next_deadline() == 100
    assert [n for n, _ in heard(late)] == list(range(10))


def test_one_of_so_many_is_lost():
    lossy = RpdoInput()
    lossy.lost.break_with(5)
    assert [n for n, _ in heard(lossy)] == [0, 1, 2, 3, 5, 6, 7, 8]
