from __future__ import annotations

import re
from pathlib import Path

import pytest

from canopen_control.errors import ConfigError
from canopen_control.virtual.fault_table import FAULTS, find_fault, parse_fault

# Rows of the catalogue that a drive shows by its nature, and those that need a wire or a clock of their own.
NO_SWITCH = {16, 19, 29, 35}


def test_every_row_of_the_catalogue_that_acts_in_the_drive_has_a_switch():
    assert {fault.row for fault in FAULTS.values()} - {0} | NO_SWITCH == set(range(1, 44)) | {47}


def test_every_fault_says_what_it_does_and_what_a_good_master_makes_of_it():
    for fault in FAULTS.values():
        assert fault.acts in ("wire", "node", "axis", "program", "input", "output")
        assert len(fault.does) > 10
        assert fault.reaction
        assert fault.switched or fault.incoming or fault.outgoing or fault.floods or fault.second_node


def test_an_unknown_fault_is_named_with_the_nearest_one():
    with pytest.raises(ConfigError, match="did you mean heartbeat_lost"):
        find_fault("hartbeat_lost")
    with pytest.raises(ConfigError, match="fault list explains"):
        find_fault("xyzzy")


def test_a_fault_may_carry_its_time():
    assert parse_fault("silent") == (FAULTS["silent"], 0)
    assert parse_fault("silent@5s") == (FAULTS["silent"], 5_000_000_000)
    assert parse_fault("silent@0.25") == (FAULTS["silent"], 250_000_000)
    for text in ("silent@", "silent@soon", "silent@-1", "silent@nan", "silent@1e99"):
        with pytest.raises(ConfigError, match="after @ comes a time"):
            parse_fault(text)


def test_every_switch_has_a_test_that_sees_it_on_the_wire():
    files = ("test_fault_table_fault_actions.py", "test_device_faults.py")
    texts = [Path(__file__).with_name(name).read_text() for name in files]
    tested = {name for text in texts for name in re.findall(r'\bfault\("(\w+)"\)', text)}
    assert tested == set(FAULTS)
