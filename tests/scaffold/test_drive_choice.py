"""How a new robot moves a drive: interface, mode, units and supervision, from the EDS alone."""

from dataclasses import replace

import pytest
from support.drive_shapes import SHAPES, TWO_PAIRS, UNWATCHED, guarded, modes, record, shape, slots_of

from canopen_control.cia402.modes import OperationMode
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
    return axis(shape(extra=[Entry(0x60A9, 0, "Unit", DataType.UNSIGNED32, "ro", default=unit)])).rpm


def axis(od, *interfaces, number=0):
    """Return how one axis is moved."""
    return choose_drive(od, [interfaces] if interfaces else ()).axes[number]


@pytest.mark.parametrize("what", SHAPES)
def test_velocity_goes_before_position_and_what_the_drive_ramps_before_what_it_does_not(what):
    make, interface, mode = SHAPES[what]
    drive = axis(make())
    assert (drive.interface, drive.mode.name) == (interface, mode)


def test_the_first_interface_asked_for_that_the_drive_has_is_taken():
    assert axis(shape(), POSITION, VELOCITY).mode.name == "CSP"
    with pytest.raises(RobotConfigError, match=r"its modes are PP, HM, CSP \(0x6502\), and no RPDO .* of velocity"):
        axis(shape(**modes(0xA1)), VELOCITY)


def test_a_drive_that_cannot_send_its_statusword_is_refused():
    with pytest.raises(RobotConfigError, match="no TPDO can carry its statusword"):
        choose_drive(shape(s6041_00={"pdo_mappable": False}))


def test_counts_are_those_of_the_eds_or_a_guess():
    reported = axis(shape(drop=(0x608F,), extra=record(0x608F, "Resolution", 10_000, 4)))
    assert (reported.counts, reported.is_known) == (2500, True)
    guess = axis(shape(drop=(0x608F,)))
    assert (guess.counts, guess.is_known) == (GUESSED_COUNTS, False)
    zero = axis(shape(drop=(0x608F,), extra=record(0x608F, "Resolution", 0, 1)))
    assert not zero.is_known


def test_a_feed_constant_is_the_users_unit_and_one_to_one_reports_nothing():
    assert axis(shape(extra=record(0x6092, "Feed", 360, 1))).counts == 360
    assert axis(shape(extra=record(0x6092, "Feed", 1, 1))).counts == 6000


def test_monitored_nodes_of_each_consumer():
    assert supervision_of(shape()).stops_alone
    assert supervision_of(shape()).guarding is False  # heartbeats go before it
    assert supervision_of(guarded()).guarding
    assert not supervision_of(next(iter(UNWATCHED.values()))()).stops_alone


@pytest.mark.parametrize("data_type", [DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.VISIBLE_STRING])
def test_a_consumer_entry_too_small_for_node_id_and_time_monitors_no_node(data_type):
    od = shape()
    for subindex in od.subindices(0x1016)[1:]:
        od.entries[0x1016, subindex] = replace(od[0x1016, subindex], data_type=data_type)
    assert not supervision_of(od).consumer


def test_a_dictionary_without_a_controlword_is_not_a_drive():
    assert is_drive(shape())
    assert not is_drive(shape(drop=(0x6040,)))


def test_of_several_axes_all_are_moved_and_share_the_pdos():
    drive = choose_drive(shape(axes=2))
    assert [(item.number, item.interface, item.mode.name) for item in drive.axes] == [
        (0, "velocity", "PV"),
        (1, "velocity", "PV"),
    ]
    carried = [address for use in drive.rpdos for address in use.objects]
    assert carried == [(0x6040, 0), (0x60FF, 0), (0x6840, 0), (0x68FF, 0), (0x6060, 0), (0x6860, 0)]
    assert all(item.feedback == (POSITION, VELOCITY) for item in drive.axes)


def test_axes_may_have_other_interfaces_and_those_of_one_kind_have_one_mode():
    both = choose_drive(shape(axes=2), [(VELOCITY,), (POSITION,)])
    assert both.modes == {"velocity": OperationMode.PV, "position": OperationMode.CSP}
    one = shape(axes=2, s6502_00={"default": 0x107}, s6D02_00={"default": 0x204})  # PP PV CSV, and PV CST
    assert [item.mode.name for item in choose_drive(one, [(VELOCITY,), (VELOCITY,)]).axes] == ["PV", "PV"]
    other = shape(axes=2, s6502_00={"default": 0x100}, s6D02_00={"default": 0x04})
    with pytest.raises(RobotConfigError, match=r"its modes are PV \(0x6502\), and no RPDO .*0x6840.*0x68FF"):
        choose_drive(other, [(VELOCITY,), (VELOCITY,)])


def test_axes_that_the_rpdos_cannot_carry_together_are_named():
    few = slots_of(shape(axes=2, drop=(0x1440, 0x1441), pdos=[*TWO_PAIRS[:1], *TWO_PAIRS[2:]]), 2)
    with pytest.raises(
        RobotConfigError, match="its RPDOs cannot carry the objects of 2 axes: 0x6840, 0x68FF do not fit"
    ):
        choose_drive(few)
