from __future__ import annotations

from canopen_control.virtual.plant import IdealPlant
from canopen_control.virtual.world import PlainWorld


def test_a_plain_world_gives_every_axis_a_plant_of_its_own():
    world = PlainWorld()
    first, second = world.plant(3, 0), world.plant(3, 1)
    assert isinstance(first, IdealPlant)
    assert first is not second
    assert (world.describe(), world.period_ns) == ({}, None)
    world.close()
