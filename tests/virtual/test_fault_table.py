from __future__ import annotations

import re
from pathlib import Path

import pytest
from support.faulty import bench

from canopen_control.errors import ConfigError
from canopen_control.virtual.fault_table import FAULTS, find_fault, parse_fault
from canopen_control.virtual.quirks import QUIRKS, parse_quirk

# Rows of the catalogue that a drive shows by its nature, and those that need a wire or a clock of their own.
NO_SWITCH = {16, 19, 29, 35}


def test_every_row_of_the_catalogue_that_acts_in_the_drive_has_a_switch():
    assert {fault.row for fault in FAULTS.values()} - {0} | NO_SWITCH == set(range(1, 44)) | {47}


def test_every_fault_reports_what_it_does_and_what_a_good_master_makes_of_it():
    for fault in FAULTS.values():
        assert fault.acts in ("wire", "node", "axis", "program", "input", "output")
        assert len(fault.does) > 10
        assert fault.reaction
        assert fault.switched or fault.incoming or fault.outgoing or fault.floods or fault.second_node or fault.quirk


def test_an_unknown_fault_is_named_with_the_nearest_one():
    with pytest.raises(ConfigError, match="did you mean 'heartbeat_lost'"):
        find_fault("hartbeat_lost")
    with pytest.raises(ConfigError, match="see: canopen-control fault list"):
        find_fault("xyzzy")


QUIRKS_OF_FAULTS = {name: fault.quirk for name, fault in FAULTS.items() if fault.quirk}


def test_what_is_a_quirk_is_declared_in_the_table_of_quirks_alone():
    assert set(QUIRKS_OF_FAULTS) == FAULTS.keys() & QUIRKS.keys()
    assert len(QUIRKS_OF_FAULTS) == 10
    for name, text in QUIRKS_OF_FAULTS.items():
        fault = FAULTS[name]
        assert parse_quirk(text).quirk.name == name
        assert [fault.switched, fault.incoming, fault.outgoing] == [None] * 3


@pytest.mark.parametrize("name", QUIRKS_OF_FAULTS)
def test_a_fault_that_is_a_quirk_switches_the_quirk_under_its_old_name(name):
    b = bench()
    b.set(name)
    assert [parse_quirk(text).quirk.name for text in b.node.quirks.active] == [name]
    assert b.board.active == [name]
    b.set(name, False)
    assert b.node.quirks.active == b.board.active == []
    b.on(0.01)
    assert b.node.filter is None


def test_a_quirk_that_is_named_as_a_fault_is_named_with_its_verb():
    with pytest.raises(ConfigError, match="is a quirk, not a fault: canopen-control quirk NODE brake_delay=1"):
        find_fault("brake_delay=1")


def test_a_fault_may_carry_its_time():
    assert parse_fault("silent") == (FAULTS["silent"], 0)
    assert parse_fault("silent@5s") == (FAULTS["silent"], 5_000_000_000)
    assert parse_fault("silent@0.25") == (FAULTS["silent"], 250_000_000)
    for text in ("silent@", "silent@soon", "silent@-1", "silent@nan", "silent@1e99"):
        with pytest.raises(ConfigError, match="after @ must be a time"):
            parse_fault(text)


def test_every_switch_has_a_test_on_the_wire():
    files = ("test_fault_effects_frames.py", "test_fault_effects.py")
    texts = [Path(__file__).with_name(name).read_text() for name in files]
    tested = {name for text in texts for name in re.findall(r'\bfault\("(\w+)"\)', text)}
    assert tested == set(FAULTS)
