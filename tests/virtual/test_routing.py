from __future__ import annotations

from canopen_control.frame import CanFrame
from canopen_control.virtual.routing import merged


def test_each_identifier_has_its_receiver_and_two_of_one_both_hear_in_order():
    heard = []
    routes = [(1, lambda f, now: heard.append("a")), (2, lambda f, now: heard.append("b"))]
    table = merged([*routes, (1, lambda f, now: heard.append("c"))])
    assert table.keys() == {1, 2}
    table[1](CanFrame(1, b""), 0)
    assert heard == ["a", "c"]
    table[2](CanFrame(2, b""), 0)
    assert heard == ["a", "c", "b"]
