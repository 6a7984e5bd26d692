from __future__ import annotations

import pytest
from support.virtualbench import Bench, servo

from canopen_control.virtual.fault_table import FAULTS
from canopen_control.virtual.injection_point import InjectionPoint


def test_a_seam_is_healthy_until_a_fault_acts_and_again_after_it():
    seam = InjectionPoint(5)
    assert seam.value == 5
    seam.inject(7)
    assert (seam.value, seam.healthy) == (7, 5)
    seam.clear()
    assert seam.value == 5


def seams(part, seen=None):
    """Yield every seam of an object and of the parts that it is made of."""
    seen = set() if seen is None else seen
    if id(part) in seen or not type(part).__module__.startswith("canopen_control.virtual"):
        return
    seen.add(id(part))
    names = [*getattr(part, "__dict__", ()), *getattr(type(part), "__slots__", ())]
    for value in (getattr(part, name) for name in names):
        if isinstance(value, InjectionPoint):
            yield value
        for item in value.values() if isinstance(value, dict) else (value,):
            yield from seams(item, seen)


@pytest.mark.sources
def test_what_a_fault_does_at_a_seam_ends_with_it():
    bench = Bench(servo())
    all_seams = list(seams(bench.node))
    assert len(all_seams) > 15
    used, first = set(), {id(seam): seam.value for seam in all_seams}  # a quirk changes what is healthy too
    for name in (name for name, each in FAULTS.items() if each.acts not in ("input", "output", "program")):
        bench.node.fault_switches.set(name, True, bench.now)
        used |= {id(seam) for seam in all_seams if seam.value != first[id(seam)]}
        if name in bench.node.fault_switches.active:
            bench.node.fault_switches.set(name, False, bench.now)
        assert all(seam.value == seam.healthy == first[id(seam)] for seam in all_seams), name
    assert used == {id(seam) for seam in all_seams}, "a seam that no fault uses"
