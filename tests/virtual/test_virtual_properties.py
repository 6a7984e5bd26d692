"""The virtual drive as a whole, compared with closed forms and a reference, on dictionaries of all kinds."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from support.properties import examples
from support.virtualbench import MS, REACHED, Bench, S, generic, servo

from canopen_control.cia402.modes import supported_modes
from canopen_control.virtual.device import make_device
from canopen_control.virtual.drive_modes import MODES
from canopen_control.virtual.plant import LagPlant, LoadedPlant

DEVIATIONS = sorted((Path(__file__).parents[1] / "od" / "deviations").glob("*.eds"))


# -- every dictionary


def modes_of(b, axis=0):
    listed = b.node.store.number(0x6502 + 0x800 * axis, 0, -1)
    return [int(mode) for mode in (MODES if listed == -1 else supported_modes(listed))]


def test_there_are_twelve_deviating_files():
    assert len(DEVIATIONS) == 12


@pytest.mark.parametrize("path", DEVIATIONS, ids=lambda path: path.stem)
def test_a_file_that_deviates_makes_a_drive_that_is_enabled_in_each_of_its_modes(path):
    modes = modes_of(Bench(make_device(path, 5)))
    assert modes
    for mode in modes:
        b = Bench(make_device(path, 5))
        b.write(0x60FF, 0)  # one file starts with another target
        b.enable(mode).on(0.5)
        assert b.state == "OPERATION_ENABLED"
        assert b.number(0x6041) & 0x6F == 0x27
        assert b.number(0x6061) == mode
        assert b.drive.mover.plant.position == 0
        b.control(0x00)
        assert b.state == "SWITCH_ON_DISABLED"


@pytest.mark.parametrize("path", DEVIATIONS, ids=lambda path: path.stem)
def test_a_file_that_deviates_makes_a_drive_that_turns(path):
    b = Bench(make_device(path, 5))
    if (refused := b.abort_of(0x6083, 1000)) is not None:  # one file allows 500 at most
        assert refused == 0x06090031
    b.enable(3)
    b.write(0x60FF, 100)
    b.on(2)
    assert b.drive.mover.plant.velocity == 100
    assert b.number(0x6064, signed=True) > 50


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("mode", [1, 2, 3, 4, 6, 7, 8, 9, 10])
def test_an_axis_0x800_higher_is_enabled_in_each_of_its_modes_alone(axis, mode):
    b = Bench(servo(axes=3)).enable(mode, axis=axis)
    states = [drive.state.name for drive in b.node.drives.values()]
    assert states == ["OPERATION_ENABLED" if item == axis else "SWITCH_ON_DISABLED" for item in range(3)]
    assert b.number(0x6061 + 0x800 * axis) == mode


# -- ramps, sampled from outside every 5 ms


def ready(mode, **objects):
    b = Bench(generic())
    values = {"x608F01": 6000, "x6083": 8000, "x6084": 4000, "x6085": 20_000, "x6081": 1000, "x609A": 8000} | objects
    values |= {"x604801": 600, "x604802": 2, "x604901": 600, "x604902": 1, "x60C5": 5000, "x60C6": 2500}
    for name, value in values.items():
        b.write(int(name[1:5], 16), value, int(name[5:] or "0", 16))
    b.write(0x6092, 6000, 1)  # a unit is a count
    return b.enable(mode)


def sampled(b, seconds):
    """Yield (seconds, way, 0x606C) every 5 ms."""
    start, first = b.now, b.position
    while b.now - start < seconds * S:
        b.on(0.005)
        yield (b.now - start) / S, b.position - first, b.velocity


def ramp(v0, v1, rate):
    """Return velocity and way of a ramp as functions of time."""
    end = abs(v1 - v0) / rate
    sign = math.copysign(rate, v1 - v0)

    def velocity(t):
        return v0 + sign * t if t < end else v1

    def way(t):
        inside = min(t, end)
        return v0 * inside + 0.5 * sign * inside * inside + v1 * max(0.0, t - end)

    return velocity, way


def check(b, seconds, form):
    velocity, way = form
    for t, gone, observed in sampled(b, seconds):
        assert observed == pytest.approx(velocity(t), rel=0.01, abs=1)
        assert gone == pytest.approx(way(t), abs=1)


@pytest.mark.parametrize(("mode", "up", "down"), [(3, 8000, 4000), (9, 5000, 2500)])
def test_pv_and_csv_follow_the_closed_form(mode, up, down):
    b = ready(mode)
    b.write(0x60FF, 1000)
    check(b, 0.5, ramp(0, 1000, up))
    b.write(0x60FF, 300)
    check(b, 0.5, ramp(1000, 300, down))
    b.write(0x60FF, 0)
    check(b, 0.5, ramp(300, 0, down))


def test_vl_follows_the_closed_form():
    b = ready(2)
    b.write(0x6042, 60)  # 6000 counts/s, up with 300 rpm/s and down with 600 rpm/s
    b.control(0x7F)
    check(b, 0.5, ramp(0, 6000, 30_000))
    b.write(0x6042, 6)
    check(b, 0.5, ramp(6000, 600, 60_000))


def test_pp_follows_its_trapezoid():
    b = ready(1)
    b.write(0x607A, 1000)
    b.control(0x1F)
    up, cruise, down = 0.125, 0.8125, 0.25  # 62.5, 812.5 and 125 counts

    def velocity(t):
        return 8000 * t if t < up else 1000 if t < up + cruise else max(0, 1000 - 4000 * (t - up - cruise))

    def way(t):
        rest = max(0.0, up + cruise + down - t)
        return 4000 * t * t if t < up else 62.5 + 1000 * (t - up) if t < up + cruise else 1000 - 2000 * rest * rest

    check(b, 1.3, (velocity, way))


def test_hm_ramps_with_0x609a_to_its_speed():
    b = ready(6, x6098=17, x609901=2000, x609902=100)
    b.control(0x1F)
    velocity, way = ramp(0, -2000, 8000)
    check(b, 1.0, (velocity, way))


@pytest.mark.parametrize(("mode", "index", "sub", "word"), [(8, 0x607A, 0, 0x0F), (7, 0x60C1, 1, 0x1F)])
def test_csp_and_ip_go_straight_from_set_point_to_set_point(mode, index, sub, word):
    b = ready(mode, x60C201=10)
    b.control(word)
    target, here = 0, 0
    for step in (10, 20, 35, 35, 0, -50):
        here, target = target, target + step
        b.write(index, target, sub)
        for standing in (3500 / 2, 0):  # after the 35: what an encoder has counted within the last 10 ms
            b.on(0.005)
            assert b.velocity == pytest.approx(step * 100 or standing, rel=0.01, abs=1)
        assert b.position == target
        assert abs(b.position - here - step) <= 1


@pytest.mark.parametrize(("mode", "slope"), [(4, 2000), (10, math.inf)])
def test_torque_modes_follow_the_lag_of_mass_and_viscous_friction(mode, slope):
    b = ready(mode, x6087=2000)
    b.write(0x6071, 200)
    gain, tau = 50.0, 0.05  # counts/s for each per mille, s
    velocity = way = torque = 0.0
    step = 0.00005
    for t, gone, observed in sampled(b, 0.4):
        for _ in range(100):  # an integration of its own, not the closed form of the plant
            torque = min(200.0, torque + slope * step)
            change = (torque * gain - velocity) / tau * step
            way += (velocity + 0.5 * change) * step
            velocity += change
        assert observed == pytest.approx(velocity, rel=0.01, abs=3), t
        assert gone == pytest.approx(way, abs=max(1.5, 0.005 * way))


# -- target reached

PLANTS = {"stiff": None, "lag": lambda axis: LagPlant(time_constant=0.03), "loaded": lambda axis: LoadedPlant()}


@pytest.mark.rest
@settings(max_examples=examples(30))
@given(
    st.sampled_from(sorted(PLANTS)),
    st.lists(st.tuples(st.integers(-500, 500), st.integers(1, 400), st.booleans()), min_size=1, max_size=3),
    st.integers(1, 20),
    st.integers(0, 50),
)
def test_pp_never_reports_target_reached_early(plant, moves, window, window_ms):
    b = Bench(generic(plant=PLANTS[plant]))
    for index, value in ((0x6081, 4000), (0x6083, 40_000), (0x6084, 40_000), (0x6067, window), (0x6068, window_ms)):
        b.write(index, value)
    b.write(0x6065, 0xFFFFFFFF)
    b.enable(1)
    for target, after_ms, at_once in moves:
        b.write(0x607A, target)
        b.control(0x3F if at_once else 0x1F)
        acknowledged = bool(b.statusword & 0x1000)
        b.control(0x0F)
        for _ in range(after_ms):
            b.on(0.001)
            if acknowledged and at_once and b.statusword & REACHED:
                assert abs(b.drive.mover.plant.position - target) <= window + 0.5
    b.on(20)
    assert b.statusword & REACHED
    assert abs(b.drive.mover.plant.position - b.drive.modes.active._target) <= window


# -- arbitrary frames from the bus

# The power state machine once more, written down from the diagram: state and command to the states that may follow,
# one where a ramp is under way or an automatic transition may have happened.
SOD, RTSO, SO, OE, QSA, FAULT = "SOD", "RTSO", "SO", "OE", "QSA", "FAULT"
NEXT = {
    (SOD, "shutdown"): {RTSO},
    (RTSO, "switch on"): {SO},
    (RTSO, "enable"): {SO, OE},
    (RTSO, "disable voltage"): {SOD},
    (RTSO, "quick stop"): {SOD},
    (SO, "enable"): {OE},
    (SO, "shutdown"): {RTSO},
    (SO, "disable voltage"): {SOD},
    (SO, "quick stop"): {SOD},
    (OE, "switch on"): {OE, SO},
    (OE, "shutdown"): {OE, RTSO},
    (OE, "disable voltage"): {SOD},
    (OE, "quick stop"): {QSA, SOD},
    (QSA, "disable voltage"): {SOD},
    (QSA, "enable"): {QSA, OE},
    (FAULT, "reset"): {SOD},
}
BY_ITSELF = {OE: {QSA, SOD}, QSA: {SOD}}  # 0x6007, and 12; a fault (13, 14) may come in every state


def command(word, before):
    if word & 0x80:
        return "" if before & 0x80 else "reset"
    if not word & 0x02:
        return "disable voltage"
    if not word & 0x04:
        return "quick stop"
    if not word & 0x01:
        return "shutdown"
    return "enable" if word & 0x08 else "switch on"


class Reference:
    """What may be, judged by the frames alone."""

    def __init__(self):
        self.states, self.operational, self.words = {SOD}, False, {0}
        self.booted = 0

    def frame(self, can_id, data, now=0):
        if can_id == 0 and len(data) >= 2 and data[1] in (0, 5):
            self.nmt(data[0], now)
        elif can_id == 0x205 and len(data) >= 3 and self.operational:
            self.word(struct.unpack_from("<H", data)[0])
        elif can_id == 0x605 and len(data) == 8 and data[0] >> 5 == 1 and data[1:4] == b"\x40\x60\x00":
            self.word(struct.unpack_from("<H", data, 4)[0])  # may have been refused
        self.states |= {FAULT} | {later for state in self.states for later in BY_ITSELF.get(state, ())}

    def nmt(self, number, now=0):
        if number in (0x01, 0x02, 0x80, 0x81, 0x82):
            self.operational = number == 0x01
        if number == 0x81 and now >= self.booted:
            self.states, self.words = {SOD}, {0}
        if number in (0x81, 0x82):
            self.booted = max(self.booted, now + 20 * MS)  # it receives nothing, not even another reset

    def word(self, word):
        """Take a controlword that may, or may not, have been taken."""
        after = set(self.states)
        for before in self.words:
            for state in self.states:
                after |= NEXT.get((state, command(word, before)), set())
        # A command that was held is looked at again when a transition is done.
        self.states, self.words = after, {*self.words, word}
        if word & 0x80:
            return
        for state in tuple(self.states):
            self.states |= NEXT.get((state, command(word, word)), set()) if state == SO else set()


USUAL = [0x00, 0x02, 0x06, 0x07, 0x0F, 0x1F, 0x3F, 0x7F, 0x80, 0x010F]
WORDS = st.one_of(st.sampled_from(USUAL), st.integers(0, 0xFFFF))
FRAMES = st.one_of(
    st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8)),
    st.tuples(st.just(0), st.sampled_from([0x01, 0x02, 0x80, 0x81, 0x82]).map(lambda number: bytes((number, 5)))),
    st.tuples(st.just(0x205), st.tuples(WORDS, st.integers(-2, 11)).map(lambda each: struct.pack("<Hb", *each))),
    st.tuples(st.just(0x305), st.integers(-(2**31), 2**31 - 1).map(lambda t: struct.pack("<ii", t, t // 1000))),
    st.tuples(st.just(0x605), WORDS.map(lambda word: struct.pack("<BHBI", 0x2B, 0x6040, 0, word))),
    st.tuples(st.just(0x605), st.integers(-2, 11).map(lambda mode: struct.pack("<BHBi", 0x2F, 0x6060, 0, mode))),
    st.tuples(st.just(0x605), st.integers(-5000, 5000).map(lambda speed: struct.pack("<BHBi", 0x23, 0x60FF, 0, speed))),
    st.tuples(st.just(0x605), st.integers(-5000, 5000).map(lambda place: struct.pack("<BHBi", 0x23, 0x607A, 0, place))),
    st.tuples(st.just(0x080), st.just(b"")),
)
UP = [(0, b"\x01\x05"), *((0x205, struct.pack("<Hb", word, 3)) for word in (0x06, 0x07, 0x0F))]


PRE_OPERATIONAL_AND_TARGET = [((0, b"\x80\x05"), 0), ((0x605, struct.pack("<BHBi", 0x23, 0x60FF, 0, 1000)), S)]
RESETS_IN_A_ROW = [
    *(((0x205, struct.pack("<Hb", 0x06, 3)), 0), ((0, b"\x82\x05"), 0), ((0, b"\x81\x05"), 0), ((0, b"\x01\x05"), S)),
    *(((0, b"\x01\x05"), 0), ((0x205, struct.pack("<Hb", 0x0F, 3)), 0)),
]


def leaves_the_mapping(frame):
    """Whether a random SDO frame cannot move the controlword's door, which the reference does not follow."""
    can_id, data = frame
    if can_id != 0x605 or len(data) != 8:
        return True
    index = struct.unpack_from("<H", data, 1)[0]
    return not 0x1400 <= index < 0x1C00 and (index != 0x6040 or data[0] in (0x2B, 0x40)) and data[0] >> 5 in (1, 2)


