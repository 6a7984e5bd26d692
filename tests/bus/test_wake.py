"""The wake descriptor is a level."""

from __future__ import annotations

import select

from canopen_control.bus.wake import Wake


def readable(wake):
    return bool(select.select([wake], [], [], 0)[0])


def test_it_is_readable_from_set_to_clear():
    wake = Wake()
    assert not readable(wake)
    wake.set()
    wake.set()
    assert readable(wake)
    wake.clear()
    assert not readable(wake)
    wake.close()


def test_many_sets_never_block_and_one_clear_ends_them():
    wake = Wake()
    for _ in range(100_000):
        wake.set()
    wake.clear()
    assert not readable(wake)
    wake.close()


def test_a_closed_one_ignores_everything():
    wake = Wake()
    wake.close()
    wake.set()
    wake.clear()
    wake.close()
    assert wake.fileno() == -1
