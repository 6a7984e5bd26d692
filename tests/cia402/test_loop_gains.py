import dataclasses

import pytest

from canopen_control.cia402.loop_gains import LoopGain, gain_objects, gain_places
from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds

SERVO = read_eds(data_path("eds", "generic_cia402.eds"), 5).od


def test_the_servo_of_this_project_has_all_four():
    assert {gain: (each.index, each.subindex) for gain, each in gain_objects(SERVO).items()} == {
        LoopGain.VELOCITY_P: (0x60F9, 1),
        LoopGain.VELOCITY_I: (0x60F9, 2),
        LoopGain.POSITION_P: (0x60FB, 1),
        LoopGain.VELOCITY_FEED_FORWARD: (0x60FB, 2),
    }


@pytest.mark.parametrize("name", ["TMCM-1270.eds", "generic_cia401.eds"])
def test_a_device_without_loops_has_none(name):
    assert gain_objects(read_eds(data_path("eds", name), 5).od) == {}


def of_maker(name, *addresses):
    """Return a drive of a maker that has these objects too."""
    entry = SERVO[0x60F9, 1]
    more = {address: dataclasses.replace(entry, index=address[0], subindex=address[1]) for address in addresses}
    own = {address: each for address, each in SERVO.entries.items() if address[0] not in (0x60F9, 0x60FB)}
    return dataclasses.replace(SERVO, entries=own | more, device=dataclasses.replace(SERVO.device, vendor_name=name))


@pytest.mark.parametrize(
    ("maker", "objects", "places"),
    [
        ("maxon motor ag", [(0x30A2, 1), (0x30A2, 2), (0x30A1, 1)], [(0x30A2, 1), (0x30A2, 2), (0x30A1, 1)]),
        ("maxon motor ag", [(0x60F9, 1), (0x60F9, 2)], [(0x60F9, 1), (0x60F9, 2)]),
        (
            "Copley Controls",
            [(0x60F9, 1), (0x60F9, 2), (0x60FB, 1), (0x60FB, 2)],
            [(0x60F9, 1), (0x60F9, 2), (0x60FB, 1), (0x60FB, 2)],
        ),
        ("NANOTEC ELECTRONIC", [(0x321B, 1), (0x321B, 2)], [(0x321B, 1), (0x321B, 2)]),
        ("NANOTEC ELECTRONIC", [(0x321B, 1)], []),
        ("Somebody", [(0x60F9, 1), (0x60F9, 2)], []),
    ],
)
def test_manufacturers_hold_gains_in_objects_of_their_own_whose_scale_is_not_known(maker, objects, places):
    od = of_maker(maker, *objects)
    assert [*gain_places(od).values()] == places
