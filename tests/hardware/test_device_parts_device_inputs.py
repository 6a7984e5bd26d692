"""Inputs: from TPDOs and by SDO, how old they may be, and which values are none."""

import math
from types import SimpleNamespace

import pytest
from support.virtualbench import MS, S, T, entry

from canopen_control.cia301.pdo import MappedObject
from canopen_control.hardware.device_parts import POLL_NS, InputSignal, NodeInputs
from canopen_control.hardware.interfaces import StateInterface
from canopen_control.master.cycle import ProcessImage
from canopen_control.profiles.device_signal import Scale, Signal

VALUE, STATUS, RANGE = (0x7130, 1), (0x6150, 1), (0x6002, 0)


class Node:
    """A node whose TPDO carries 0x7130:01 and 0x6150:01; the rest is asked by SDO."""

    def __init__(self, signal, presets=()):
        types = {VALUE: T.INTEGER16, STATUS: T.UNSIGNED8, RANGE: T.UNSIGNED32, (0x6060, 0): T.UNSIGNED32}
        self.asked = []
        self.node = SimpleNamespace(
            node_id=5,
            ready=True,
            boots=1,
            identity=SimpleNamespace(presets=dict(presets)),
            od={address: entry(*address, kind) for address, kind in types.items()},
            read=lambda index, subindex, done: self.asked.append(((index, subindex), done)),
        )
        self.image = ProcessImage()
        mapped = [MappedObject(*address, types[address].bits, types[address]) for address in (VALUE, STATUS)]
        self.pdo = self.image.add_tpdo(5, 0x185, mapped)
        self.inputs = NodeInputs(self.node, self.image)
        self.state = StateInterface("io", signal.name)
        self.signal = InputSignal(signal, self.state, self.inputs)
        self.now = S

    def receives(self, raw, status=0):
        data = raw.to_bytes(2, "little", signed=True) + bytes((status,))
        self.pdo.receive(data.ljust(8, b"\0"), 3, self.now)
        return self.value()

    def value(self):
        self.inputs.read(self.now)
        self.signal.read(self.now)
        return self.state.value


PLAIN = Signal("ai0", *VALUE, factor=0.1)


def test_it_is_unknown_until_the_boot_has_read_it_or_its_tpdo_comes():
    assert math.isnan(Node(PLAIN).value())
    assert Node(PLAIN, {VALUE: 30}).value() == pytest.approx(3.0)
    assert Node(PLAIN).receives(-20) == pytest.approx(-2.0)


def test_one_that_comes_when_it_changes_has_no_age_and_one_with_a_timer_has():
    node = Node(PLAIN)
    node.receives(10)
    node.now += 3600 * S
    assert node.value() == pytest.approx(1.0)
    node.pdo.age_limit_ns = 300 * MS
    assert math.isnan(node.value())
    assert node.receives(11) == pytest.approx(1.1)
    node.now += 300 * MS
    assert node.value() == pytest.approx(1.1)
    node.now += 1
    assert math.isnan(node.value())


def test_it_is_unknown_while_its_node_is_lost_or_its_tpdo_is_overdue():
    node = Node(PLAIN)
    node.receives(10)
    node.pdo.overdue = True
    assert math.isnan(node.value())
    node.pdo.overdue = False
    node.node.ready = False
    assert math.isnan(node.value())
    node.node.ready = True
    node.pdo.forget()
    node.node.boots = 2
    assert math.isnan(node.value())  # what was received before counts no more


def test_what_the_device_calls_invalid_is_none():
    node = Node(Signal("ai0", *VALUE, status=STATUS))
    assert node.receives(5, 0) == 5.0
    assert math.isnan(node.receives(5, 1))
    assert node.receives(6, 0) == 6.0


def test_the_devices_scale_of_the_newest_boot_counts():
    node = Node(Signal("ai0", *VALUE, scales=(Scale(STATUS, float, 1),)), {STATUS: 3})
    assert node.receives(5) == 15.0
    node.node.identity.presets[STATUS] = 4
    node.node.boots = 2
    assert node.receives(5) == 20.0


def test_a_position_goes_on_where_the_device_begins_again():
    node = Node(Signal("position", *VALUE, unwrap=RANGE), {RANGE: 1000})
    assert [node.receives(raw) for raw in (900, 990, 10, 500, 999, 5, 990)] == [900, 990, 1010, 1500, 1999, 2005, 1990]
    node.node.ready = False
    node.value()
    node.node.ready = True
    assert node.receives(700) == 700.0  # nobody has seen the way


def test_another_type_is_taken_where_the_file_is_wrong():
    node = Node(Signal("x", *VALUE, data_type=T.UNSIGNED16))
    assert node.receives(-1) == 65535.0


def test_what_no_tpdo_carries_is_asked_for_now_and_then_and_ages():
    node = Node(Signal("v", 0x6060, factor=1 / 1024))
    assert math.isnan(node.value())
    node.inputs.poll(node.now)
    node.inputs.poll(node.now)
    ((address, done),) = node.asked
    assert address == (0x6060, 0)
    done(SimpleNamespace(error=None, data=(24 * 1024).to_bytes(4, "little")))
    assert node.value() == 24.0
    done(SimpleNamespace(error=None, data=b"\0"))  # an answer of another length says nothing
    done(SimpleNamespace(error=TimeoutError(), data=b""))
    assert node.value() == 24.0
    node.now += POLL_NS
    node.inputs.poll(node.now)
    assert len(node.asked) == 2
    node.now += 5 * POLL_NS
    assert math.isnan(node.value())


def test_what_changes_faster_than_it_can_has_jumped_and_is_told_once():
    node = Node(Signal("level", *VALUE, max_rate=100.0, unit="m"), {VALUE: 0})
    for raw in (0, 5, 10):  # 5 in 50 ms
        assert node.receives(raw) == raw
        node.now += 50 * MS
    assert math.isnan(node.receives(16))
    node.now += S
    assert math.isnan(node.receives(16))
    assert node.inputs.jumps == ["io/level jumped from 10 to 16 m: it is nan until the node is booted again"]
    node.node.boots, node.node.identity.presets[VALUE] = 2, 16
    assert node.receives(16) == 16.0


@pytest.mark.parametrize(("age_limit", "jumped"), [(0, True), (3 * S, False)])
def test_one_that_only_comes_when_it_changes_has_stood_still_while_it_was_silent(age_limit, jumped):
    node = Node(Signal("level", *VALUE, max_rate=100.0))
    node.receives(0)
    node.pdo.age_limit_ns = age_limit
    node.now += 2 * S
    assert math.isnan(node.receives(50)) is jumped  # 200 would be its way in that time, 5 the one in 50 ms
    node.now += 2 * S
    assert math.isnan(node.receives(51)) is jumped


def test_frames_that_come_together_are_no_jump():
    node = Node(Signal("level", *VALUE, max_rate=100.0))
    node.receives(0)
    node.now += 1
    assert node.receives(5) == 5.0
