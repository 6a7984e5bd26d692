from __future__ import annotations

import math

from canopen_control.virtual import trajectory
from canopen_control.virtual.axis_motion import Switches

S = 1_000_000_000


def test_they_show_only_to_homing_unless_they_are_wired():
    switches = Switches()
    assert [switches.inputs(place) for place in (-60_000, 0, 11_000, 60_000)] == [0, 0, 0, 0]
    switches.homing = True
    assert [switches.inputs(place) for place in (-60_000, 0, 11_000, 60_000)] == [1, 0, 4, 2]
    switches.homing, switches.wired = False, True
    assert [switches.inputs(place) for place in (-50_000, 10_000, 12_000, 50_000)] == [1, 4, 4, 2]


def test_a_demand_runs_into_the_wired_one_in_its_way():
    switches = Switches(wired=True, negative=-10.0, positive=10.0)
    assert switches.next_hit(trajectory.cruise(0, 0.0, 10.0), 0) == S
    assert switches.next_hit(trajectory.cruise(0, 0.0, -5.0), 0) == 2 * S
    assert switches.next_hit(trajectory.hold(0, 0.0), 0) is None
    assert switches.next_hit(trajectory.cruise(0, 20.0, 1.0), 0) is None  # beyond it already
    assert Switches(positive=10.0).next_hit(trajectory.cruise(0, 0.0, 10.0), 0) is None


def test_an_active_one_bounds_the_motion_on_its_side():
    switches = Switches(wired=True, negative=-10.0, positive=10.0)
    assert switches.bounds(0.0) == (-math.inf, math.inf)
    assert switches.bounds(10.5) == (-math.inf, 10.5)
    assert switches.bounds(-10.0) == (-10.0, math.inf)
    assert Switches(positive=10.0).bounds(20.0) == (-math.inf, math.inf)
