"""One output: what is sent when, and what is void."""

import math
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.virtualbench import T, entry

from canopen_control.cia301.pdo import MappedObject
from canopen_control.hardware.device_parts import OutputSignal
from canopen_control.hardware.interfaces import CommandInterface
from canopen_control.master.cycle import ProcessImage
from canopen_control.profiles.device_signal import Signal


class Line:
    """An output of a node that is there; `sent` counts what is due."""

    def __init__(self, signal, data_type=T.UNSIGNED8, **how):
        self.node = SimpleNamespace(
            ready=True, boots=1, identity=None, od={signal.address: entry(*signal.address, data_type)}
        )
        self.image = ProcessImage()
        mapped = MappedObject(*signal.address, data_type.bits, data_type)
        self.pdo = self.image.add_rpdo(5, 0x205, [mapped])
        self.pdo.start()
        self.object = self.image.output(5, *signal.address)
        self.command = CommandInterface("io", signal.name)
        self.output = OutputSignal(signal, self.command, self.object, self.node, **how)
        self.output.write()

    def sends(self, value):
        """Command a value, and return what is sent for it, None: nothing."""
        self.command.value = value
        self.output.write()
        due, self.pdo.changed = self.pdo.changed, False
        return self.object.value if due else None


LAMP = Signal("lamp", 0x6200, 1, output=True, bit=2)
VALVE = Signal("valve", 0x6411, 1, output=True, factor=0.5, offset=1.0, safe=3.0)


def test_a_bit_is_sent_with_the_others_of_its_object_as_they_are():
    line = Line(LAMP)
    line.object.know(0x81)
    assert [line.sends(value) for value in (1.0, 1.0, 0.0)] == [0x85, None, 0x81]


def test_the_first_command_is_sent_also_where_it_changes_nothing():
    line = Line(LAMP)
    assert [line.sends(value) for value in (math.nan, 0.0, 0.0)] == [None, 0, None]


def test_a_value_is_sent_in_raw_numbers_and_no_further_than_the_object_goes():
    line = Line(VALVE, T.INTEGER16)
    assert [line.sends(value) for value in (3.0, 1e9, -1e9, math.inf)] == [4, 32767, -32768, None]
    assert (line.command.lowest, line.command.highest) == (1.0 - 16384.0, 1.0 + 16383.5)


@pytest.mark.parametrize("goes_on", [True, False])
def test_what_was_commanded_before_the_node_was_lost_is_void(goes_on):
    line = Line(LAMP)
    assert line.sends(1.0) == 4
    line.node.ready = False
    assert not line.output.void
    assert line.sends(1.0) is None
    assert line.output.void
    assert not line.command.enabled
    line.node.ready, line.node.boots = True, 2
    line.object.know(0)
    assert line.sends(1.0 if goes_on else math.nan) is None
    assert line.command.enabled
    if goes_on:  # a controller that writes the same in each cycle has not commanded anew
        assert [line.sends(1.0), line.sends(1.0)] == [None, None]
        assert line.output.void
        assert [line.sends(0.0), line.sends(1.0)] == [0, 4]
    else:
        assert line.sends(1.0) == 4
    assert not line.output.void


@given(
    st.lists(st.tuples(st.sampled_from(["command", "lost", "back", "release"]), st.sampled_from([0.0, 1.0, math.nan])))
)
def test_whatever_was_before_a_restart_sends_nothing_by_what_stands_commanded(history):
    line = Line(LAMP)
    for what, value in history:
        if what == "command":
            line.sends(value)
        elif what == "release":
            line.output.release()
        else:
            line.node.ready = what == "back"
            line.node.boots += 1
            line.output.write()
    line.pdo.start()  # what waited to be sent went with the node
    standing = line.command.value
    for ready in (False, True):
        line.node.ready = ready
        line.node.boots += ready
        assert line.sends(standing) is None
    assert [line.sends(standing) for _ in range(3)] == [None] * 3
    other = 1.0 if standing != 1.0 else 0.0
    assert line.sends(other) is not None


def test_released_it_takes_its_safe_value_unless_it_keeps_what_it_has():
    line = Line(VALVE, T.INTEGER16)
    line.output.release()
    assert line.object.value == 0  # nobody had commanded it
    line.sends(10.0)
    line.output.release()
    assert line.object.value == 4
    assert math.isnan(line.command.value)
    keeping = Line(VALVE, T.INTEGER16, keeps=True)
    keeping.sends(10.0)
    keeping.output.release()
    assert keeping.object.value == 18


@pytest.mark.parametrize(("told", "raw"), [(None, 4), (5.0, 8), (math.nan, 20)])
def test_let_go_it_goes_where_its_controller_says_else_to_its_safe_value(told, raw):
    line = Line(VALVE, T.INTEGER16)
    assert line.command.safe == 3.0
    line.sends(11.0)
    line.command.let_go_at = told
    line.output.release()
    assert line.object.value == raw
    assert line.command.let_go_at is None


def test_one_that_is_to_keep_what_it_has_says_so():
    assert math.isnan(Line(VALVE, T.INTEGER16, keeps=True).command.safe)
