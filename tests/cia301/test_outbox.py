from __future__ import annotations

from canopen_control.cia301.outbox import Outbox


def test_items_come_out_in_order_and_once():
    box: Outbox[int] = Outbox()
    box.put(1)
    box.put(2)
    assert (box.drain(), box.drain(), box.lost) == ([1, 2], [], 0)


def test_a_full_box_loses_the_oldest_and_counts_it():
    box: Outbox[int] = Outbox(2)
    for number in range(5):
        box.put(number)
    assert (len(box), box.lost, box.drain()) == (2, 3, [3, 4])


def test_clearing_counts_nothing():
    box: Outbox[int] = Outbox()
    box.put(1)
    box.clear()
    assert (box.drain(), box.lost) == ([], 0)
