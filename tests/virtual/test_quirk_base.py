from __future__ import annotations

import pytest
from support.virtualbench import Aborted, Bench, servo

from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.virtual.quirk_base import QuirkHooks


def test_hooks_are_undone_in_reverse_order():
    bench = Bench(servo())
    hooks, store = QuirkHooks(bench.node), bench.node.store

    def refuse(entry, value, before):
        if value == 5:
            raise SdoServerAbort(0x06090030)
        return before(entry, value)

    hooks.guard([0x6083], refuse)
    hooks.guard([0x6083], lambda entry, value, before: before(entry, value + 1))
    hooks.show(0x6084, 0, lambda shown: shown * 2)
    hooks.preset(0x1017, 0, 100)
    with pytest.raises(Aborted):
        bench.write(0x6083, 4)
    assert (bench.number(0x6084), bench.number(0x1017)) == (10_000, 100)
    hooks.undo()
    bench.write(0x6083, 5)
    assert (bench.number(0x6083), bench.number(0x6084), bench.number(0x1017)) == (5, 5_000, 0)
    assert store.guard_of(0x6083)[0] is None


def test_what_the_dictionary_lacks_is_left_alone():
    bench = Bench(servo())
    hooks = QuirkHooks(bench.node)
    hooks.guard([0x5FFF], lambda _entry, value, _before: value)
    hooks.show(0x5FFF, 0, lambda shown: shown)
    hooks.preset(0x5FFF, 0, 1)
    hooks.undo()
    assert bench.node.store.guard_of(0x5FFF)[0] is None