@pytest.mark.rest
@settings(max_examples=examples(200))
@given(
    st.booleans(),
    st.lists(st.tuples(FRAMES.filter(leaves_the_mapping), st.sampled_from([0, MS, 50 * MS, S])), max_size=30),
    st.integers(0, 3),
    st.sampled_from([2, 6]),
)
@example(True, PRE_OPERATIONAL_AND_TARGET, 1, 2)
@example(True, RESETS_IN_A_ROW, 1, 2)
def test_random_frames_start_a_motion_only_where_a_reference_of_its_own_reports_this(up, steps, option, quick_stop):
    b, reference = Bench(servo(x6007=option, x605A=quick_stop)), Reference()
    for (can_id, data), wait in [*((frame, 0) for frame in UP if up), *steps]:
        mover = b.drive.mover
        stood = not mover.plant.velocity and mover.demand.end_ns <= b.now and mover.torque is None
        position, allowed = mover.plant.position, OE in reference.states and reference.operational
        reference.frame(can_id, data, b.now)
        allowed = allowed or (OE in reference.states and reference.operational)
        b.put(can_id, data)
        b.to(b.now + wait)
        if stood and mover.plant.position != position:
            assert allowed
        if b.drive.state.name == "OPERATION_ENABLED":
            assert OE in reference.states
        # What the wire shows keeps the reference sharp.
        shown = {0x40: SOD, 0x21: RTSO, 0x23: SO, 0x27: OE, 0x07: QSA, 0x08: FAULT, 0x0F: FAULT}
        state = b.statusword & (0x6F if b.statusword & 0x21 else 0x4F)
        assert shown.get(state & 0x6F, shown.get(state & 0x4F)) in reference.states
    b.to(b.now + 5 * S)
    b.put(0x605, b"\x80" + bytes(7))
    b.nmt(0x81)
    b.to(b.now + S)
    assert b.number(0x1000) == 0x20192
    assert b.drive.mover.plant.velocity == 0


def test_the_reference_can_report_no():
    reference = Reference()
    for frame in ((0x205, b"\x0f\0\x03"), (0, b"\x01\x05"), (0x205, b"\x0f\0\x03")):
        reference.frame(*frame)
    assert OE not in reference.states
    for frame in UP:
        reference.frame(*frame)
    assert OE in reference.states
    reference.nmt(0x81)
    assert not reference.operational
