"""How a new robot moves a drive: interface, mode, units and supervision, from the EDS alone."""

import pytest
from support.drive_shapes import SHAPES, UNWATCHED, guarded, modes, record, shape

from canopen_control.errors import RobotConfigError
from canopen_control.od.model import DataType, Entry
from canopen_control.scaffold.drive_choice import (
    GUESSED_COUNTS,
    POSITION,
    VELOCITY,
    choose_drive,
    is_drive,
    supervision_of,
)


def rpm(unit):
    return choose_drive(shape(extra=[Entry(0x60A9, 0, "Unit", DataType.UNSIGNED32, "ro", default=unit)])).rpm


@pytest.mark.parametrize("what", SHAPES)
def test_velocity_goes_before_position_and_what_the_drive_ramps_before_what_it_does_not(what):
    make, interface, mode = SHAPES[what]
    drive = choose_drive(make())
    assert (drive.interface, drive.mode.name) == (interface, mode)


def test_the_first_interface_asked_for_that_the_drive_has_is_taken():
    assert choose_drive(shape(), (POSITION, VELOCITY)).mode.name == "CSP"
    with pytest.raises(RobotConfigError, match=r"its modes are PP, HM, CSP \(0x6502\), and no RPDO .* of velocity"):
        choose_drive(shape(**modes(0xA1)), (VELOCITY,))


def test_a_drive_whose_statusword_cannot_be_sent_is_none_to_run():
    with pytest.raises(RobotConfigError, match="no TPDO can carry its statusword"):
        choose_drive(shape(s6041_00={"pdo_mappable": False}))


def test_feedback_is_what_a_tpdo_can_carry():
    assert choose_drive(shape()).feedback == (POSITION, VELOCITY)
    assert choose_drive(shape(drop=(0x606C,))).feedback == (POSITION,)


def test_counts_are_those_of_the_eds_or_a_guess():
    told = choose_drive(shape(drop=(0x608F,), extra=record(0x608F, "Resolution", 10_000, 4)))
    assert (told.counts, told.told) == (2500, True)
    guess = choose_drive(shape(drop=(0x608F,)))
    assert (guess.counts, guess.told) == (GUESSED_COUNTS, False)
    zero = choose_drive(shape(drop=(0x608F,), extra=record(0x608F, "Resolution", 0, 1)))
    assert not zero.told


def test_a_feed_constant_is_the_users_unit_and_one_to_one_says_nothing():
    assert choose_drive(shape(extra=record(0x6092, "Feed", 360, 1))).counts == 360
    assert choose_drive(shape(extra=record(0x6092, "Feed", 1, 1))).counts == 6000


@pytest.mark.parametrize(("unit", "one"), [(0x00B44700, 1.0), (0xFDB44700, 0.001), (0, 0.0), (0x00410300, 0.0)])
def test_rpm_is_read_with_its_power_of_ten(unit, one):
    assert rpm(unit) == pytest.approx(one)


def test_who_watches_whom():
    assert supervision_of(shape()).stops_alone
    assert supervision_of(shape()).guarding is False  # heartbeats go before it
    assert supervision_of(guarded()).guarding
    assert not supervision_of(next(iter(UNWATCHED.values()))()).stops_alone


def test_a_dictionary_without_a_controlword_is_no_drive():
    assert is_drive(shape())
    assert not is_drive(shape(drop=(0x6040,)))


def test_of_several_axes_the_first_is_used_and_all_are_counted():
    assert choose_drive(shape(axes=2)).axes == 2


@pytest.mark.parametrize(("index", "why"), [(0x6060, "is chosen"), (0x6061, "nothing is enabled without")])
def test_a_drive_without_a_mode_of_operation_is_refused(index, why):
    with pytest.raises(RobotConfigError, match=f"no 0x{index:04X}, by which .*{why}"):
        choose_drive(shape(drop=(index,)))
