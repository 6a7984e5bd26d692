"""Probes that look for a quirk on the wire: functions of a bench that return whether it is there."""

from __future__ import annotations

from support.quirky import Quirky
from support.virtualbench import servo

NO_OBJECT, READ_ONLY, DEVICE_STATE, INVALID = 0x06020000, 0x06010002, 0x08000022, 0x06090030


def refused(index, value, code, sub=0, before=lambda b: None):
    """Look for the abort code of a write."""

    def probe(b):
        before(b)
        return b.abort_of(index, value, sub) == code

    return probe


def absent(index):
    return lambda b: b.code_of(index) == NO_OBJECT


def written(b):
    return b.request(bytes.fromhex("2B17100064000000"))


def invalid(b):
    """Make the first TPDO invalid."""
    b.write(0x1800, b.number(0x1800, 1) | 0x80000000, 1)


def check_from_power_on(quirk, probe, node=servo):
    """Check that a drive has the quirk from its power-on, and not without it."""
    assert not probe(Quirky(node=node()))
    assert probe(Quirky(quirk, node=node()))


def check_switched(quirk, probe, node=servo):
    """Check that the quirk is switched on and off while the drive runs."""
    bench = Quirky(node=node())
    bench.set(quirk)
    assert bench.quirks.active[0].startswith(quirk)
    assert probe(bench)
    other = Quirky(node=node())
    other.set(quirk)
    other.set(quirk, on=False)
    assert other.quirks.active == []
    assert not probe(other)
    assert other.node.filter is None or other.node.fault_switches.active
